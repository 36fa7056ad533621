//! Compiles the WGSL shaders to SPIR-V with naga, so that building needs no system compiler.

use naga::back::spv;
use naga::valid::{Capabilities, ValidationFlags, Validator};
use std::error::Error;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    for name in ["mesh", "floor"] {
        let path = format!("shaders/{name}.wgsl");
        println!("cargo::rerun-if-changed={path}");
        let source = std::fs::read_to_string(&path)?;
        let words = compile(&source).map_err(|message| format!("{path}: {message}"))?;
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        std::fs::write(out.join(format!("{name}.spv")), bytes)?;
    }
    println!("cargo::rerun-if-changed=build.rs");
    Ok(())
}

/// WGSL to SPIR-V 1.3. The default writer flags would flip Y: Vulkan's own convention is wanted here. Buffer indices
/// are checked on the processor before a frame is recorded, and the device is created with robust buffer access.
fn compile(source: &str) -> Result<Vec<u32>, String> {
    let module = naga::front::wgsl::parse_str(source).map_err(|error| error.emit_to_string(source))?;
    let info = Validator::new(ValidationFlags::all(), Capabilities::all())
        .validate(&module)
        .map_err(|error| error.emit_to_string(source))?;
    let options = spv::Options { lang_version: (1, 3), flags: spv::WriterFlags::empty(), ..spv::Options::default() };
    spv::write_vec(&module, &info, &options, None).map_err(|error| error.to_string())
}

//! Compiles the WGSL shaders to SPIR-V with naga, so that building needs no system compiler.

use naga::back::spv;
use naga::valid::{Capabilities, ValidationFlags, Validator};
use std::error::Error;
use std::path::PathBuf;

/// Each shader module, and the files that it is made of.
const SHADERS: &[(&str, &[&str])] = &[
    ("mesh", &["surface", "plane", "mesh"]),
    ("mesh-globe", &["globe", "mesh"]),
    ("floor", &["floor"]),
    ("rays-cast", &["surface", "rays/shared", "rays/cast"]),
    ("rays-color", &["rays/shared", "rays/color"]),
];

fn main() -> Result<(), Box<dyn Error>> {
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    for (name, parts) in SHADERS {
        let mut source = String::new();
        for part in *parts {
            let path = format!("shaders/{part}.wgsl");
            println!("cargo::rerun-if-changed={path}");
            source.push_str(&std::fs::read_to_string(&path).map_err(|error| format!("{path}: {error}"))?);
        }
        let words =
            compile(&source).map_err(|message| format!("the shader {name} ({}): {message}", parts.join(", ")))?;
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        std::fs::write(out.join(format!("{name}.spv")), bytes)?;
    }
    println!("cargo::rerun-if-changed=build.rs");
    Ok(())
}

/// WGSL to SPIR-V 1.3. The default writer flags would flip Y: Vulkan's own convention is wanted
/// here. Buffer indices are checked on the processor before a frame is recorded, and the device is
/// created with robust buffer access.
fn compile(source: &str) -> Result<Vec<u32>, String> {
    let module = naga::front::wgsl::parse_str(source).map_err(|error| error.emit_to_string(source))?;
    let info = Validator::new(ValidationFlags::all(), Capabilities::all())
        .validate(&module)
        .map_err(|error| error.emit_to_string(source))?;
    let options = spv::Options { lang_version: (1, 3), flags: spv::WriterFlags::empty(), ..spv::Options::default() };
    spv::write_vec(&module, &info, &options, None).map_err(|error| error.to_string())
}

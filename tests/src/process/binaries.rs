//! The programs under test.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// Folder with TerraVision's programs, of the profile that this test was built with. They are built
/// first: cargo makes the programs of *other* packages for no test.
fn folder() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        if let Some(folder) = std::env::var_os("TERRAVISION_BIN_DIR") {
            return folder.into();
        }
        // target/PROFILE/deps/this-test
        let test = std::env::current_exe().expect("a test knows its own path");
        let folder = test.ancestors().nth(2).expect("cargo puts tests into target/PROFILE/deps").to_owned();
        let profile = match folder.file_name().and_then(|name| name.to_str()) {
            Some("debug") | None => "dev",
            Some(name) => name,
        };
        let target = folder.parent().expect("a profile's folder lies in the target folder");
        let manifest = Path::new(env!("CARGO_MANIFEST_DIR")).join("../Cargo.toml");
        let mut cargo = Command::new(env!("CARGO"));
        // What cargo tells this test of itself would be news to build scripts, which would make
        // their crates anew.
        for (name, _) in std::env::vars_os() {
            if name.to_str().is_some_and(|name| name.starts_with("CARGO_PKG_") || name.starts_with("CARGO_MANIFEST_")) {
                cargo.env_remove(name);
            }
        }
        let output = cargo
            .args(["build", "--workspace", "--bins", "--offline", "--profile", profile, "--manifest-path"])
            .arg(&manifest)
            .arg("--target-dir")
            .arg(target)
            .output()
            .expect("cargo, which runs this test, can be started");
        assert!(output.status.success(), "the programs do not build:\n{}", String::from_utf8_lossy(&output.stderr));
        folder
    })
}

/// Path of one of TerraVision's programs.
///
/// # Panics
/// When the programs do not build or this one is not among them.
#[must_use]
pub fn binary(name: &str) -> PathBuf {
    let path = folder().join(name);
    assert!(path.exists(), "{} was not built", path.display());
    path
}

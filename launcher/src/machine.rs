//! What this machine has, and how to tell people of it.

use std::path::PathBuf;
use std::process::Output;

/// The program of that name in the folders of `PATH`.
#[must_use]
pub fn find_program(name: &str) -> Option<PathBuf> {
    use std::os::unix::fs::PermissionsExt;
    let is_program =
        |path: &PathBuf| path.metadata().is_ok_and(|found| found.is_file() && found.permissions().mode() & 0o111 != 0);
    std::env::split_paths(&std::env::var_os("PATH")?).map(|folder| folder.join(name)).find(is_program)
}

/// What a program said on standard output, or its last words when it failed.
///
/// # Errors
/// It failed.
pub fn outcome_words(output: &Output) -> Result<String, String> {
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    let words = String::from_utf8_lossy(&output.stderr);
    let last = words.lines().rfind(|line| !line.trim().is_empty()).unwrap_or("it failed without a word");
    Err(last.trim().to_owned())
}

/// Bytes as people say them, with a unit.
#[must_use]
pub fn bytes_for_people(bytes: u64) -> String {
    const UNITS: [(&str, u64); 3] = [("GiB", 1 << 30), ("MiB", 1 << 20), ("KiB", 1 << 10)];
    for (unit, size) in UNITS {
        if bytes >= size {
            let value = bytes as f64 / size as f64;
            return if value < 10.0 && !bytes.is_multiple_of(size) {
                format!("{value:.1} {unit}")
            } else {
                format!("{value:.0} {unit}")
            };
        }
    }
    format!("{bytes} bytes")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_read_well() {
        assert_eq!(bytes_for_people(512 << 20), "512 MiB");
        assert_eq!(bytes_for_people(1_500_000_000), "1.4 GiB");
        assert_eq!(bytes_for_people(12), "12 bytes");
    }
}

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

/// What a program wrote to standard output, or its last message when it failed.
///
/// # Errors
/// It failed.
pub fn outcome(output: &Output) -> Result<String, String> {
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    let messages = String::from_utf8_lossy(&output.stderr);
    let last = messages.lines().rfind(|line| !line.trim().is_empty()).unwrap_or("it failed and left no message");
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

/// A number as people write it: whole, in groups of three digits; with a digit more below ten.
#[must_use]
pub fn grouped(value: f64) -> String {
    if value.abs() < 10.0 && (value - value.round()).abs() >= 0.05 {
        return format!("{value:.1}");
    }
    let digits = format!("{:.0}", value.abs());
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    if value <= -0.5 { format!("-{text}") } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_well() {
        for (value, text) in
            [(0.0, "0"), (2.54, "2.5"), (9.99, "10"), (999.6, "1,000"), (-12_345_678.2, "-12,345,678"), (-0.2, "-0.2")]
        {
            assert_eq!(grouped(value), text);
        }
    }

    #[test]
    fn sizes_read_well() {
        assert_eq!(bytes_for_people(512 << 20), "512 MiB");
        assert_eq!(bytes_for_people(1_500_000_000), "1.4 GiB");
        assert_eq!(bytes_for_people(12), "12 bytes");
    }
}

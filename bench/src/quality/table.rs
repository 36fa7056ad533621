//! The table of a comparison of techniques.

use super::setting::Setting;
use crate::measurement::Measurement;

/// Columns of the table: names of measurements, and digits.
const COLUMNS: [(&str, &str, usize); 8] = [
    ("CPU ms", "processor time of a frame", 1),
    ("dB", "PSNR of land", 2),
    ("SSIM", "SSIM of land", 3),
    ("holes", "holes", 0),
    ("sky for land", "sky in place of land, at skylines too", 0),
    ("50 % within", "50 % of land on screen within", 2),
    ("99 % within", "99 % of land on screen within", 2),
    ("99.9 % within, px", "99.9 % of land on screen within", 2),
];

/// One row a setting, Markdown.
pub(super) fn table(settings: &[Setting], measurements: &[Measurement]) -> String {
    let heads = COLUMNS.map(|(head, ..)| head).join(" | ");
    let mut table = format!("| | {heads} |\n|---|{}\n", "--:|".repeat(COLUMNS.len()));
    for setting in settings {
        let value = |(_, name, digits): (&str, &str, usize)| {
            let name = format!("{}: {name}", setting.name);
            let found = measurements.iter().find(|measurement| measurement.name == name);
            found.map_or_else(|| "-".to_owned(), |found| format!("{:.digits$}", found.value))
        };
        table += &format!("| {} | {} |\n", setting.name, COLUMNS.map(value).join(" | "));
    }
    table
}

#[cfg(test)]
mod tests {
    use super::super::setting::USUAL;
    use super::*;

    #[test]
    fn the_table_has_a_row_for_every_setting_and_says_what_is_missing() {
        let of = |name: &str, value| Measurement::new("quality", name, value, "", 1);
        let table = table(&USUAL[..2], &[of("default: PSNR of land", 31.256), of("best: holes", 2.0)]);
        let rows: Vec<&str> = table.lines().collect();
        assert_eq!(
            rows[2..],
            ["| default | - | 31.26 | - | - | - | - | - | - |", "| best | - | - | - | 2 | - | - | - | - |"]
        );
    }
}

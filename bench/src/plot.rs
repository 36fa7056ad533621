//! Plots of what was measured, SVG.

use crate::measurement::{Measurement, short};
use anyhow::{Context, anyhow};
use plotters::prelude::*;
use std::path::{Path, PathBuf};

/// A curve over frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// What it shows.
    pub name: String,
    /// One value per frame.
    pub values: Vec<f64>,
}

const WIDTH: u32 = 960;
const ROW: u32 = 30;

/// Draws the measurements of one bench as bars, one row each, on a logarithmic scale from the
/// smallest to the largest of a unit, with a mark where the target is. Returns the file.
///
/// # Errors
/// When it cannot be written.
pub fn bars(folder: &Path, bench: &str, measurements: &[Measurement]) -> anyhow::Result<PathBuf> {
    let path = folder.join(format!("{bench}.svg"));
    let rows: Vec<&Measurement> = measurements.iter().filter(|m| m.value.is_finite() && m.value > 0.0).collect();
    let height = ROW * (rows.len() as u32 + 2);
    let mut svg = String::new();
    let draw = |svg: &mut String| -> Result<(), Box<dyn std::error::Error>> {
        let root = SVGBackend::with_string(svg, (WIDTH, height)).into_drawing_area();
        root.fill(&WHITE)?;
        let font = ("sans-serif", 15).into_font();
        root.draw(&Text::new(format!("terravision bench {bench}"), (10, 8), ("sans-serif", 18).into_font()))?;
        for (row, m) in rows.iter().enumerate() {
            let y = (ROW * (row as u32 + 1) + 10).cast_signed();
            let of_unit = || rows.iter().filter(|other| other.unit == m.unit).map(|other| other.value.ln());
            let low = of_unit().fold(f64::INFINITY, f64::min) - 0.7;
            let high = of_unit().fold(f64::NEG_INFINITY, f64::max).max(low + 1.4);
            let (left, right) = (430, WIDTH.cast_signed() - 150);
            let x = |value: f64| {
                let share = ((value.ln() - low) / (high - low)).clamp(0.0, 1.0);
                left + (share * f64::from(right - left)) as i32
            };
            let color = if m.verdict() == "missed" { RGBColor(200, 90, 60) } else { RGBColor(70, 120, 170) };
            root.draw(&Text::new(m.name.clone(), (10, y), font.clone()))?;
            root.draw(&Rectangle::new([(left, y), (x(m.value), y + 16)], color.filled()))?;
            root.draw(&Text::new(format!("{} {}", short(m.value), m.unit), (x(m.value) + 6, y), font.clone()))?;
            if let Some(target) = m.target {
                let (crate::measurement::Target::AtMost(limit) | crate::measurement::Target::AtLeast(limit)) = target;
                let mark = x(limit.max(f64::MIN_POSITIVE));
                root.draw(&PathElement::new([(mark, y - 4), (mark, y + 20)], BLACK.stroke_width(2)))?;
            }
        }
        root.present()?;
        Ok(())
    };
    draw(&mut svg).map_err(|error| anyhow!("cannot draw the plot: {error}"))?;
    std::fs::write(&path, svg).with_context(|| format!("cannot write {}", path.display()))?;
    Ok(path)
}

/// Draws curves over frames, in milliseconds. Returns the file.
///
/// # Errors
/// When it cannot be written.
pub fn curves(folder: &Path, name: &str, curves: &[Curve]) -> anyhow::Result<PathBuf> {
    let path = folder.join(format!("{name}.svg"));
    let frames = curves.iter().map(|c| c.values.len()).max().unwrap_or(0).max(1);
    let highest = curves.iter().flat_map(|c| c.values.iter().copied()).fold(1e-3, f64::max);
    let mut svg = String::new();
    let draw = |svg: &mut String| -> Result<(), Box<dyn std::error::Error>> {
        let root = SVGBackend::with_string(svg, (WIDTH, 420)).into_drawing_area();
        root.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&root)
            .margin(14)
            .caption(format!("terravision bench {name}: milliseconds per frame"), ("sans-serif", 18))
            .x_label_area_size(36)
            .y_label_area_size(56)
            .build_cartesian_2d(0.0..frames as f64, 0.0..1.05 * highest)?;
        chart.configure_mesh().x_desc("frame").y_desc("ms").draw()?;
        for (k, curve) in curves.iter().enumerate() {
            let color = Palette99::pick(k).to_rgba();
            let points = curve.values.iter().enumerate().map(|(frame, value)| (frame as f64, *value));
            chart
                .draw_series(LineSeries::new(points, &color))?
                .label(curve.name.clone())
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(2)));
        }
        chart.configure_series_labels().background_style(WHITE.mix(0.8)).border_style(BLACK).draw()?;
        root.present()?;
        Ok(())
    };
    draw(&mut svg).map_err(|error| anyhow!("cannot draw the plot: {error}"))?;
    std::fs::write(&path, svg).with_context(|| format!("cannot write {}", path.display()))?;
    Ok(path)
}

/// One row of a plot over time: curves of one unit.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TimeRow {
    /// What its numbers are.
    pub unit: String,
    /// Curves: a name, and points of seconds and value.
    pub curves: Vec<(String, Vec<(f64, f64)>)>,
    /// Values that are marked by a line across.
    pub marks: Vec<f64>,
    /// The largest value that is shown; larger ones are cut. `None` shows all.
    pub highest: Option<f64>,
}

const ROW_HEIGHT: u32 = 230;

/// Draws rows of curves over seconds, one below the other, with spans of time shaded in all of
/// them. The colour of a curve is that of its place in the row.
///
/// # Errors
/// When it cannot be written.
pub fn over_time(path: &Path, title: &str, rows: &[TimeRow], shades: &[[f64; 2]]) -> anyhow::Result<()> {
    let points = || rows.iter().flat_map(|row| &row.curves).flat_map(|(_, points)| points.iter().copied());
    let end = points().map(|(at, _)| at).fold(1e-3, f64::max);
    let mut svg = String::new();
    let draw = |svg: &mut String| -> Result<(), Box<dyn std::error::Error>> {
        let root = SVGBackend::with_string(svg, (WIDTH, ROW_HEIGHT * rows.len() as u32 + 40)).into_drawing_area();
        root.fill(&WHITE)?;
        let root = root.titled(title, ("sans-serif", 18))?;
        for (row, area) in rows.iter().zip(root.split_evenly((rows.len(), 1))) {
            let values = row.curves.iter().flat_map(|(_, points)| points.iter().map(|(_, value)| *value));
            let highest =
                row.highest.unwrap_or_else(|| 1.08 * values.chain(row.marks.iter().copied()).fold(1e-3, f64::max));
            let mut chart = ChartBuilder::on(&area)
                .margin(8)
                .x_label_area_size(28)
                .y_label_area_size(56)
                .build_cartesian_2d(0.0..end, 0.0..highest)?;
            for [from, to] in shades {
                let shade = RGBColor(200, 90, 60).mix(0.12).filled();
                chart.draw_series([Rectangle::new([(*from, 0.0), (*to, highest)], shade)])?;
            }
            chart.configure_mesh().light_line_style(WHITE).x_desc("s").y_desc(row.unit.clone()).draw()?;
            for mark in &row.marks {
                chart.draw_series(LineSeries::new([(0.0, *mark), (end, *mark)], BLACK.mix(0.6).stroke_width(1)))?;
            }
            for (k, (name, points)) in row.curves.iter().enumerate() {
                let color = Palette99::pick(k).to_rgba();
                let points = points.iter().map(|(at, value)| (*at, value.min(highest)));
                chart
                    .draw_series(LineSeries::new(points, color.stroke_width(1)))?
                    .label(name.clone())
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(2)));
            }
            let labels = &mut chart.configure_series_labels();
            labels.background_style(WHITE.mix(0.8)).border_style(BLACK.mix(0.3)).draw()?;
        }
        root.present()?;
        Ok(())
    };
    draw(&mut svg).map_err(|error| anyhow!("cannot draw the plot: {error}"))?;
    std::fs::write(path, svg).with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::Target;

    #[test]
    fn plots_are_svg_with_their_labels() {
        let folder = std::env::temp_dir().join(format!("terravision-bench-plot-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let measurements = [
            Measurement::new("queues", "ring hand-over", 1.5, "us", 9).with_target(Target::AtMost(20.0)),
            Measurement::new("queues", "slots", 2.0e7, "slots/s", 9),
        ];
        let text = std::fs::read_to_string(bars(&folder, "queues", &measurements).unwrap()).unwrap();
        assert!(text.starts_with("<svg") && text.contains("ring hand-over") && text.contains("20.00 M slots/s"));
        let row = TimeRow {
            unit: "px".to_owned(),
            curves: vec![("r_z".to_owned(), vec![(0.0, 10.0), (5.0, 20.0)])],
            ..TimeRow::default()
        };
        let path = folder.join("time.svg");
        over_time(&path, "a flight", &[row], &[[1.0, 2.0]]).unwrap();
        let text = std::fs::read_to_string(path).unwrap();
        assert!(text.contains("polyline") && text.contains("a flight") && text.contains("r_z"));
        let curve = Curve { name: "whole".to_owned(), values: vec![30.0, 31.0, 29.0] };
        let text = std::fs::read_to_string(curves(&folder, "replay", &[curve]).unwrap()).unwrap();
        assert!(text.contains("polyline") && text.contains("whole"));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}

//! What a frame costs: processor time of all processes of a flight.

use super::setting::Setting;
use crate::session::sibling;
use anyhow::{Context, bail};
use std::path::Path;
use std::process::{Command, Stdio};

/// Flights of this many frames: what the second one takes longer is the cost of the frames that it has
/// more, without that of the start.
const FRAMES: [u32; 2] = [20, 80];
/// Of the times in /proc/PID/stat: USER_HZ, on all processors that there are programs for.
const TICKS_A_SECOND: f64 = 100.0;

/// Processor time of a frame, milliseconds, of a flight around the strongest relief whose pictures
/// go to a pipe.
///
/// # Errors
/// When a flight fails, with what it says.
pub(super) fn millis_a_frame(
    world: &Path,
    [width, height]: [u32; 2],
    setting: &Setting,
    more: &[String],
) -> anyhow::Result<f64> {
    let mut took = [0.0; 2];
    for (frames, took) in FRAMES.into_iter().zip(&mut took) {
        let before = child_seconds()?;
        let mut command = Command::new(sibling("terravision")?);
        command.arg("fly").arg(world).args(["--quiet", "--path", "orbit", "--quality", setting.quality, "-o", "-"]);
        command.args(setting.arguments).args(more);
        command.args([format!("--size={width}x{height}"), format!("--frames=0..{frames}")]);
        let output = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).output();
        let output = output.context("cannot start terravision fly")?;
        if !output.status.success() {
            bail!("terravision fly: {}", String::from_utf8_lossy(&output.stderr).trim());
        }
        *took = child_seconds()? - before;
    }
    Ok(1e3 * (took[1] - took[0]) / f64::from(FRAMES[1] - FRAMES[0]))
}

/// Processor time of all processes that this one has started and that have ended, and of theirs.
fn child_seconds() -> anyhow::Result<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").context("cannot read /proc/self/stat")?;
    // Behind the name, which may have blanks: proc(5), fields 16 and 17.
    let (_, fields) = stat.rsplit_once(')').context("/proc/self/stat has no name")?;
    let ticks = fields.split_whitespace().skip(13).take(2).map(str::parse::<u64>).sum::<Result<u64, _>>();
    Ok(ticks.context("/proc/self/stat has no times")? as f64 / TICKS_A_SECOND)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processor_time_of_ended_children_is_counted() {
        let before = child_seconds().unwrap();
        let mut child =
            Command::new("sh").args(["-c", "i=0; while [ $i -lt 100000 ]; do i=$((i+1)); done"]).spawn().unwrap();
        assert!(child.wait().unwrap().success());
        assert!(child_seconds().unwrap() > before);
    }
}

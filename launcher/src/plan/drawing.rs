//! What draws, and whether the pool of colour tiles is compressed for it: decided once, before
//! facets are chosen and memory is made, by what is asked for and by the device.

use crate::cli::picture::{PictureArgs, Quality};
use crate::cli::technique::CompressionArg;
use crate::device::{self, Compression, DeviceQuestion};
use crate::failure::Failure;
use crate::process::own_folder;
use anyhow::anyhow;
use terravision_common::run::{RaysChoice, TechniqueChoice};
use terravision_common::technique::{Asked, Decision, FoundDevice};
use terravision_common::texels::TexelFormat;
use terravision_common::world::World;

/// What is to be decided. The renderer looks for its device meanwhile, where it matters.
#[derive(Debug)]
pub(super) struct DrawingQuestion {
    asked: Asked,
    compression: CompressionArg,
    /// Samples a pixel, as asked for.
    samples: Option<u32>,
    device: Option<DeviceQuestion>,
}

/// What was decided.
#[derive(Debug)]
pub(super) struct Drawing {
    pub(super) decision: Decision,
    pub(super) texels: TexelFormat,
    /// What is done differently than asked, a sentence.
    pub(super) warning: Option<String>,
}

impl DrawingQuestion {
    /// Begins to decide. `usual`: the preset if none is asked for; `has_validation`: the validation
    /// layer is asked for.
    ///
    /// # Errors
    /// Bad input: what is asked for never goes together.
    pub(super) fn new(picture: &PictureArgs, usual: Quality, has_validation: bool) -> Result<Self, Failure> {
        let (asked, compression) = asked(picture, usual, has_validation)?;
        let is_open = asked.technique.is_none() && asked.rays.is_none();
        let is_device_needed = is_open || compression != CompressionArg::Off;
        let device = is_device_needed.then(|| Ok(DeviceQuestion::ask(&own_folder()?))).transpose()?;
        Ok(Self { asked, compression, samples: picture.samples, device })
    }

    /// The same over a world: bodies are drawn by the mesh alone.
    ///
    /// # Errors
    /// Bad input: rays are asked for over a body.
    pub(super) fn over(mut self, world: &World) -> Result<Self, Failure> {
        if world.globe().is_none() {
            return Ok(self);
        }
        let is_rays = self.asked.technique == Some(TechniqueChoice::Rays) || self.asked.rays.is_some();
        if is_rays {
            return Err(Failure::bad_input(anyhow!(
                "--technique rays: rays do not draw whole bodies yet; expected --technique mesh or auto over this world"
            )));
        }
        self.asked.mesh_only = Some("the world is a whole body, which only the mesh draws");
        Ok(self)
    }

    /// Decides. (A renderer that finds the device gone afterwards says so: it draws nothing else.)
    ///
    /// # Errors
    /// Bad input: the device cannot do what is asked for.
    pub(super) fn decide(self) -> Result<Drawing, Failure> {
        let Self { asked, compression, samples, device } = self;
        let answer = device.map(DeviceQuestion::answer);
        let answer = answer.as_ref().map(|answer| answer.as_ref().map_err(String::as_str));
        // Where nobody was asked it makes no difference.
        let decision = Decision::new(asked, answer.map_or(FoundDevice::Unusable, device::found));
        let is_compressed = match (compression, answer) {
            (CompressionArg::On, Some(answer)) => compress(Compression::of(answer), true)?,
            (CompressionArg::Auto, Some(answer)) if decision.is_by_device() => {
                compress(Compression::of(answer), false)?
            }
            _ => false,
        };
        let lost = samples.filter(|samples| *samples > 1 && decision.technique == TechniqueChoice::Rays);
        let warning = lost.map(|samples| {
            format!("--samples {samples}: {}, so one ray is cast per pixel in place of {samples}", decision.reason)
        });
        let texels = if is_compressed { TexelFormat::Bc1 } else { TexelFormat::Rgba8 };
        Ok(Drawing { decision, texels, warning })
    }
}

/// What is asked for, and when tiles are to be compressed for it.
fn asked(picture: &PictureArgs, usual: Quality, has_validation: bool) -> Result<(Asked, CompressionArg), Failure> {
    let refuse = |text: String| Err(Failure::bad_input(anyhow!(text)));
    let technique = picture.technique.map(TechniqueChoice::from);
    let rays = picture.rays.map(RaysChoice::from);
    let is_rays = technique == Some(TechniqueChoice::Rays) || rays.is_some();
    if technique == Some(TechniqueChoice::Mesh) && rays.is_some() {
        return refuse("--rays applies to --technique rays only".to_owned());
    }
    let samples = picture.samples.filter(|samples| *samples > 1);
    if let Some(samples) = samples.filter(|_| is_rays) {
        return refuse(format!("--samples {samples} applies to --technique mesh only: one ray is cast per pixel"));
    }
    let is_by_processor = is_rays && rays != Some(RaysChoice::Compute);
    let is_default = picture.quality.unwrap_or(usual) == Quality::Default;
    let compression = match picture.texture_compression {
        CompressionArg::On if is_by_processor => {
            return refuse(
                "--texture-compression on applies to --technique mesh and --rays compute only: the processor casts rays over \
                 uncompressed colours"
                    .to_owned(),
            );
        }
        CompressionArg::Auto if is_by_processor || !is_default => CompressionArg::Off,
        compression => compression,
    };
    let mesh_only = if compression == CompressionArg::On {
        Some("compressed colour tiles were asked for, which only a device reads")
    } else if samples.is_some() {
        Some("several samples a pixel were asked for, which only the mesh has")
    } else if has_validation {
        Some("the validation layer was asked for, which watches a Vulkan device")
    } else {
        None
    };
    Ok((Asked { technique, rays, mesh_only }, compression))
}

/// Whether tiles are compressed for a device that is so good at it; `is_demanded`: with `on`.
fn compress(compression: Compression, is_demanded: bool) -> Result<bool, Failure> {
    match compression {
        Compression::Fast(_) => Ok(true),
        Compression::Slow(_) => Ok(is_demanded),
        Compression::Impossible(why) if is_demanded => {
            Err(Failure::bad_input(anyhow!("--texture-compression on: {why}; expected auto or off here")))
        }
        Compression::Impossible(_) => Ok(false),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::failure::ExitStatus;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Command {
        #[command(flatten)]
        picture: PictureArgs,
    }

    fn asked_for(flags: &str, has_validation: bool) -> Result<(Asked, CompressionArg), Failure> {
        let command = Command::try_parse_from(["it"].into_iter().chain(flags.split_whitespace())).unwrap();
        asked(&command.picture, Quality::Default, has_validation)
    }

    #[test]
    fn only_fast_devices_get_compressed_tiles_unasked() {
        let [fast, slow, impossible] = [Compression::Fast, Compression::Slow, Compression::Impossible]
            .map(|kind| [false, true].map(|is_demanded| compress(kind("it lacks it".to_owned()), is_demanded)));
        assert!(matches!(fast, [Ok(true), Ok(true)]) && matches!(slow, [Ok(false), Ok(true)]));
        let [Ok(false), Err(refused)] = impossible else { panic!("{impossible:?}") };
        assert_eq!(refused.status, ExitStatus::BadInput);
        assert_eq!(refused.to_string(), "--texture-compression on: it lacks it; expected auto or off here");
    }

    #[test]
    fn what_only_the_mesh_has_asks_for_it() {
        let mesh_only = |flags, has_validation| asked_for(flags, has_validation).unwrap().0.mesh_only;
        for flags in ["", "--samples 1", "--quality best", "--overlay tree", "--texture-compression off"] {
            assert_eq!(mesh_only(flags, false), None, "{flags}");
        }
        assert!(mesh_only("--samples 4", false).unwrap().starts_with("several samples"));
        assert!(mesh_only("--texture-compression on", false).unwrap().starts_with("compressed"));
        assert!(mesh_only("", true).unwrap().starts_with("the validation layer"));
    }

    #[test]
    fn tiles_are_compressed_by_default_for_what_a_device_draws_of_default_quality() {
        let compression = |flags| asked_for(flags, false).unwrap().1;
        for flags in ["", "--technique mesh", "--rays compute"] {
            assert_eq!(compression(flags), CompressionArg::Auto, "{flags}");
        }
        for flags in ["--rays sweep", "--technique rays", "--quality best", "--texture-compression off"] {
            assert_eq!(compression(flags), CompressionArg::Off, "{flags}");
        }
    }

    #[test]
    fn what_never_goes_together_is_refused() {
        for (flags, expected) in [
            ("--technique mesh --rays sweep", "--rays applies to --technique rays only"),
            ("--rays sweep --samples 4", "--samples 4 applies to --technique mesh only: one ray is cast per pixel"),
            ("--technique rays --samples 4", "--samples 4 applies to --technique mesh only: one ray is cast per pixel"),
        ] {
            assert_eq!(asked_for(flags, false).unwrap_err().to_string(), expected);
        }
        let refused = asked_for("--technique rays --texture-compression on", false).unwrap_err();
        assert!(refused.to_string().contains("--rays compute only"), "{refused}");
    }
}

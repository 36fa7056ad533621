//! Whether the pool of colour tiles is compressed: decided before its memory is made, for the
//! device that will read it.

use crate::cli::picture::{PictureArgs, Quality};
use crate::cli::technique::{CompressionArg, RaysArg, TechniqueArg};
use crate::device::{Compression, DeviceQuestion};
use crate::failure::Failure;
use crate::process::own_folder;
use anyhow::anyhow;
use terravision_common::texels::TexelFormat;

/// What is to be decided.
#[derive(Debug)]
pub(super) enum TexelQuestion {
    /// Nothing.
    Settled(TexelFormat),
    /// Compressed, if the device is fast at it.
    Auto(DeviceQuestion),
    /// Compressed, if the device can.
    On(DeviceQuestion),
}

impl TexelQuestion {
    /// Begins to decide. Asks for the device only where it matters.
    ///
    /// # Errors
    /// Bad input: what is asked for never goes together.
    pub(super) fn new(picture: &PictureArgs, usual: Quality) -> Result<Self, Failure> {
        let is_rays = match (picture.technique, picture.rays) {
            (_, Some(RaysArg::Compute)) => false,
            (None, rays) => rays.is_some(),
            (Some(technique), _) => technique == TechniqueArg::Rays,
        };
        let question = || Ok(DeviceQuestion::ask(&own_folder()?));
        match picture.texture_compression {
            CompressionArg::On if is_rays => Err(Failure::bad_input(anyhow!(
                "--texture-compression on applies to --technique mesh and --rays compute only: the processor casts rays over \
                 uncompressed colours"
            ))),
            CompressionArg::On => Ok(Self::On(question()?)),
            CompressionArg::Auto if !is_rays && picture.quality.unwrap_or(usual) == Quality::Default => {
                Ok(Self::Auto(question()?))
            }
            CompressionArg::Auto | CompressionArg::Off => Ok(Self::Settled(TexelFormat::Rgba8)),
        }
    }

    /// The format. (A renderer that finds its device gone does not cast rays over compressed tiles.)
    ///
    /// # Errors
    /// Bad input: the device cannot do what is asked for.
    pub(super) fn decide(self) -> Result<TexelFormat, Failure> {
        let (question, is_demanded) = match self {
            Self::Settled(texels) => return Ok(texels),
            Self::Auto(question) => (question, false),
            Self::On(question) => (question, true),
        };
        let answer = question.answer();
        let compression = Compression::of(answer.as_ref().map_err(String::as_str));
        Ok(if compress(compression, is_demanded)? { TexelFormat::Bc1 } else { TexelFormat::Rgba8 })
    }
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

    #[test]
    fn only_fast_devices_get_compressed_tiles_unasked() {
        let [fast, slow, impossible] = [Compression::Fast, Compression::Slow, Compression::Impossible]
            .map(|kind| [false, true].map(|is_demanded| compress(kind("it lacks it".to_owned()), is_demanded)));
        assert!(matches!(fast, [Ok(true), Ok(true)]) && matches!(slow, [Ok(false), Ok(true)]));
        let [Ok(false), Err(refused)] = impossible else { panic!("{impossible:?}") };
        assert_eq!(refused.status, ExitStatus::BadInput);
        assert_eq!(refused.to_string(), "--texture-compression on: it lacks it; expected auto or off here");
    }
}

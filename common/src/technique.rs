//! What draws a flight where that is left open, and why: decided here alone. The renderer goes by
//! it, the report has its reason, and `doctor` tells it beforehand.

use crate::run::TechniqueChoice;

/// The Vulkan device that would draw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FoundDevice {
    /// A GPU.
    Gpu,
    /// The processor itself, or something that does not say what it is.
    Software,
    /// None, or one that lacks something.
    Unusable,
}

/// What draws, and why.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Decision {
    /// What draws: never [`TechniqueChoice::Auto`].
    pub technique: TechniqueChoice,
    /// Why, a clause.
    pub reason: &'static str,
}

impl Decision {
    /// What was asked for, or what goes best with the device.
    #[must_use]
    pub fn new(asked: TechniqueChoice, device: FoundDevice) -> Self {
        let (technique, reason) = match (asked, device) {
            (TechniqueChoice::Mesh | TechniqueChoice::Rays, _) => (asked, "asked for"),
            (TechniqueChoice::Auto, FoundDevice::Gpu) => (TechniqueChoice::Mesh, "a GPU is there"),
            (TechniqueChoice::Auto, FoundDevice::Software) => {
                (TechniqueChoice::Mesh, "no GPU is there, but a Vulkan device in software")
            }
            (TechniqueChoice::Auto, FoundDevice::Unusable) => {
                (TechniqueChoice::Rays, "there is no Vulkan device that can be used")
            }
        };
        Self { technique, reason }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_asked_for_is_drawn_and_nothing_stays_open() {
        let of = |asked, device| {
            let Decision { technique, reason } = Decision::new(asked, device);
            format!("{}: {reason}", technique.name())
        };
        for device in [FoundDevice::Gpu, FoundDevice::Software, FoundDevice::Unusable] {
            assert_eq!(of(TechniqueChoice::Mesh, device), "mesh: asked for");
            assert_eq!(of(TechniqueChoice::Rays, device), "rays: asked for");
        }
        let open = |device| of(TechniqueChoice::Auto, device);
        assert_eq!(open(FoundDevice::Gpu), "mesh: a GPU is there");
        assert_eq!(open(FoundDevice::Software), "mesh: no GPU is there, but a Vulkan device in software");
        assert_eq!(open(FoundDevice::Unusable), "rays: there is no Vulkan device that can be used");
    }
}

//! What draws a flight, and why: decided here alone. The launcher plans by it, stages are told it,
//! the report has its reason, and `doctor` tells it beforehand.

use crate::run::{RaysChoice, TechniqueChoice};

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

/// What a user says about what draws.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Asked {
    /// The technique.
    pub technique: Option<TechniqueChoice>,
    /// How rays are cast. Who says it wants rays.
    pub rays: Option<RaysChoice>,
    /// Why only a mesh will do, a clause: something is asked for that rays do not have.
    pub mesh_only: Option<&'static str>,
}

/// What draws, and why.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Decision {
    /// What draws.
    pub technique: TechniqueChoice,
    /// How rays are cast, where they draw.
    pub rays: RaysChoice,
    /// Why, a clause.
    pub reason: &'static str,
}

impl Decision {
    /// What was asked for, or what goes best with the device: a GPU draws triangles fastest; a
    /// processor sweeps in a third of the time that it needs for triangles, finer facets included.
    #[must_use]
    pub fn new(asked: Asked, device: FoundDevice) -> Self {
        use TechniqueChoice::{Mesh, Rays};
        let (technique, reason) = match (asked, device) {
            (Asked { technique: Some(technique), .. }, _) => (technique, "asked for"),
            (Asked { rays: Some(_), .. }, _) => (Rays, "asked for"),
            (_, FoundDevice::Unusable) => (Rays, "there is no Vulkan device that can be used"),
            (Asked { mesh_only: Some(reason), .. }, _) => (Mesh, reason),
            (_, FoundDevice::Gpu) => (Mesh, "there is a GPU"),
            (_, FoundDevice::Software) => (Rays, "there is no GPU, only a Vulkan device in software"),
        };
        Self { technique, rays: asked.rays.unwrap_or(RaysChoice::Sweep), reason }
    }

    /// Whether a Vulkan device draws.
    #[must_use]
    pub fn is_by_device(&self) -> bool {
        self.technique == TechniqueChoice::Mesh || self.rays == RaysChoice::Compute
    }

    /// Whether a sweep draws.
    #[must_use]
    pub fn is_swept(&self) -> bool {
        self.technique == TechniqueChoice::Rays && self.rays == RaysChoice::Sweep
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DEVICES: [FoundDevice; 3] = [FoundDevice::Gpu, FoundDevice::Software, FoundDevice::Unusable];

    #[test]
    fn what_is_asked_for_is_drawn() {
        for device in DEVICES {
            for technique in [TechniqueChoice::Mesh, TechniqueChoice::Rays] {
                let asked = Asked { technique: Some(technique), ..Asked::default() };
                let rays = RaysChoice::Sweep;
                assert_eq!(Decision::new(asked, device), Decision { technique, rays, reason: "asked for" });
            }
            let asked = Asked { rays: Some(RaysChoice::Coherent), ..Asked::default() };
            let found = Decision::new(asked, device);
            assert_eq!((found.technique, found.rays), (TechniqueChoice::Rays, RaysChoice::Coherent));
            assert!(!found.is_by_device() && !found.is_swept());
            assert!(Decision::new(Asked { rays: Some(RaysChoice::Compute), ..asked }, device).is_by_device());
        }
    }

    #[test]
    fn what_is_left_open_goes_by_the_device() {
        let of = |asked, device| {
            let found = Decision::new(asked, device);
            assert!(found.is_swept() != found.is_by_device());
            format!("{}: {}", found.technique.name(), found.reason)
        };
        let open = DEVICES.map(|device| of(Asked::default(), device));
        assert_eq!(open[0], "mesh: there is a GPU");
        assert_eq!(open[1], "rays: there is no GPU, only a Vulkan device in software");
        assert_eq!(open[2], "rays: there is no Vulkan device that can be used");
        // A mesh needs a device no matter who asks for it.
        let mesh_only = Asked { mesh_only: Some("it has samples"), ..Asked::default() };
        let found = DEVICES.map(|device| of(mesh_only, device));
        assert_eq!(found, ["mesh: it has samples", "mesh: it has samples", &open[2]]);
    }
}

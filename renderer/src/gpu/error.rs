//! What can go wrong with the device.

use super::requirements::Missing;
use ash::vk;

/// An error of the graphics device or its driver.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GpuError {
    /// The Vulkan loader is not installed.
    #[error("the Vulkan loader (libvulkan.so.1) could not be loaded: {reason}")]
    NoLoader {
        /// What the dynamic linker said.
        reason: String,
    },
    /// There is a loader and no driver.
    #[error("no Vulkan device was found; on a machine without GPU install lavapipe (package mesa-vulkan-drivers)")]
    NoDevice,
    /// The device that was asked for is not there.
    #[error("no Vulkan device matches \"{wanted}\"; there are: {available}")]
    DeviceNotFound {
        /// The index or part of a name that was asked for.
        wanted: String,
        /// Numbers and names of the devices, for the user.
        available: String,
    },
    /// The device lacks something.
    #[error("the Vulkan device {device} cannot be used: {}", join(.missing))]
    Unsuitable {
        /// The device's name.
        device: String,
        /// All that is missing.
        missing: Vec<Missing>,
    },
    /// Validation was asked for and its layer is not installed.
    #[error("validation was asked for, but the layer VK_LAYER_KHRONOS_validation is not installed")]
    NoValidationLayer,
    /// The validation layer had something to say.
    #[error("the Vulkan validation layer gave {count} message(s); the first: {first}")]
    Validation {
        /// Number of messages.
        count: u64,
        /// Text of the first.
        first: String,
    },
    /// The device was lost.
    #[error("the Vulkan device was lost while {operation}; the last frame that it finished was submit {completed}")]
    DeviceLost {
        /// What was being done.
        operation: &'static str,
        /// Value of the timeline.
        completed: u64,
    },
    /// A Vulkan function failed.
    #[error("{operation} failed: {result}")]
    Vulkan {
        /// What was being done.
        operation: &'static str,
        /// Vulkan's result code.
        result: vk::Result,
    },
    /// No type of memory of the device fits.
    #[error("the device has no memory that fits {what}")]
    NoMemoryType {
        /// What the memory was for.
        what: &'static str,
    },
    /// More was asked of a fixed resource than it holds.
    #[error("{what}: {found} asked for, at most {limit} are possible")]
    TooMany {
        /// Of what.
        what: &'static str,
        /// How many were asked for.
        found: u64,
        /// How many are possible.
        limit: u64,
    },
    /// Nothing can be shown in a window.
    #[error("nothing can be shown in the window: {reason}")]
    Unshowable {
        /// Why, a clause.
        reason: String,
    },
    /// A frame did not come back from the device.
    #[error("the device has not finished a frame within {seconds} s")]
    Timeout {
        /// How long was waited.
        seconds: u64,
    },
}

impl GpuError {
    /// Whether the device was lost: another one may do.
    #[must_use]
    pub fn is_device_lost(&self) -> bool {
        matches!(self, Self::DeviceLost { .. } | Self::Vulkan { result: vk::Result::ERROR_DEVICE_LOST, .. })
    }
}

fn join(missing: &[Missing]) -> String {
    missing.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
}

/// Names the operation of a failed Vulkan call.
pub(super) trait During<T> {
    fn during(self, operation: &'static str) -> Result<T, GpuError>;
}

impl<T> During<T> for Result<T, vk::Result> {
    fn during(self, operation: &'static str) -> Result<T, GpuError> {
        self.map_err(|result| GpuError::Vulkan { operation, result })
    }
}

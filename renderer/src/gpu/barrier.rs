//! Barriers, made from named accesses. Passes say what they did and what comes next; stage masks
//! are written here only.

use super::device::Device;
use super::image::{Image, whole};
use ash::vk;

/// How a resource is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Access {
    /// Its content may be thrown away; earlier submits may still be at it.
    Discarded,
    /// Colour attachment of rendering, or target of its resolve.
    ColorTarget,
    /// Depth attachment of rendering, or target of its resolve.
    DepthTarget,
    /// Sampled by the fragment shader.
    Sampled,
    /// Storage buffers of compute shaders, read and written.
    Computed,
    /// Storage buffers that fragment shaders read.
    ReadByFragments,
    /// Source of a copy.
    CopySource,
    /// Target of a copy.
    CopyTarget,
    /// Source of a copy that may stretch.
    #[cfg(feature = "window")]
    BlitSource,
    /// Target of a copy that may stretch.
    #[cfg(feature = "window")]
    BlitTarget,
    /// Shown in a window.
    #[cfg(feature = "window")]
    Presented,
    /// Target of a clear outside of rendering.
    Cleared,
    /// Read by the processor, after the timeline has been waited for.
    HostRead,
}

impl Access {
    const fn masks(self) -> (vk::PipelineStageFlags2, vk::AccessFlags2, vk::ImageLayout) {
        use vk::{AccessFlags2 as A, ImageLayout as L, PipelineStageFlags2 as S};
        match self {
            Self::Discarded => (S::ALL_COMMANDS, A::NONE, L::UNDEFINED),
            Self::ColorTarget => (
                S::COLOR_ATTACHMENT_OUTPUT,
                A::from_raw(A::COLOR_ATTACHMENT_WRITE.as_raw() | A::COLOR_ATTACHMENT_READ.as_raw()),
                L::COLOR_ATTACHMENT_OPTIMAL,
            ),
            Self::DepthTarget => (
                S::from_raw(S::EARLY_FRAGMENT_TESTS.as_raw() | S::LATE_FRAGMENT_TESTS.as_raw()),
                A::from_raw(A::DEPTH_STENCIL_ATTACHMENT_WRITE.as_raw() | A::DEPTH_STENCIL_ATTACHMENT_READ.as_raw()),
                L::DEPTH_ATTACHMENT_OPTIMAL,
            ),
            Self::Sampled => (S::FRAGMENT_SHADER, A::SHADER_SAMPLED_READ, L::SHADER_READ_ONLY_OPTIMAL),
            Self::Computed => (
                S::COMPUTE_SHADER,
                A::from_raw(A::SHADER_STORAGE_READ.as_raw() | A::SHADER_STORAGE_WRITE.as_raw()),
                L::UNDEFINED,
            ),
            Self::ReadByFragments => (S::FRAGMENT_SHADER, A::SHADER_STORAGE_READ, L::UNDEFINED),
            Self::CopySource => (S::COPY, A::TRANSFER_READ, L::TRANSFER_SRC_OPTIMAL),
            Self::CopyTarget => (S::COPY, A::TRANSFER_WRITE, L::TRANSFER_DST_OPTIMAL),
            #[cfg(feature = "window")]
            Self::BlitSource => (S::BLIT, A::TRANSFER_READ, L::TRANSFER_SRC_OPTIMAL),
            #[cfg(feature = "window")]
            Self::BlitTarget => (S::BLIT, A::TRANSFER_WRITE, L::TRANSFER_DST_OPTIMAL),
            #[cfg(feature = "window")]
            // The semaphore that is signaled next makes it visible.
            Self::Presented => (S::NONE, A::NONE, L::PRESENT_SRC_KHR),
            Self::Cleared => (S::CLEAR, A::TRANSFER_WRITE, L::TRANSFER_DST_OPTIMAL),
            Self::HostRead => (S::HOST, A::HOST_READ, L::UNDEFINED),
        }
    }
}

/// The layout that an access needs an image to be in.
pub(super) const fn layout_of(access: Access) -> vk::ImageLayout {
    access.masks().2
}

/// Makes what `previous` wrote to a buffer (all of them) visible to `next`.
///
/// # Safety
/// * `commands` is being recorded, outside of rendering.
pub(super) unsafe fn memory(device: &Device, commands: vk::CommandBuffer, previous: Access, next: Access) {
    let (from_stage, from_access, _) = previous.masks();
    let (to_stage, to_access, _) = next.masks();
    let barriers = [vk::MemoryBarrier2::default()
        .src_stage_mask(from_stage)
        .src_access_mask(from_access)
        .dst_stage_mask(to_stage)
        .dst_access_mask(to_access)];
    let info = vk::DependencyInfo::default().memory_barriers(&barriers);
    // SAFETY: the caller's promise; the structures live until the end of the call.
    unsafe { device.raw().cmd_pipeline_barrier2(commands, &info) };
}

/// Takes a whole image from one access to the next.
///
/// # Safety
/// * `commands` is being recorded, outside of rendering, and the image outlives its execution.
pub(super) unsafe fn image(
    device: &Device,
    commands: vk::CommandBuffer,
    image: &Image,
    previous: Access,
    next: Access,
) {
    let aspect = image.shape().aspect;
    // SAFETY: the caller's promise.
    unsafe { raw_image(device, commands, (image.raw(), aspect), previous, next) };
}

/// Likewise an image that is not ours, with its aspect.
///
/// # Safety
/// * As for [`image()`].
pub(super) unsafe fn raw_image(
    device: &Device,
    commands: vk::CommandBuffer,
    (image, aspect): (vk::Image, vk::ImageAspectFlags),
    previous: Access,
    next: Access,
) {
    let (from_stage, from_access, from_layout) = previous.masks();
    let (to_stage, to_access, to_layout) = next.masks();
    let barriers = [vk::ImageMemoryBarrier2::default()
        .src_stage_mask(from_stage)
        .src_access_mask(from_access)
        .dst_stage_mask(to_stage)
        .dst_access_mask(to_access)
        .old_layout(from_layout)
        .new_layout(to_layout)
        .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
        .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
        .image(image)
        .subresource_range(whole(aspect))];
    let info = vk::DependencyInfo::default().image_memory_barriers(&barriers);
    // SAFETY: the caller's promise; the structures live until the end of the call.
    unsafe { device.raw().cmd_pipeline_barrier2(commands, &info) };
}

//! The pictures of a window: which one may be drawn to, and which one is shown.

use super::device::Device;
use super::error::{During, GpuError};
use super::owned::{Owned, destroyer};
use super::surface::{Abilities, Surface};
use ash::{khr, vk};
use std::fmt;
use std::sync::Arc;

/// An image of a swapchain that was acquired.
#[derive(Debug, Clone, Copy)]
pub(super) struct Acquired {
    pub(super) index: u32,
    pub(super) image: vk::Image,
    /// Signaled by the submit that draws it; presenting waits for it.
    pub(super) drawn: vk::Semaphore,
}

/// What became of a call.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Outcome<T> {
    /// It was done; `true` where the swapchain should be made anew.
    Done(T, bool),
    /// There was no image within the time.
    NotYet,
    /// The swapchain has to be made anew.
    OutOfDate,
    /// The surface has to be made anew.
    SurfaceLost,
}

/// A swapchain.
pub(super) struct Swapchain {
    raw: vk::SwapchainKHR,
    functions: khr::swapchain::Device,
    images: Vec<vk::Image>,
    /// One an image: an image is acquired again only after it was presented, which has waited.
    drawn: Vec<Owned<vk::Semaphore>>,
    extent: [u32; 2],
    device: Arc<Device>,
}

impl fmt::Debug for Swapchain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Swapchain").field("extent", &self.extent).finish_non_exhaustive()
    }
}

/// Formats whose bytes are those of pictures, the best first: pictures are sRGB already.
const FORMATS: [vk::Format; 2] = [vk::Format::B8G8R8A8_UNORM, vk::Format::R8G8B8A8_UNORM];

fn format_of(formats: &[vk::SurfaceFormatKHR]) -> Option<vk::SurfaceFormatKHR> {
    let is_plain = |found: &&vk::SurfaceFormatKHR| found.color_space == vk::ColorSpaceKHR::SRGB_NONLINEAR;
    let of = |format| formats.iter().filter(is_plain).find(|found| found.format == format).copied();
    FORMATS.into_iter().find_map(of).or_else(|| formats.first().copied())
}

/// How pictures reach the screen. Frames come by a clock of their own: nothing is gained by a queue
/// of them before the screen, so that with `has_vsync` the newest one wins, too.
fn mode_of(modes: &[vk::PresentModeKHR], has_vsync: bool) -> vk::PresentModeKHR {
    use vk::PresentModeKHR as M;
    let wishes: &[M] = if has_vsync { &[M::MAILBOX, M::FIFO] } else { &[M::IMMEDIATE, M::MAILBOX, M::FIFO] };
    // Every device has this one.
    wishes.iter().copied().find(|wish| modes.contains(wish)).unwrap_or(M::FIFO)
}

/// The size of a swapchain: the window's, where it has one, else what the window's thread says.
fn extent_of(capabilities: &vk::SurfaceCapabilitiesKHR, window_px: [u32; 2]) -> [u32; 2] {
    let current = [capabilities.current_extent.width, capabilities.current_extent.height];
    if current != [u32::MAX; 2] {
        return current;
    }
    let [low, high] =
        [capabilities.min_image_extent, capabilities.max_image_extent].map(|extent| [extent.width, extent.height]);
    [0, 1].map(|axis| window_px[axis].clamp(low[axis], high[axis].max(low[axis])))
}

impl Swapchain {
    /// For a window as it is now; `None` while it has no size.
    pub(super) fn new(
        device: &Arc<Device>,
        surface: &Surface,
        has_vsync: bool,
        before: Option<&Self>,
    ) -> Result<Outcome<Option<Self>>, GpuError> {
        let Abilities { capabilities, formats, modes } = match surface.abilities(device) {
            Ok(abilities) => abilities,
            Err(vk::Result::ERROR_SURFACE_LOST_KHR) => return Ok(Outcome::SurfaceLost),
            Err(result) => return Err(result).during("asking what a window can show"),
        };
        let extent = extent_of(&capabilities, surface.size_px());
        if extent.contains(&0) {
            return Ok(Outcome::Done(None, false));
        }
        let unshowable = |reason: &str| GpuError::Unshowable { reason: reason.into() };
        let format = format_of(&formats).ok_or_else(|| unshowable("it has no format of pixels"))?;
        if !capabilities.supported_usage_flags.contains(vk::ImageUsageFlags::TRANSFER_DST) {
            return Err(unshowable("pictures cannot be copied to it"));
        }
        let most = if capabilities.max_image_count == 0 { u32::MAX } else { capabilities.max_image_count };
        use vk::CompositeAlphaFlagsKHR as Alpha;
        let alphas = [Alpha::OPAQUE, Alpha::INHERIT, Alpha::PRE_MULTIPLIED, Alpha::POST_MULTIPLIED];
        let alpha = alphas.into_iter().find(|alpha| capabilities.supported_composite_alpha.contains(*alpha));
        let info = vk::SwapchainCreateInfoKHR::default()
            .surface(surface.raw())
            .min_image_count((capabilities.min_image_count + 1).min(most))
            .image_format(format.format)
            .image_color_space(format.color_space)
            .image_extent(vk::Extent2D { width: extent[0], height: extent[1] })
            .image_array_layers(1)
            .image_usage(vk::ImageUsageFlags::TRANSFER_DST)
            .image_sharing_mode(vk::SharingMode::EXCLUSIVE)
            .pre_transform(capabilities.current_transform)
            .composite_alpha(alpha.unwrap_or(Alpha::OPAQUE))
            .present_mode(mode_of(&modes, has_vsync))
            .clipped(true)
            .old_swapchain(before.map_or(vk::SwapchainKHR::null(), |before| before.raw));
        let functions = khr::swapchain::Device::new(device.instance().raw(), device.raw());
        // SAFETY: all numbers are within what the surface allows; the surface is alive, and has no
        // other swapchain than `before`, which is retired by this call.
        let raw = match unsafe { functions.create_swapchain(&info, None) } {
            Ok(raw) => raw,
            Err(vk::Result::ERROR_SURFACE_LOST_KHR | vk::Result::ERROR_NATIVE_WINDOW_IN_USE_KHR) => {
                return Ok(Outcome::SurfaceLost);
            }
            Err(result) => return Err(result).during("making a swapchain"),
        };
        let (images, drawn) = (Vec::new(), Vec::new());
        let mut swapchain = Self { raw, functions, images, drawn, extent, device: Arc::clone(device) };
        // SAFETY: the swapchain is of this device.
        swapchain.images =
            unsafe { swapchain.functions.get_swapchain_images(raw) }.during("listing the images of a window")?;
        for _ in &swapchain.images {
            swapchain.drawn.push(semaphore(device, "picture drawn")?);
        }
        tracing::debug!(?extent, format = ?format.format, mode = ?info.present_mode, images = swapchain.images.len(), "swapchain");
        Ok(Outcome::Done(Some(swapchain), false))
    }

    /// Width and height, pixels.
    pub(super) fn extent(&self) -> [u32; 2] {
        self.extent
    }

    /// The next image, within this time; `free` is signaled when it may be drawn to.
    ///
    /// # Safety
    /// * `free` is not signaled, and nothing waits for it.
    pub(super) unsafe fn acquire(
        &self,
        timeout_nanos: u64,
        free: vk::Semaphore,
    ) -> Result<Outcome<Acquired>, GpuError> {
        // SAFETY: the swapchain is alive and used by this thread alone; the rest is the caller's promise.
        let acquired = unsafe { self.functions.acquire_next_image(self.raw, timeout_nanos, free, vk::Fence::null()) };
        match acquired {
            Ok((index, is_suboptimal)) => {
                let at = index as usize;
                let (Some(image), Some(drawn)) = (self.images.get(at), self.drawn.get(at)) else {
                    return Ok(Outcome::OutOfDate);
                };
                Ok(Outcome::Done(Acquired { index, image: *image, drawn: drawn.get() }, is_suboptimal))
            }
            Err(result) => outcome_of(result, "taking an image of the window"),
        }
    }

    /// Shows an image that was acquired, when its semaphore is signaled.
    ///
    /// # Safety
    /// * A submit that signals the image's semaphore was made, and leaves the image in the layout
    ///   that is shown.
    pub(super) unsafe fn present(&self, acquired: &Acquired) -> Result<Outcome<()>, GpuError> {
        let (semaphores, swapchains, indices) = ([acquired.drawn], [self.raw], [acquired.index]);
        let info =
            vk::PresentInfoKHR::default().wait_semaphores(&semaphores).swapchains(&swapchains).image_indices(&indices);
        // SAFETY: nobody else uses the queue; the rest is the caller's promise.
        match self.device.with_queue(|queue| unsafe { self.functions.queue_present(queue, &info) }) {
            Ok(is_suboptimal) => Ok(Outcome::Done((), is_suboptimal)),
            Err(result) => outcome_of(result, "showing a picture"),
        }
    }
}

impl Drop for Swapchain {
    fn drop(&mut self) {
        // Presenting is no submit: the timeline does not know of it.
        // SAFETY: the queue is the device's; a queue that was lost has ended its work, too.
        self.device.with_queue(|queue| unsafe { self.device.raw().queue_wait_idle(queue) }).ok();
        // SAFETY: nothing uses its images any more; destroyed once.
        unsafe { self.functions.destroy_swapchain(self.raw, None) };
    }
}

/// What became of a call that has failed.
pub(super) fn outcome_of<T>(result: vk::Result, operation: &'static str) -> Result<Outcome<T>, GpuError> {
    match result {
        vk::Result::TIMEOUT | vk::Result::NOT_READY => Ok(Outcome::NotYet),
        vk::Result::ERROR_OUT_OF_DATE_KHR => Ok(Outcome::OutOfDate),
        vk::Result::ERROR_SURFACE_LOST_KHR => Ok(Outcome::SurfaceLost),
        result => Err(result).during(operation),
    }
}

/// A semaphore of the kind that windows understand.
pub(super) fn semaphore(device: &Arc<Device>, name: &str) -> Result<Owned<vk::Semaphore>, GpuError> {
    let info = vk::SemaphoreCreateInfo::default();
    // SAFETY: the structure is complete; the device is alive.
    let raw = unsafe { device.raw().create_semaphore(&info, None) }.during("creating a semaphore")?;
    device.name(raw, name);
    Ok(Owned::new(device, raw, destroyer!(destroy_semaphore)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use vk::PresentModeKHR as M;

    #[test]
    fn the_newest_picture_wins_and_every_device_has_a_mode() {
        let all = [M::FIFO, M::IMMEDIATE, M::MAILBOX];
        assert_eq!((mode_of(&all, true), mode_of(&all, false)), (M::MAILBOX, M::IMMEDIATE));
        assert_eq!((mode_of(&[M::FIFO], true), mode_of(&[M::FIFO], false)), (M::FIFO, M::FIFO));
        assert_eq!((mode_of(&[], true), mode_of(&all[..2], true)), (M::FIFO, M::FIFO));
    }

    #[test]
    fn bytes_stay_as_they_are_where_the_window_can_have_that() {
        let of = |format, color_space| vk::SurfaceFormatKHR { format, color_space };
        let plain = vk::ColorSpaceKHR::SRGB_NONLINEAR;
        let srgb = of(vk::Format::B8G8R8A8_SRGB, plain);
        let rgba = of(vk::Format::R8G8B8A8_UNORM, plain);
        assert_eq!(format_of(&[srgb, rgba]), Some(rgba));
        assert_eq!(format_of(&[srgb]), Some(srgb));
        assert_eq!(format_of(&[]), None);
    }

    #[test]
    fn a_window_decides_its_size_or_its_thread_does() {
        let size = |width, height| vk::Extent2D { width, height };
        let of = |current_extent| vk::SurfaceCapabilitiesKHR {
            current_extent,
            min_image_extent: size(1, 1),
            max_image_extent: size(4096, 4096),
            ..Default::default()
        };
        assert_eq!(extent_of(&of(size(640, 360)), [1, 1]), [640, 360]);
        assert_eq!(extent_of(&of(size(u32::MAX, u32::MAX)), [800, 9000]), [800, 4096]);
        assert_eq!(extent_of(&of(size(0, 0)), [800, 600]), [0, 0], "minimized");
    }
}

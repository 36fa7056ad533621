//! Shows pictures in a window: those that are on the device without a copy through memory of the
//! processor, others by an upload. A picture of another size than the window's is stretched, as
//! long as none of its size has come.
//!
//! Nothing waits for a window for long: one that takes no picture (minimized, or on another
//! workspace) shows the next one that it takes. What is out of date is made anew.

use super::adapter;
use super::barrier::{self, Access, layout_of};
use super::buffer::{Buffer, BufferUse};
use super::commands::Commands;
use super::device::{Device, DeviceChoice};
use super::error::GpuError;
use super::instance::Instance;
use super::owned::Owned;
use super::picture::{DevicePicture, color_layers};
use super::requirements::{Capabilities, Needs, missing_of};
use super::surface::{ShowTarget, Surface};
use super::swapchain::{Acquired, Outcome, Swapchain, outcome_of, semaphore};
use super::window_faults::{Call, WindowFaults};
use ash::vk;
use std::fmt;
use std::sync::Arc;
use terravision_common::rig::PictureLayout;

/// Pictures that are on their way to the window at a time.
const SLOTS: usize = 2;
/// How long a window is waited for, nanoseconds.
const PATIENCE_NANOS: u64 = 50_000_000;
/// Attempts to show a picture in a window that changes meanwhile.
const TRIES: u32 = 3;
/// What a device needs that only shows.
const SHOWING: Needs = Needs { size: [1; 2], ..Needs::LEAST };

/// How pictures are shown.
#[derive(Debug, Clone, Default)]
pub struct ShowOptions {
    /// Between two refreshes of the screen only.
    pub has_vsync: bool,
    /// With the validation layer, where a device of its own shows.
    pub has_validation: bool,
    /// What the window answers in tests.
    pub faults: Arc<WindowFaults>,
}

/// A picture to be shown.
#[derive(Debug, Clone, Copy)]
pub enum Shown<'a> {
    /// On the presenter's device.
    OnDevice(&'a DevicePicture),
    /// `[height, width, 4]` bytes RGBA, row 0 at the top, with width and height.
    InMemory(&'a [u8], [u32; 2]),
}

/// Shows pictures in a window. One thread uses it.
pub struct Presenter {
    // In the order in which they go.
    swapchain: Option<Swapchain>,
    slots: Vec<Slot>,
    surface: Option<Surface>,
    next: usize,
    options: ShowOptions,
    is_stale: bool,
    /// Size of the window that the swapchain was made for, as its thread said.
    made_for: [u32; 2],
    target: Arc<dyn ShowTarget>,
    device: Arc<Device>,
}

impl fmt::Debug for Presenter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Presenter").field("swapchain", &self.swapchain).finish_non_exhaustive()
    }
}

/// Whether a device of this machine can show pictures in windows, as far as is known without one.
///
/// # Errors
/// No device does.
pub fn check_showing() -> Result<(), GpuError> {
    let instance = Instance::for_windows(false)?;
    let devices = adapter::enumerate(&instance)?;
    if devices.is_empty() {
        return Err(GpuError::NoDevice);
    }
    let is_able = |found: &Capabilities| found.has_swapchain && missing_of(found, &SHOWING).is_empty();
    if instance.has_surfaces() && devices.iter().any(|(_, found)| is_able(found)) {
        return Ok(());
    }
    let reason = "no Vulkan device of this machine shows windows; lavapipe does (package mesa-vulkan-drivers)";
    Err(GpuError::Unshowable { reason: reason.into() })
}

/// What one picture on its way has of its own.
#[derive(Debug)]
struct Slot {
    commands: Commands,
    /// Where pixels of the processor are copied to, and what they are on the device.
    upload: Option<(Buffer, DevicePicture)>,
    /// Signaled when its image is free.
    free: Owned<vk::Semaphore>,
}

impl Presenter {
    /// With the device of pictures that are to be shown.
    ///
    /// # Errors
    /// [`GpuError::Unshowable`] when that cannot show anything in this window.
    pub fn with_device(
        device: &Arc<Device>,
        target: &Arc<dyn ShowTarget>,
        options: &ShowOptions,
    ) -> Result<Self, GpuError> {
        let surface = Surface::new(device.instance(), target)?;
        if !surface.is_showable_by(device)? {
            let reason = format!("the Vulkan device {} shows nothing there", device.description());
            return Err(GpuError::Unshowable { reason });
        }
        let slots = (0..SLOTS).map(|_| Slot::new(device)).collect::<Result<_, _>>()?;
        let (target, device) = (Arc::clone(target), Arc::clone(device));
        Ok(Self {
            swapchain: None,
            slots,
            surface: Some(surface),
            next: 0,
            options: options.clone(),
            is_stale: false,
            made_for: [0; 2],
            target,
            device,
        })
    }

    /// With a device of its own, for pictures in memory of the processor: the one that is asked for,
    /// or the first that can show something in this window.
    ///
    /// # Errors
    /// No device shows pictures in this window.
    pub fn of_its_own(target: &Arc<dyn ShowTarget>, options: &ShowOptions) -> Result<Self, GpuError> {
        let instance = Instance::for_windows(options.has_validation)?;
        let open = |choice: &DeviceChoice| {
            Device::new(&instance, choice, &SHOWING).and_then(|device| Self::with_device(&device, target, options))
        };
        let first = match open(&DeviceChoice::from_environment()) {
            Err(error) if !error.is_device_lost() => error,
            opened => return opened,
        };
        // A GPU may know nothing of this desktop, while another device does.
        let devices = adapter::enumerate(&instance)?.len();
        let others = (0..devices).map(|index| DeviceChoice::Matching(index.to_string()));
        others.map(|choice| open(&choice)).find_map(Result::ok).ok_or(first)
    }

    /// The device that shows.
    #[must_use]
    pub fn device(&self) -> &Arc<Device> {
        &self.device
    }

    /// Shows a picture, if the window takes one now; whether it does. The picture may be changed when
    /// this returns, if that is done on the device's queue, or in memory of the processor.
    ///
    /// # Errors
    /// The device was lost or is out of memory, or the desktop has gone.
    pub fn show(&mut self, shown: Shown<'_>) -> Result<bool, GpuError> {
        for _ in 0..TRIES {
            if !self.is_ready()? {
                continue;
            }
            let Some(swapchain) = &self.swapchain else { return Ok(false) };
            let slot = &mut self.slots[self.next];
            slot.commands.finish()?;
            let acquired = match self.options.faults.next(Call::Acquire) {
                // SAFETY: the slot's last submit has waited for its semaphore, and is done.
                None => unsafe { swapchain.acquire(PATIENCE_NANOS, slot.free.get()) }?,
                Some(result) => outcome_of(result, "taking an image in a test")?,
            };
            let acquired = match acquired {
                Outcome::Done(acquired, is_suboptimal) => {
                    self.is_stale |= is_suboptimal;
                    acquired
                }
                Outcome::NotYet => return Ok(false),
                other => {
                    self.lose(other);
                    continue;
                }
            };
            // From here on the semaphore is signaled, or about to be: the submit is not left out.
            slot.submit(&self.device, shown, (&acquired, swapchain.extent()))?;
            self.next = (self.next + 1) % self.slots.len();
            // SAFETY: the submit signals the image's semaphore, and leaves it in the layout that is shown.
            let presented = unsafe { swapchain.present(&acquired) }?;
            let fault = self.options.faults.next(Call::Present);
            match fault.map_or(Ok(presented), |result| outcome_of(result, "showing a picture in a test"))? {
                Outcome::Done((), is_suboptimal) => {
                    self.is_stale |= is_suboptimal;
                    return Ok(true);
                }
                other => self.lose(other),
            }
        }
        Ok(false)
    }

    /// What a window that has changed leaves of surface and swapchain.
    fn lose<T>(&mut self, outcome: Outcome<T>) {
        tracing::debug!(is_surface = matches!(outcome, Outcome::SurfaceLost), "the window has changed");
        self.is_stale = true;
        if matches!(outcome, Outcome::SurfaceLost) {
            self.swapchain = None;
            self.surface = None;
        }
    }

    /// Makes surface and swapchain for the window as it is now, where they are not; `false` when the
    /// surface was lost over it.
    fn is_ready(&mut self) -> Result<bool, GpuError> {
        if self.surface.is_none() {
            self.surface = Some(Surface::new(self.device.instance(), &self.target)?);
        }
        let Some(surface) = &self.surface else { return Ok(false) };
        // Where the desktop does not say that a window has another size, its thread does.
        let window_px = surface.size_px();
        if self.swapchain.is_some() && self.made_for == window_px && !self.is_stale {
            return Ok(true);
        }
        self.made_for = window_px;
        match Swapchain::new(&self.device, surface, self.options.has_vsync, self.swapchain.as_ref())? {
            Outcome::Done(swapchain, _) => {
                // The old one waits until nothing of it is shown any more.
                self.swapchain = swapchain;
                self.is_stale = false;
                Ok(true)
            }
            lost => {
                self.lose(lost);
                Ok(false)
            }
        }
    }
}

impl Slot {
    fn new(device: &Arc<Device>) -> Result<Self, GpuError> {
        let commands = Commands::new(device, "picture to the window")?;
        Ok(Self { commands, upload: None, free: semaphore(device, "image free")? })
    }

    /// Copies a picture to an image of the window that was acquired with this slot's semaphore; the
    /// slot has been waited for.
    fn submit(&mut self, device: &Arc<Device>, shown: Shown<'_>, to: (&Acquired, [u32; 2])) -> Result<(), GpuError> {
        if let Shown::InMemory(rgba, size) = shown {
            self.fill(device, rgba, size)?;
        }
        let commands = self.commands.begin()?;
        let picture = match (shown, &self.upload) {
            (Shown::OnDevice(picture), _) => picture,
            (Shown::InMemory(..), Some((buffer, picture))) => {
                // SAFETY: recording, outside of rendering; buffer and picture have one size, and belong to the slot.
                unsafe { record_upload(device, commands, buffer, picture) };
                picture
            }
            (Shown::InMemory(..), None) => return Ok(()),
        };
        // SAFETY: recording, outside of rendering; the picture is a source of copies.
        unsafe { record_blit(device, commands, picture, to) };
        let (after, before) = (Some(self.free.get()), Some(to.0.drawn));
        // SAFETY: recording, and all that was begun has ended. The picture is filled again by submits
        // to the same queue only, or waits before it goes (`Owned`), as the slot's own objects do. The
        // first semaphore is that of the image that was acquired; the second was waited for by the
        // image's last present.
        unsafe { self.commands.submit_between(after, before) }
    }

    /// Puts pixels where the device copies them from.
    fn fill(&mut self, device: &Arc<Device>, rgba: &[u8], size: [u32; 2]) -> Result<(), GpuError> {
        if self.upload.as_ref().is_none_or(|(_, picture)| picture.size() != size) {
            self.upload = None;
            let buffer = Buffer::new(device, rgba.len() as u64, BufferUse::Upload, "pixels for the window")?;
            self.upload = Some((buffer, DevicePicture::new(device, PictureLayout::whole(size))?));
        }
        if let Some((buffer, _)) = &mut self.upload {
            buffer.bytes_mut()[..rgba.len()].copy_from_slice(rgba);
        }
        Ok(())
    }
}

/// Copies pixels to a picture.
///
/// # Safety
/// * `commands` is being recorded, outside of rendering; no other submit uses the two.
unsafe fn record_upload(device: &Device, commands: vk::CommandBuffer, buffer: &Buffer, picture: &DevicePicture) {
    let [width, height] = picture.size();
    let regions = [vk::BufferImageCopy2::default().image_subresource(color_layers()).image_extent(vk::Extent3D {
        width,
        height,
        depth: 1,
    })];
    let info = vk::CopyBufferToImageInfo2::default()
        .src_buffer(buffer.raw())
        .dst_image(picture.image().raw())
        .dst_image_layout(layout_of(Access::CopyTarget))
        .regions(&regions);
    // SAFETY: the caller's promise; the buffer has the picture's pixels, and what the processor wrote
    // before the submit is visible to it.
    unsafe {
        picture.begin(commands);
        device.raw().cmd_copy_buffer_to_image2(commands, &info);
        picture.end(commands);
    }
}

/// Copies a picture to an image of the window, stretched where their sizes differ.
///
/// # Safety
/// * `commands` is being recorded, outside of rendering; the picture was filled by a submit to the
///   same queue, or before in this one, and is a source of copies.
unsafe fn record_blit(
    device: &Device,
    commands: vk::CommandBuffer,
    picture: &DevicePicture,
    (acquired, extent): (&Acquired, [u32; 2]),
) {
    let corner = |[width, height]: [u32; 2]| vk::Offset3D { x: width as i32, y: height as i32, z: 1 };
    let whole = |size| [vk::Offset3D::default(), corner(size)];
    let regions = [vk::ImageBlit2::default()
        .src_subresource(color_layers())
        .src_offsets(whole(picture.size()))
        .dst_subresource(color_layers())
        .dst_offsets(whole(extent))];
    let is_same = picture.size() == extent;
    let info = vk::BlitImageInfo2::default()
        .src_image(picture.image().raw())
        .src_image_layout(layout_of(Access::BlitSource))
        .dst_image(acquired.image)
        .dst_image_layout(layout_of(Access::BlitTarget))
        .filter(if is_same { vk::Filter::NEAREST } else { vk::Filter::LINEAR })
        .regions(&regions);
    let window = (acquired.image, vk::ImageAspectFlags::COLOR);
    // SAFETY: the caller's promise; the image was acquired, and is waited for before the first barrier.
    unsafe {
        barrier::memory(device, commands, Access::CopyTarget, Access::BlitSource);
        barrier::raw_image(device, commands, window, Access::Discarded, Access::BlitTarget);
        device.raw().cmd_blit_image2(commands, &info);
        barrier::raw_image(device, commands, window, Access::BlitTarget, Access::Presented);
    }
}

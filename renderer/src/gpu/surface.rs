//! A window as a surface that pictures are shown on.

use super::device::Device;
use super::error::{During, GpuError};
use super::instance::Instance;
use ash::{khr, vk};
use raw_window_handle::{HasDisplayHandle, HasWindowHandle, RawDisplayHandle, RawWindowHandle};
use std::fmt;
use std::sync::Arc;

/// A window of the desktop. Its handles stay valid as long as it lives, whatever thread it is on.
pub trait ShowTarget: HasWindowHandle + HasDisplayHandle + Send + Sync {
    /// Width and height, pixels of the screen; for desktops on which a picture decides how large a
    /// window is.
    fn size_px(&self) -> [u32; 2];
}

/// What a device can do with a surface now.
#[derive(Debug, Clone)]
pub(super) struct Abilities {
    pub(super) capabilities: vk::SurfaceCapabilitiesKHR,
    pub(super) formats: Vec<vk::SurfaceFormatKHR>,
    pub(super) modes: Vec<vk::PresentModeKHR>,
}

/// The surface of a window.
pub(super) struct Surface {
    raw: vk::SurfaceKHR,
    functions: khr::surface::Instance,
    /// Outlives the surface: fields are dropped after `drop`.
    target: Arc<dyn ShowTarget>,
    instance: Arc<Instance>,
}

impl fmt::Debug for Surface {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Surface").field("raw", &self.raw).finish_non_exhaustive()
    }
}

impl Surface {
    /// Of a window of X11 or Wayland.
    pub(super) fn new(instance: &Arc<Instance>, target: &Arc<dyn ShowTarget>) -> Result<Self, GpuError> {
        let unknown = || GpuError::Unshowable { reason: "its desktop is neither X11 nor Wayland".into() };
        if !instance.has_surfaces() {
            return Err(GpuError::Unshowable { reason: "the Vulkan loader knows no windows".into() });
        }
        let display = target.display_handle().map_err(|_gone| unknown())?.as_raw();
        let window = target.window_handle().map_err(|_gone| unknown())?.as_raw();
        let (entry, raw) = (instance.entry(), instance.raw());
        let created = match (display, window) {
            (RawDisplayHandle::Xlib(display), RawWindowHandle::Xlib(window)) => {
                let display = display.display.ok_or_else(unknown)?.as_ptr();
                let info = vk::XlibSurfaceCreateInfoKHR::default().dpy(display.cast()).window(window.window);
                // SAFETY: display and window are valid as long as `target`, which the surface keeps;
                // the extension is enabled where the loader has it, which the loader checks.
                unsafe { khr::xlib_surface::Instance::new(entry, raw).create_xlib_surface(&info, None) }
            }
            (RawDisplayHandle::Xcb(display), RawWindowHandle::Xcb(window)) => {
                let connection = display.connection.ok_or_else(unknown)?.as_ptr();
                let info = vk::XcbSurfaceCreateInfoKHR::default().connection(connection).window(window.window.get());
                // SAFETY: as above.
                unsafe { khr::xcb_surface::Instance::new(entry, raw).create_xcb_surface(&info, None) }
            }
            (RawDisplayHandle::Wayland(display), RawWindowHandle::Wayland(window)) => {
                let info = vk::WaylandSurfaceCreateInfoKHR::default()
                    .display(display.display.as_ptr())
                    .surface(window.surface.as_ptr());
                // SAFETY: as above.
                unsafe { khr::wayland_surface::Instance::new(entry, raw).create_wayland_surface(&info, None) }
            }
            _ => return Err(unknown()),
        };
        let functions = khr::surface::Instance::new(entry, raw);
        let raw = created.during("making a surface of the window")?;
        Ok(Self { raw, functions, target: Arc::clone(target), instance: Arc::clone(instance) })
    }

    pub(super) fn raw(&self) -> vk::SurfaceKHR {
        self.raw
    }

    /// Width and height of the window, pixels of the screen.
    pub(super) fn size_px(&self) -> [u32; 2] {
        self.target.size_px()
    }

    /// What a device of the same instance can do with it; an error where it cannot show anything.
    pub(super) fn abilities(&self, device: &Device) -> Result<Abilities, vk::Result> {
        let (physical, raw) = (device.physical(), self.raw);
        debug_assert!(Arc::ptr_eq(device.instance(), &self.instance));
        // SAFETY: device and surface are of this instance (likewise in the next calls).
        unsafe {
            Ok(Abilities {
                capabilities: self.functions.get_physical_device_surface_capabilities(physical, raw)?,
                formats: self.functions.get_physical_device_surface_formats(physical, raw)?,
                modes: self.functions.get_physical_device_surface_present_modes(physical, raw)?,
            })
        }
    }

    /// Whether a device of the same instance can show pictures on it.
    pub(super) fn is_showable_by(&self, device: &Device) -> Result<bool, GpuError> {
        if !device.can_show() {
            return Ok(false);
        }
        let (physical, family) = (device.physical(), device.queue_family());
        // SAFETY: device and surface are of this instance; the family is one of the device's.
        unsafe { self.functions.get_physical_device_surface_support(physical, family, self.raw) }
            .during("asking whether a device shows windows")
    }
}

impl Drop for Surface {
    fn drop(&mut self) {
        // SAFETY: the owner drops the swapchain first; created by this instance, destroyed once.
        unsafe { self.functions.destroy_surface(self.raw, None) };
    }
}

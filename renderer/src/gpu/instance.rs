//! The Vulkan instance, and the ear for the validation layer.

use super::error::{During, GpuError};
use ash::{ext, khr, vk};
use std::ffi::{CStr, c_void};
use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// How windows of the desktops that there are become surfaces.
const SURFACES: [&CStr; 4] =
    [khr::surface::NAME, khr::xlib_surface::NAME, khr::xcb_surface::NAME, khr::wayland_surface::NAME];

const VALIDATION_LAYER: &CStr = c"VK_LAYER_KHRONOS_validation";

/// What the validation layer said.
#[derive(Debug, Default)]
struct MessageLog {
    count: AtomicU64,
    first: Mutex<String>,
}

/// The loader and an instance of it.
pub struct Instance {
    messenger: Option<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    log: Arc<MessageLog>,
    raw: ash::Instance,
    has_debug_utils: bool,
    has_surfaces: bool,
    /// Keeps the loader's library mapped; last to go.
    entry: ash::Entry,
}

impl fmt::Debug for Instance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Instance").field("log", &self.log).finish_non_exhaustive()
    }
}

impl Instance {
    /// Loads Vulkan; with the validation layer, every warning and error of which is counted, when
    /// `has_validation`.
    ///
    /// # Errors
    /// No loader, no driver, no validation layer.
    pub fn new(has_validation: bool) -> Result<Arc<Self>, GpuError> {
        Self::open(has_validation, false)
    }

    /// Likewise, for devices that show pictures in windows, where the loader knows windows.
    ///
    /// # Errors
    /// As [`Instance::new`].
    pub fn for_windows(has_validation: bool) -> Result<Arc<Self>, GpuError> {
        Self::open(has_validation, true)
    }

    fn open(has_validation: bool, shows: bool) -> Result<Arc<Self>, GpuError> {
        // SAFETY: loads the system's libvulkan, whose initialisers are trusted as every dynamic
        // library's are.
        let entry = unsafe { ash::Entry::load() }.map_err(|e| GpuError::NoLoader { reason: e.to_string() })?;
        // SAFETY: the entry is loaded; no other precondition.
        let layers = unsafe { entry.enumerate_instance_layer_properties() }.during("listing Vulkan's layers")?;
        let has_layer = layers.iter().any(|layer| layer.layer_name_as_c_str() == Ok(VALIDATION_LAYER));
        if has_validation && !has_layer {
            return Err(GpuError::NoValidationLayer);
        }
        // SAFETY: as above.
        let extensions = unsafe { entry.enumerate_instance_extension_properties(None) }
            .during("listing Vulkan's instance extensions")?;
        let has = |name: &&CStr| extensions.iter().any(|found| found.extension_name_as_c_str() == Ok(*name));
        let has_debug_utils = has(&ext::debug_utils::NAME);
        // Some layers connect to a desktop for the asking, and complain where they find no desktop.
        let is_set = |name: &&str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
        let is_wayland = ["WAYLAND_DISPLAY", "WAYLAND_SOCKET"].iter().any(is_set);
        let is_there = |name: &CStr| is_wayland || name != khr::wayland_surface::NAME;
        let surfaces = SURFACES.iter().filter(|name| shows && has(name) && is_there(name));

        let application =
            vk::ApplicationInfo::default().application_name(c"TerraVision").api_version(vk::API_VERSION_1_3);
        let layer_names = [VALIDATION_LAYER.as_ptr()];
        let extension_names: Vec<_> =
            surfaces.copied().chain(has_debug_utils.then_some(ext::debug_utils::NAME)).map(CStr::as_ptr).collect();
        let enabled = [vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION];
        let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(&enabled);
        let mut info =
            vk::InstanceCreateInfo::default().application_info(&application).enabled_extension_names(&extension_names);
        if has_validation {
            info = info.enabled_layer_names(&layer_names).push_next(&mut features);
        }
        // SAFETY: all that `info` points to lives until the end of this function.
        let raw = unsafe { entry.create_instance(&info, None) }.map_err(|result| match result {
            vk::Result::ERROR_INCOMPATIBLE_DRIVER => GpuError::NoDevice,
            result => GpuError::Vulkan { operation: "creating the Vulkan instance", result },
        })?;
        let log = Arc::new(MessageLog::default());
        let has_surfaces = shows && has(&khr::surface::NAME);
        let mut instance = Self { messenger: None, log, raw, has_debug_utils, has_surfaces, entry };
        if has_validation && has_debug_utils {
            instance.listen()?;
        }
        Ok(Arc::new(instance))
    }

    fn listen(&mut self) -> Result<(), GpuError> {
        use vk::{DebugUtilsMessageSeverityFlagsEXT as Severity, DebugUtilsMessageTypeFlagsEXT as Type};
        let functions = ext::debug_utils::Instance::new(&self.entry, &self.raw);
        let info = vk::DebugUtilsMessengerCreateInfoEXT::default()
            .message_severity(Severity::WARNING | Severity::ERROR)
            .message_type(Type::VALIDATION | Type::PERFORMANCE)
            .pfn_user_callback(Some(on_message))
            .user_data(Arc::as_ptr(&self.log).cast_mut().cast());
        // SAFETY: the user data outlives the messenger: `Drop` destroys the messenger before the
        // log is released.
        let messenger = unsafe { functions.create_debug_utils_messenger(&info, None) }
            .during("listening to the validation layer")?;
        self.messenger = Some((functions, messenger));
        Ok(())
    }

    /// The instance's functions.
    pub(super) fn raw(&self) -> &ash::Instance {
        &self.raw
    }

    /// The loader.
    #[cfg(feature = "window")]
    pub(super) fn entry(&self) -> &ash::Entry {
        &self.entry
    }

    /// Whether windows can become surfaces.
    pub(super) fn has_surfaces(&self) -> bool {
        self.has_surfaces
    }

    /// Whether objects can be given names.
    pub(super) fn has_debug_utils(&self) -> bool {
        self.has_debug_utils
    }

    /// Whether the validation layer has been quiet so far.
    ///
    /// # Errors
    /// [`GpuError::Validation`] with the number of messages and the text of the first.
    pub fn check_validation(&self) -> Result<(), GpuError> {
        // Relaxed: a statistic; messages are written by the thread that made the faulty call,
        // before the call returned.
        let count = self.log.count.load(Ordering::Relaxed);
        if count == 0 {
            return Ok(());
        }
        let first = self.log.first.lock().unwrap_or_else(PoisonError::into_inner).clone();
        Err(GpuError::Validation { count, first })
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        if let Some((functions, messenger)) = self.messenger.take() {
            // SAFETY: created by this instance, destroyed once.
            unsafe { functions.destroy_debug_utils_messenger(messenger, None) };
        }
        // SAFETY: devices hold an `Arc` of the instance, so none is left.
        unsafe { self.raw.destroy_instance(None) };
    }
}

/// Counts a message and keeps the first.
unsafe extern "system" fn on_message(
    _severity: vk::DebugUtilsMessageSeverityFlagsEXT,
    _type: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    user_data: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the pointer that `listen` gave; the log outlives the messenger.
    let log = unsafe { &*user_data.cast_const().cast::<MessageLog>() };
    if log.count.fetch_add(1, Ordering::Relaxed) == 0 {
        // SAFETY: Vulkan passes a valid structure for the length of the call.
        let text = unsafe { (*data).p_message };
        if !text.is_null() {
            // SAFETY: the specification makes the message a NUL-terminated string.
            let text = unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned();
            *log.first.lock().unwrap_or_else(PoisonError::into_inner) = text;
        }
    }
    vk::FALSE
}

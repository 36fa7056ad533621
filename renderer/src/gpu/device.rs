//! The logical device, its queue, and the one clock: the timeline semaphore.

use super::adapter;
use super::error::{During, GpuError};
use super::instance::Instance;
use super::requirements::{Capabilities, Missing, Needs, missing_of};
use ash::{ext, khr, vk};
use std::ffi::CString;
use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Which device to use.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DeviceChoice {
    /// Discrete before integrated before virtual before the processor.
    Best,
    /// The device of this number, or the first whose name contains this text (in any case).
    Matching(String),
}

impl DeviceChoice {
    /// From the environment variable `TERRAVISION_DEVICE`; the best device when it is unset or
    /// empty.
    #[must_use]
    pub fn from_environment() -> Self {
        match std::env::var("TERRAVISION_DEVICE") {
            Ok(text) if !text.trim().is_empty() => Self::Matching(text.trim().to_owned()),
            _ => Self::Best,
        }
    }
}

/// A device that needs longer than this for a frame hangs.
pub(super) const LONGEST_FRAME: Duration = Duration::from_secs(60);

/// A value of the device's timeline: submits count from 1, and the GPU reaches a submit's value
/// when it is done with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct SubmitValue(u64);

/// The device alone, so that a constructor that fails after it destroys it.
struct RawDevice {
    functions: ash::Device,
    instance: Arc<Instance>,
}

impl Drop for RawDevice {
    fn drop(&mut self) {
        // SAFETY: every object of the device holds an `Arc` of `Device` (through `Owned`), so none
        // is left.
        unsafe { self.functions.destroy_device(None) };
    }
}

/// A logical device with one graphics queue.
pub struct Device {
    timeline: vk::Semaphore,
    /// Value of the last submit; the lock also guards the queue.
    queue: Mutex<(vk::Queue, u64)>,
    queue_family: u32,
    #[cfg(feature = "window")]
    physical: vk::PhysicalDevice,
    /// Whether the swapchain's functions may be used.
    can_show: bool,
    capabilities: Capabilities,
    memory: vk::PhysicalDeviceMemoryProperties,
    names: Option<ext::debug_utils::Device>,
    host_pointer_properties: Option<vk::PFN_vkGetMemoryHostPointerPropertiesEXT>,
    /// For tests: the submit that finds the device lost; 0 when one has, `u64::MAX` for none.
    lost_at: AtomicU64,
    raw: RawDevice,
}

impl fmt::Debug for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Device").field("capabilities", &self.capabilities).finish_non_exhaustive()
    }
}

impl Device {
    /// Opens the device that `choice` picks, if it has all that `needs` asks for.
    ///
    /// # Errors
    /// No such device, or all that it lacks.
    pub fn new(instance: &Arc<Instance>, choice: &DeviceChoice, needs: &Needs) -> Result<Arc<Self>, GpuError> {
        let mut found = adapter::enumerate(instance)?;
        let index = adapter::choose(&found.iter().map(|(_, c)| c).collect::<Vec<_>>(), choice, needs)?;
        let (physical, capabilities) = found.swap_remove(index);
        let missing = missing_of(&capabilities, needs);
        if !missing.is_empty() {
            return Err(GpuError::Unsuitable { device: capabilities.name, missing });
        }
        let Some((queue_family, _)) = adapter::graphics_family(instance, physical) else {
            let missing = vec![Missing::Feature("a graphics queue")];
            return Err(GpuError::Unsuitable { device: capabilities.name, missing });
        };
        let can_show = instance.has_surfaces() && capabilities.has_swapchain;
        let raw = open(instance, physical, queue_family, &capabilities, can_show)?;
        // SAFETY: the queue was asked for at creation.
        let queue = unsafe { raw.functions.get_device_queue(queue_family, 0) };
        // SAFETY: `physical` comes from this instance.
        let memory = unsafe { instance.raw().get_physical_device_memory_properties(physical) };
        let names = instance.has_debug_utils().then(|| ext::debug_utils::Device::new(instance.raw(), &raw.functions));
        let host_pointer_properties = if capabilities.host_import_alignment.is_some() {
            host_pointer_query(instance, &raw.functions)
        } else {
            None
        };

        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let info = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: the feature timelineSemaphore was enabled.
        let timeline = unsafe { raw.functions.create_semaphore(&info, None) }.during("creating the timeline")?;
        let device = Arc::new(Self {
            timeline,
            queue: Mutex::new((queue, 0)),
            queue_family,
            #[cfg(feature = "window")]
            physical,
            can_show,
            capabilities,
            memory,
            names,
            host_pointer_properties,
            lost_at: AtomicU64::new(u64::MAX),
            raw,
        });
        device.name(timeline, "timeline");
        device.name(queue, "graphics queue");
        Ok(device)
    }

    /// What the device can do.
    #[must_use]
    pub fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    /// The instance that the device is of.
    #[must_use]
    pub fn instance(&self) -> &Arc<Instance> {
        &self.raw.instance
    }

    pub(super) fn raw(&self) -> &ash::Device {
        &self.raw.functions
    }

    pub(super) fn queue_family(&self) -> u32 {
        self.queue_family
    }

    /// Whether it can show pictures in windows: only where its instance was made for that.
    #[must_use]
    pub fn can_show(&self) -> bool {
        self.can_show
    }

    #[cfg(feature = "window")]
    pub(super) fn physical(&self) -> vk::PhysicalDevice {
        self.physical
    }

    /// Gives an object a name for messages and debuggers.
    pub(super) fn name(&self, object: impl vk::Handle, name: &str) {
        let Some(functions) = &self.names else { return };
        let Ok(name) = CString::new(name) else { return };
        let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(object).object_name(&name);
        // SAFETY: the object is of this device. A name that could not be given is no error.
        let _named = unsafe { functions.set_debug_utils_object_name(&info) };
    }

    /// Index of the first memory type of `allowed` that has all of one of the `wishes`, tried in
    /// order.
    pub(super) fn memory_type(
        &self,
        allowed: u32,
        wishes: &[vk::MemoryPropertyFlags],
        what: &'static str,
    ) -> Result<u32, GpuError> {
        let types = self.memory.memory_types_as_slice();
        wishes
            .iter()
            .find_map(|wish| {
                (0..types.len()).find(|&i| allowed & (1 << i) != 0 && types[i].property_flags.contains(*wish))
            })
            .map(|index| index as u32)
            .ok_or(GpuError::NoMemoryType { what })
    }

    /// Memory types that host memory at `start` can be imported as; `None` when the device cannot
    /// import.
    ///
    /// # Safety
    /// * `start` points to mapped memory.
    pub(super) unsafe fn host_memory_types(&self, start: *const u8) -> Option<u32> {
        let query = self.host_pointer_properties?;
        let mut properties = vk::MemoryHostPointerPropertiesEXT::default();
        // SAFETY: the pointer is mapped (the caller's promise); the function comes from this
        // device.
        let result = unsafe {
            query(
                self.raw().handle(),
                vk::ExternalMemoryHandleTypeFlags::HOST_ALLOCATION_EXT,
                start.cast(),
                &mut properties,
            )
        };
        (result == vk::Result::SUCCESS && properties.memory_type_bits != 0).then_some(properties.memory_type_bits)
    }

    /// Submits a command buffer; its value is reached when the GPU is done with it. Not before one
    /// semaphore is signaled, where there is one, and signals another one in the end.
    ///
    /// # Safety
    /// * The command buffer is of this device, complete, and not pending.
    /// * All that it names stays alive and untouched by the processor until the value is reached.
    /// * The first semaphore is signaled, or about to be; nothing else waits for it.
    /// * The second is neither signaled nor about to be.
    pub(super) unsafe fn submit(
        &self,
        commands: vk::CommandBuffer,
        after: Option<vk::Semaphore>,
        before: Option<vk::Semaphore>,
    ) -> Result<SubmitValue, GpuError> {
        let mut queue = self.queue.lock().unwrap_or_else(PoisonError::into_inner);
        let value = queue.1 + 1;
        if value >= self.lost_at.load(Ordering::Relaxed) {
            // From here on nothing comes back from it either.
            self.lose_at(0);
            return Err(self.failure("submitting a frame", vk::Result::ERROR_DEVICE_LOST));
        }
        let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(commands)];
        let at_all = |semaphore: vk::Semaphore, value: u64| {
            let info = vk::SemaphoreSubmitInfo::default().semaphore(semaphore).value(value);
            info.stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
        };
        let waits = after.map(|semaphore| at_all(semaphore, 0));
        let signals = [at_all(self.timeline, value), at_all(before.unwrap_or_default(), 0)];
        let signals = if before.is_some() { &signals[..] } else { &signals[..1] };
        let submit = vk::SubmitInfo2::default()
            .wait_semaphore_infos(waits.as_slice())
            .command_buffer_infos(&buffers)
            .signal_semaphore_infos(signals);
        // SAFETY: the lock makes this the only user of the queue; the rest is the caller's promise.
        unsafe { self.raw().queue_submit2(queue.0, &[submit], vk::Fence::null()) }
            .map_err(|result| self.failure("submitting a frame", result))?;
        queue.1 = value;
        Ok(SubmitValue(value))
    }

    /// Uses the queue for something else than a submit: nobody else does meanwhile.
    #[cfg(feature = "window")]
    pub(super) fn with_queue<T>(&self, work: impl FnOnce(vk::Queue) -> T) -> T {
        let queue = self.queue.lock().unwrap_or_else(PoisonError::into_inner);
        work(queue.0)
    }

    /// Waits until `value` is reached, `timeout` at most; whether it was.
    ///
    /// # Errors
    /// The device was lost.
    pub fn wait(&self, value: SubmitValue, timeout: Duration) -> Result<bool, GpuError> {
        if self.lost_at.load(Ordering::Relaxed) == 0 {
            return Err(self.failure("waiting for a frame", vk::Result::ERROR_DEVICE_LOST));
        }
        self.wait_value(value, timeout)
    }

    /// From now on the `submit`-th frame, from 1, finds the device lost; for tests, which have no
    /// other way to lose one.
    pub fn lose_at(&self, submit: u64) {
        // Relaxed: one thread submits and waits.
        self.lost_at.store(submit, Ordering::Relaxed);
    }

    fn wait_value(&self, value: SubmitValue, timeout: Duration) -> Result<bool, GpuError> {
        let (semaphores, values) = ([self.timeline], [value.0]);
        let info = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
        let nanos = u64::try_from(timeout.as_nanos()).unwrap_or(u64::MAX);
        // SAFETY: the semaphore is alive as long as `self`.
        match unsafe { self.raw().wait_semaphores(&info, nanos) } {
            Ok(()) => Ok(true),
            Err(vk::Result::TIMEOUT) => Ok(false),
            Err(result) => Err(self.failure("waiting for a frame", result)),
        }
    }

    /// Waits for all submits so far; whether the device is done with them (or lost, which ends them
    /// too).
    pub(super) fn wait_for_all(&self) -> bool {
        let last = self.queue.lock().unwrap_or_else(PoisonError::into_inner).1;
        last == 0 || self.wait_value(SubmitValue(last), LONGEST_FRAME).unwrap_or(true)
    }

    fn failure(&self, operation: &'static str, result: vk::Result) -> GpuError {
        if result != vk::Result::ERROR_DEVICE_LOST {
            return GpuError::Vulkan { operation, result };
        }
        // SAFETY: the semaphore is alive; asking is valid on a lost device too (it may then fail).
        let completed = unsafe { self.raw().get_semaphore_counter_value(self.timeline) }.unwrap_or(0);
        GpuError::DeviceLost { operation, completed }
    }

    /// Name of the device, `llvmpipe (LLVM 15.0.6, 256 bits)`.
    #[must_use]
    pub fn description(&self) -> &str {
        &self.capabilities.name
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        // SAFETY: every submit was waited for by the frame slot that made it; the semaphore is
        // destroyed once, before the device (field `raw`).
        unsafe { self.raw().destroy_semaphore(self.timeline, None) };
    }
}

fn open(
    instance: &Arc<Instance>,
    physical: vk::PhysicalDevice,
    queue_family: u32,
    capabilities: &Capabilities,
    can_show: bool,
) -> Result<RawDevice, GpuError> {
    let priorities = [1.0];
    let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(queue_family).queue_priorities(&priorities)];
    let basic = vk::PhysicalDeviceFeatures::default()
        .robust_buffer_access(true)
        .sampler_anisotropy(capabilities.max_anisotropy > 1.0)
        .texture_compression_bc(capabilities.has_block_compression);
    let mut features12 = vk::PhysicalDeviceVulkan12Features::default().timeline_semaphore(true);
    let mut features13 = vk::PhysicalDeviceVulkan13Features::default().dynamic_rendering(true).synchronization2(true);
    let import = capabilities.host_import_alignment.map(|_| ext::external_memory_host::NAME.as_ptr());
    let show = can_show.then(|| khr::swapchain::NAME.as_ptr());
    let extensions: Vec<_> = import.into_iter().chain(show).collect();
    let info = vk::DeviceCreateInfo::default()
        .queue_create_infos(&queues)
        .enabled_extension_names(&extensions)
        .enabled_features(&basic)
        .push_next(&mut features12)
        .push_next(&mut features13);
    // SAFETY: features and extensions are those that `capabilities` found; all pointers live until
    // the end of the call.
    let functions =
        unsafe { instance.raw().create_device(physical, &info, None) }.during("opening the Vulkan device")?;
    Ok(RawDevice { functions, instance: Arc::clone(instance) })
}

/// `vkGetMemoryHostPointerPropertiesEXT`, which ash does not wrap.
fn host_pointer_query(
    instance: &Instance,
    device: &ash::Device,
) -> Option<vk::PFN_vkGetMemoryHostPointerPropertiesEXT> {
    // SAFETY: the device is alive and the name is NUL-terminated.
    let function = unsafe {
        instance.raw().get_device_proc_addr(device.handle(), c"vkGetMemoryHostPointerPropertiesEXT".as_ptr())
    }?;
    // SAFETY: Vulkan gives the function of that name, whose signature is this one.
    Some(unsafe {
        std::mem::transmute::<unsafe extern "system" fn(), vk::PFN_vkGetMemoryHostPointerPropertiesEXT>(function)
    })
}

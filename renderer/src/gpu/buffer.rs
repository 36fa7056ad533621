//! Buffers: mapped ones that the processor writes or reads, the device's own, and imported ones.

use super::device::Device;
use super::error::{During, GpuError};
use super::host_memory::HostMemory;
use super::owned::{Owned, destroyer};
use ash::vk;
use std::ptr::NonNull;
use std::sync::Arc;

/// Who uses a buffer how; decides its memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum BufferUse {
    /// The processor writes, shaders read.
    Storage,
    /// Shaders write and read.
    Scratch,
    /// The processor writes once, index fetch reads.
    Index,
    /// The processor writes, copies read.
    Upload,
    /// Copies write, the processor reads.
    Readback,
}

impl BufferUse {
    fn usage(self) -> vk::BufferUsageFlags {
        match self {
            Self::Storage | Self::Scratch => vk::BufferUsageFlags::STORAGE_BUFFER,
            Self::Index => vk::BufferUsageFlags::INDEX_BUFFER,
            Self::Upload => vk::BufferUsageFlags::TRANSFER_SRC,
            Self::Readback => vk::BufferUsageFlags::TRANSFER_DST,
        }
    }

    /// Memory that would be best, then memory that will do.
    fn memory(self) -> &'static [vk::MemoryPropertyFlags] {
        use vk::MemoryPropertyFlags as M;
        const MAPPED: M = M::from_raw(M::HOST_VISIBLE.as_raw() | M::HOST_COHERENT.as_raw());
        const MAPPED_ON_DEVICE: M = M::from_raw(MAPPED.as_raw() | M::DEVICE_LOCAL.as_raw());
        const MAPPED_AND_CACHED: M = M::from_raw(MAPPED.as_raw() | M::HOST_CACHED.as_raw());
        const ANY: M = M::from_raw(0);
        match self {
            Self::Storage | Self::Index => &[MAPPED_ON_DEVICE, MAPPED],
            Self::Scratch => &[M::DEVICE_LOCAL, ANY],
            Self::Upload => &[MAPPED],
            Self::Readback => &[MAPPED_AND_CACHED, MAPPED],
        }
    }
}

/// A buffer with its memory.
#[derive(Debug)]
pub(super) struct Buffer {
    handle: Owned<vk::Buffer>,
    _memory: Owned<vk::DeviceMemory>,
    mapped: Option<NonNull<u8>>,
    len: u64,
    /// Keeps imported pages mapped until the buffer and its memory are gone (fields drop in order).
    _pages: Option<HostMemory>,
}

// SAFETY: the mapped pointer is to memory that the buffer owns; all access goes through `&mut self`
// (writing) or `&self` (reading), and Vulkan lets any thread use mapped memory.
unsafe impl Send for Buffer {}
// SAFETY: as above; `&self` only reads.
unsafe impl Sync for Buffer {}

impl Buffer {
    /// A buffer of `len` bytes for `usage`.
    pub(super) fn new(device: &Arc<Device>, len: u64, usage: BufferUse, name: &str) -> Result<Self, GpuError> {
        let len = len.max(4);
        let info = vk::BufferCreateInfo::default().size(len).usage(usage.usage());
        // SAFETY: the structure is complete; the device is alive.
        let raw = unsafe { device.raw().create_buffer(&info, None) }.during("creating a buffer")?;
        let handle = Owned::new(device, raw, destroyer!(destroy_buffer));
        device.name(raw, name);
        // SAFETY: the buffer is of this device.
        let needs = unsafe { device.raw().get_buffer_memory_requirements(raw) };
        let kind = device.memory_type(needs.memory_type_bits, usage.memory(), "a buffer")?;
        let allocate = vk::MemoryAllocateInfo::default().allocation_size(needs.size).memory_type_index(kind);
        // SAFETY: the type index comes from this device.
        let memory = unsafe { device.raw().allocate_memory(&allocate, None) }.during("allocating a buffer's memory")?;
        let memory = Owned::new(device, memory, destroyer!(free_memory));
        // SAFETY: fresh buffer, fresh memory of the size and type that it needs.
        unsafe { device.raw().bind_buffer_memory(raw, memory.get(), 0) }.during("binding a buffer's memory")?;
        let mut mapped = None;
        if usage != BufferUse::Scratch {
            // SAFETY: the type is host visible, the memory is not yet mapped; it stays mapped until
            // it is freed.
            let start =
                unsafe { device.raw().map_memory(memory.get(), 0, vk::WHOLE_SIZE, vk::MemoryMapFlags::empty()) }
                    .during("mapping a buffer")?;
            mapped = NonNull::new(start.cast());
        }
        Ok(Self { handle, _memory: memory, mapped, len, _pages: None })
    }

    /// A mapped index buffer with this content.
    pub(super) fn with_indices(device: &Arc<Device>, indices: &[u32], name: &str) -> Result<Self, GpuError> {
        let bytes: &[u8] = bytemuck::cast_slice(indices);
        let mut buffer = Self::new(device, bytes.len() as u64, BufferUse::Index, name)?;
        buffer.bytes_mut()[..bytes.len()].copy_from_slice(bytes);
        Ok(buffer)
    }

    /// A buffer over pages of this process (or shared with another), used in place. `Ok(None)` when
    /// the device cannot import them: no extension, or a start or length that is not a multiple of
    /// its alignment.
    pub(super) fn import(
        device: &Arc<Device>,
        pages: &HostMemory,
        usage: vk::BufferUsageFlags,
        name: &str,
    ) -> Result<Option<Self>, GpuError> {
        let Some(alignment) = device.capabilities().host_import_alignment else { return Ok(None) };
        let start = pages.start();
        let len = pages.len() as u64;
        // Checked here: lavapipe does not.
        if len == 0
            || alignment == 0
            || !(start.as_ptr() as u64).is_multiple_of(alignment)
            || !len.is_multiple_of(alignment)
        {
            return Ok(None);
        }
        // SAFETY: `HostMemory` keeps its pages mapped.
        let Some(types) = (unsafe { device.host_memory_types(start.as_ptr()) }) else { return Ok(None) };
        let handle_type = vk::ExternalMemoryHandleTypeFlags::HOST_ALLOCATION_EXT;
        let mut external = vk::ExternalMemoryBufferCreateInfo::default().handle_types(handle_type);
        let info = vk::BufferCreateInfo::default().size(len).usage(usage).push_next(&mut external);
        // SAFETY: the structure is complete; the extension is enabled.
        let raw = unsafe { device.raw().create_buffer(&info, None) }.during("creating an imported buffer")?;
        let handle = Owned::new(device, raw, destroyer!(destroy_buffer));
        device.name(raw, name);
        // SAFETY: the buffer is of this device.
        let needs = unsafe { device.raw().get_buffer_memory_requirements(raw) };
        if needs.size > len {
            return Ok(None);
        }
        // Coherent: another process writes it, with no call to Vulkan.
        let coherent = vk::MemoryPropertyFlags::HOST_VISIBLE | vk::MemoryPropertyFlags::HOST_COHERENT;
        let Ok(kind) = device.memory_type(needs.memory_type_bits & types, &[coherent], "imported memory") else {
            return Ok(None);
        };
        let mut import =
            vk::ImportMemoryHostPointerInfoEXT::default().handle_type(handle_type).host_pointer(start.as_ptr().cast());
        let allocate =
            vk::MemoryAllocateInfo::default().allocation_size(len).memory_type_index(kind).push_next(&mut import);
        // SAFETY: start and length are aligned as the device asks; the pages outlive the memory
        // (field `_pages`).
        let Ok(memory) = (unsafe { device.raw().allocate_memory(&allocate, None) }) else { return Ok(None) };
        let memory = Owned::new(device, memory, destroyer!(free_memory));
        // SAFETY: fresh buffer and memory of the size that it needs.
        unsafe { device.raw().bind_buffer_memory(raw, memory.get(), 0) }.during("binding imported memory")?;
        Ok(Some(Self { handle, _memory: memory, mapped: None, len, _pages: Some(pages.clone()) }))
    }

    pub(super) fn raw(&self) -> vk::Buffer {
        self.handle.get()
    }

    pub(super) fn len(&self) -> u64 {
        self.len
    }

    /// The mapped bytes; none for a buffer that is not mapped. The caller has waited for the
    /// submits that use it.
    pub(super) fn bytes(&self) -> &[u8] {
        match self.mapped {
            // SAFETY: mapped for `len` bytes as long as `self` lives; `&mut self` alone writes; the
            // owner reads only after the submit that fills the buffer has been waited for.
            Some(start) => unsafe { std::slice::from_raw_parts(start.as_ptr(), self.len as usize) },
            None => &[],
        }
    }

    /// The mapped bytes for writing. The caller has waited for the submits that use it.
    pub(super) fn bytes_mut(&mut self) -> &mut [u8] {
        match self.mapped {
            // SAFETY: as in `bytes`, and `&mut self` makes it the only reference.
            Some(start) => unsafe { std::slice::from_raw_parts_mut(start.as_ptr(), self.len as usize) },
            None => &mut [],
        }
    }
}

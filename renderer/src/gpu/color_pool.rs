//! The colour pool on the device: one layer of a texture array per slot of the pool, uploaded once
//! per generation.

use super::barrier::{self, Access, layout_of};
use super::buffer::{Buffer, BufferUse};
use super::device::Device;
use super::error::{During, GpuError};
use super::frame::FrameRecording;
use super::host_memory::HostMemory;
use super::image::{Image, ImageShape};
use super::owned::{Owned, destroyer};
use super::requirements::DeviceKind;
use super::target::COLOR_FORMAT;
use ash::vk;
use std::sync::Arc;
use terravision_common::ids::{Generation, SlotKey};
use terravision_common::texels::{MipPlace, TexelFormat};
use terravision_common::world::COLOR_MIPS;

/// How the texture is sampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Filtering {
    /// Added to the mip level that the hardware computes.
    pub lod_bias: f32,
    /// Largest anisotropy on hardware devices; the processor's own device never gets any (at 4x it
    /// samples 8 Mpix/s instead of 43, see `docs/performance.md`).
    pub max_anisotropy: f32,
}

/// Tiles that one frame's staging buffer has room for at first; it grows.
const FIRST_STAGED_TILES: u64 = 32;

/// The texture array and what is in it.
#[derive(Debug)]
pub struct ColorPool {
    image: Image,
    sampler: Owned<vk::Sampler>,
    set_layout: Owned<vk::DescriptorSetLayout>,
    _descriptors: Owned<vk::DescriptorPool>,
    set: vk::DescriptorSet,
    /// The pool's shared memory, when it can be read in place.
    imported: Option<Buffer>,
    /// Staging buffer of each frame slot, else.
    staging: Vec<Option<Buffer>>,
    /// Generation that each layer holds.
    generations: Vec<Option<Generation>>,
    /// Copies of the frame being recorded.
    copies: Vec<vk::BufferImageCopy2<'static>>,
    staged_tiles: u64,
    tile_bytes: u64,
    side: u32,
    texels: TexelFormat,
    is_initialized: bool,
}

// SAFETY: the copies' `p_next` pointers are null; everything else is `Send` by itself.
unsafe impl Send for ColorPool {}

impl ColorPool {
    /// A texture array of `layers` tiles of a format, `side` texels wide with border. `shared`: the
    /// pool's memory, to be imported if the device can; without it every tile is copied through a
    /// staging buffer. `slots`: frame slots of the run.
    ///
    /// # Errors
    /// Out of memory.
    pub fn new(
        device: &Arc<Device>,
        [side, layers]: [u32; 2],
        texels: TexelFormat,
        filtering: Filtering,
        shared: Option<&HostMemory>,
        slots: usize,
    ) -> Result<Self, GpuError> {
        let shape = ImageShape {
            format: image_format(texels),
            size: [side, side],
            layers,
            mips: COLOR_MIPS,
            samples: 1,
            usage: vk::ImageUsageFlags::SAMPLED | vk::ImageUsageFlags::TRANSFER_DST,
            aspect: vk::ImageAspectFlags::COLOR,
            is_array: true,
        };
        let image = Image::new(device, shape, "colour pool")?;
        let sampler = sampler(device, filtering)?;
        let (set_layout, descriptors, set) = descriptor(device, &image, &sampler)?;
        let imported = match shared {
            Some(pages) => Buffer::import(device, pages, vk::BufferUsageFlags::TRANSFER_SRC, "shared colour pool")?,
            None => None,
        };
        Ok(Self {
            image,
            sampler,
            set_layout,
            _descriptors: descriptors,
            set,
            imported,
            staging: (0..slots).map(|_| None).collect(),
            generations: vec![None; layers as usize],
            copies: Vec::with_capacity(256 * COLOR_MIPS as usize),
            staged_tiles: 0,
            tile_bytes: texels.tile_bytes(side),
            side,
            texels,
            is_initialized: false,
        })
    }

    /// Number of layers, which is the number of slots that can be named.
    #[must_use]
    pub fn layers(&self) -> u32 {
        self.generations.len() as u32
    }

    /// Whether tiles are read from shared memory in place.
    #[must_use]
    pub fn is_imported(&self) -> bool {
        self.imported.is_some()
    }

    /// Bytes of one tile with its mips.
    #[must_use]
    pub fn tile_bytes(&self) -> u64 {
        self.tile_bytes
    }

    /// Whether the layer already holds this generation. A slot outside the pool holds nothing.
    #[must_use]
    pub fn holds(&self, key: SlotKey) -> bool {
        self.generations.get(key.slot.index()) == Some(&Some(key.generation))
    }

    /// Has the tile at `offset` of the imported memory copied to its layer by the frame being
    /// recorded. The bytes must not change until that frame is finished (frame epochs see to it).
    ///
    /// # Errors
    /// The slot or the offset lies outside, or nothing is imported.
    pub fn upload_imported(&mut self, key: SlotKey, offset: u64) -> Result<(), GpuError> {
        let limit = self.imported.as_ref().map_or(0, Buffer::len);
        let end = offset.saturating_add(self.tile_bytes);
        if end > limit || !offset.is_multiple_of(self.texels.unit_bytes()) {
            return Err(GpuError::TooMany { what: "bytes of the shared colour pool", found: end, limit });
        }
        self.add_copies(key, offset)
    }

    /// Room for a tile that the frame being recorded is to upload; the caller fills it: mips back
    /// to back, row 0 north.
    ///
    /// # Errors
    /// The slot lies outside, or out of memory.
    pub fn upload_staged(&mut self, recording: &FrameRecording<'_>, key: SlotKey) -> Result<&mut [u8], GpuError> {
        let index = recording.slot_index();
        let (staging_count, limit) = (self.staging.len() as u64, self.staged_tiles);
        let Some(place) = self.staging.get_mut(index) else {
            return Err(GpuError::TooMany { what: "frame slots", found: index as u64 + 1, limit: staging_count });
        };
        let offset = limit * self.tile_bytes;
        let needed = offset + self.tile_bytes;
        if place.as_ref().is_none_or(|buffer| buffer.len() < needed) {
            let len = (needed * 2).max(FIRST_STAGED_TILES * self.tile_bytes);
            let mut grown = Buffer::new(recording.device(), len, BufferUse::Upload, "colour staging")?;
            if let Some(old) = place.as_ref() {
                grown.bytes_mut()[..offset as usize].copy_from_slice(&old.bytes()[..offset as usize]);
            }
            *place = Some(grown);
        }
        self.add_copies(key, offset)?;
        self.staged_tiles += 1;
        let bytes = self.staging[index].as_mut().map_or(&mut [][..], Buffer::bytes_mut);
        Ok(&mut bytes[offset as usize..needed as usize])
    }

    fn add_copies(&mut self, key: SlotKey, offset: u64) -> Result<(), GpuError> {
        let limit = u64::from(self.layers());
        let Some(held) = self.generations.get_mut(key.slot.index()) else {
            return Err(GpuError::TooMany { what: "colour slots", found: u64::from(key.slot.get()) + 1, limit });
        };
        *held = Some(key.generation);
        // Rows are dense (of whole blocks), so no row length is named; a level whose side is no
        // multiple of a block is copied up to its edge, which Vulkan allows for the extent alone.
        for (mip, MipPlace { side, offset: start, .. }) in (0..).zip(self.texels.mips(self.side)) {
            self.copies.push(
                vk::BufferImageCopy2::default()
                    .buffer_offset(offset + start)
                    .image_subresource(vk::ImageSubresourceLayers {
                        aspect_mask: vk::ImageAspectFlags::COLOR,
                        mip_level: mip,
                        base_array_layer: key.slot.get(),
                        layer_count: 1,
                    })
                    .image_extent(vk::Extent3D { width: side, height: side, depth: 1 }),
            );
        }
        Ok(())
    }

    /// Records the uploads asked for since the last frame; the number of tiles.
    pub fn record_uploads(&mut self, recording: &mut FrameRecording<'_>) -> u32 {
        let tiles = self.copies.len() as u32 / COLOR_MIPS;
        if tiles == 0 && self.is_initialized {
            return 0;
        }
        let device = Arc::clone(recording.device());
        let commands = recording.commands();
        let previous = if self.is_initialized { Access::Sampled } else { Access::Discarded };
        let staging = self.staging.get(recording.slot_index()).and_then(Option::as_ref);
        // SAFETY: recording, outside of rendering; regions lie inside the image and the buffer
        // (`add_copies` and its callers checked); buffer and image wait for the submit before they
        // go (`Owned`).
        unsafe {
            barrier::image(&device, commands, &self.image, previous, Access::CopyTarget);
            if let Some(buffer) = self.imported.as_ref().or(staging).filter(|_| tiles > 0) {
                let info = vk::CopyBufferToImageInfo2::default()
                    .src_buffer(buffer.raw())
                    .dst_image(self.image.raw())
                    .dst_image_layout(layout_of(Access::CopyTarget))
                    .regions(&self.copies);
                device.raw().cmd_copy_buffer_to_image2(commands, &info);
            }
            barrier::image(&device, commands, &self.image, Access::CopyTarget, Access::Sampled);
        }
        self.is_initialized = true;
        self.copies.clear();
        self.staged_tiles = 0;
        tiles
    }

    pub(super) fn set(&self) -> vk::DescriptorSet {
        self.set
    }

    pub(super) fn set_layout(&self) -> vk::DescriptorSetLayout {
        self.set_layout.get()
    }

    /// The device.
    #[must_use]
    pub fn device(&self) -> &Arc<Device> {
        self.sampler.device()
    }
}

/// The image format of tiles of a format; what a device must be able to do with it is in `adapter`.
pub(super) fn image_format(texels: TexelFormat) -> vk::Format {
    match texels {
        TexelFormat::Rgba8 => COLOR_FORMAT,
        TexelFormat::Bc1 => vk::Format::BC1_RGB_UNORM_BLOCK,
    }
}

fn sampler(device: &Arc<Device>, filtering: Filtering) -> Result<Owned<vk::Sampler>, GpuError> {
    let found = device.capabilities();
    let is_hardware = found.kind > DeviceKind::Cpu;
    let anisotropy = if is_hardware { filtering.max_anisotropy.min(found.max_anisotropy) } else { 1.0 };
    let info = vk::SamplerCreateInfo::default()
        .mag_filter(vk::Filter::LINEAR)
        .min_filter(vk::Filter::LINEAR)
        .mipmap_mode(vk::SamplerMipmapMode::LINEAR)
        .address_mode_u(vk::SamplerAddressMode::CLAMP_TO_EDGE)
        .address_mode_v(vk::SamplerAddressMode::CLAMP_TO_EDGE)
        .mip_lod_bias(filtering.lod_bias)
        .max_lod((COLOR_MIPS - 1) as f32)
        .anisotropy_enable(anisotropy > 1.0)
        .max_anisotropy(anisotropy.max(1.0));
    // SAFETY: anisotropy is within the device's limit and only on where the feature is.
    let raw = unsafe { device.raw().create_sampler(&info, None) }.during("creating a sampler")?;
    device.name(raw, "colour sampler");
    Ok(Owned::new(device, raw, destroyer!(destroy_sampler)))
}

type Descriptor = (Owned<vk::DescriptorSetLayout>, Owned<vk::DescriptorPool>, vk::DescriptorSet);

fn descriptor(device: &Arc<Device>, image: &Image, sampler: &Owned<vk::Sampler>) -> Result<Descriptor, GpuError> {
    let binding = |index, kind| {
        vk::DescriptorSetLayoutBinding::default()
            .binding(index)
            .descriptor_type(kind)
            .descriptor_count(1)
            .stage_flags(vk::ShaderStageFlags::FRAGMENT)
    };
    let bindings = [binding(0, vk::DescriptorType::SAMPLED_IMAGE), binding(1, vk::DescriptorType::SAMPLER)];
    let info = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
    // SAFETY: the structure is complete.
    let layout = unsafe { device.raw().create_descriptor_set_layout(&info, None) }.during("creating a set layout")?;
    let layout = Owned::new(device, layout, destroyer!(destroy_descriptor_set_layout));
    let sizes = [vk::DescriptorType::SAMPLED_IMAGE, vk::DescriptorType::SAMPLER]
        .map(|ty| vk::DescriptorPoolSize { ty, descriptor_count: 1 });
    let info = vk::DescriptorPoolCreateInfo::default().max_sets(1).pool_sizes(&sizes);
    // SAFETY: the structure is complete.
    let pool = unsafe { device.raw().create_descriptor_pool(&info, None) }.during("creating a descriptor pool")?;
    let pool = Owned::new(device, pool, destroyer!(destroy_descriptor_pool));
    let layouts = [layout.get()];
    let info = vk::DescriptorSetAllocateInfo::default().descriptor_pool(pool.get()).set_layouts(&layouts);
    // SAFETY: the pool has room for this one set, which goes with it.
    let set = unsafe { device.raw().allocate_descriptor_sets(&info) }.during("allocating a descriptor set")?[0];
    let images = [vk::DescriptorImageInfo::default().image_view(image.view()).image_layout(layout_of(Access::Sampled))];
    let samplers = [vk::DescriptorImageInfo::default().sampler(sampler.get())];
    let write = |index, kind, infos| {
        vk::WriteDescriptorSet::default().dst_set(set).dst_binding(index).descriptor_type(kind).image_info(infos)
    };
    let writes = [
        write(0, vk::DescriptorType::SAMPLED_IMAGE, &images[..]),
        write(1, vk::DescriptorType::SAMPLER, &samplers[..]),
    ];
    // SAFETY: set, view and sampler are alive; the set is in no submit yet.
    unsafe { device.raw().update_descriptor_sets(&writes, &[]) };
    device.name(set, "colour pool");
    Ok((layout, pool, set))
}

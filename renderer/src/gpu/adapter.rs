//! The physical devices of the machine: what they can do, which one to take.

use super::color_pool::image_format;
use super::device::DeviceChoice;
use super::error::{During, GpuError};
use super::instance::Instance;
use super::requirements::{Capabilities, DeviceKind, Needs, missing_of};
use ash::{ext, khr, vk};
use serde::Serialize;
use std::ffi::CStr;
use terravision_common::texels::TexelFormat;

/// A device, for `terravision doctor`.
#[derive(Debug, Clone, Serialize)]
pub struct AdapterDescription {
    /// Its number in the loader's list.
    pub index: usize,
    /// Its name.
    pub name: String,
    /// Driver and version.
    pub driver: String,
    /// Its kind.
    #[serde(rename = "type")]
    pub kind: DeviceKind,
    /// Vulkan version.
    pub vulkan: String,
    /// Whether it is the one that would be used.
    pub is_chosen: bool,
    /// Whether shared memory is used in place; without it, it is copied.
    pub has_host_import: bool,
    /// Whether it samples block-compressed textures.
    pub has_block_compression: bool,
    /// All that it lacks; usable when empty.
    pub missing: Vec<String>,
}

/// All devices, and which one `choice` picks.
///
/// # Errors
/// No loader or no driver.
pub fn describe_adapters(choice: &DeviceChoice, needs: &Needs) -> Result<Vec<AdapterDescription>, GpuError> {
    let instance = Instance::new(false)?;
    let found = enumerate(&instance)?;
    let chosen = choose(&found.iter().map(|(_, c)| c).collect::<Vec<_>>(), choice, needs).ok();
    Ok(found
        .into_iter()
        .enumerate()
        .map(|(index, (_, capabilities))| AdapterDescription {
            index,
            missing: missing_of(&capabilities, needs).iter().map(ToString::to_string).collect(),
            driver: capabilities.driver,
            kind: capabilities.kind,
            vulkan: format!("{}.{}", capabilities.api_version[0], capabilities.api_version[1]),
            is_chosen: chosen == Some(index),
            has_host_import: capabilities.host_import_alignment.is_some(),
            has_block_compression: capabilities.has_block_compression,
            name: capabilities.name,
        })
        .collect())
}

/// Index of the device to use: the one that was asked for, else the best kind among those that lack
/// nothing (the first of equals). When all lack something, the best kind.
pub(super) fn choose(found: &[&Capabilities], choice: &DeviceChoice, needs: &Needs) -> Result<usize, GpuError> {
    if found.is_empty() {
        return Err(GpuError::NoDevice);
    }
    let wanted = match choice {
        DeviceChoice::Best => {
            let rank = |c: &Capabilities| (missing_of(c, needs).is_empty(), c.kind);
            let best = found.iter().map(|c| rank(c)).max();
            return found.iter().position(|c| Some(rank(c)) == best).ok_or(GpuError::NoDevice);
        }
        DeviceChoice::Matching(text) => text,
    };
    let by_index = wanted.parse::<usize>().ok().filter(|&index| index < found.len());
    let lower = wanted.to_lowercase();
    by_index.or_else(|| found.iter().position(|c| c.name.to_lowercase().contains(&lower))).ok_or_else(|| {
        let list: Vec<String> = found.iter().enumerate().map(|(i, c)| format!("{i}: {}", c.name)).collect();
        GpuError::DeviceNotFound { wanted: wanted.clone(), available: list.join(", ") }
    })
}

/// All physical devices with their capabilities, in the loader's order.
pub(super) fn enumerate(instance: &Instance) -> Result<Vec<(vk::PhysicalDevice, Capabilities)>, GpuError> {
    // SAFETY: the instance is alive.
    let physical = unsafe { instance.raw().enumerate_physical_devices() }.during("listing the Vulkan devices")?;
    physical.into_iter().map(|device| Ok((device, capabilities_of(instance, device)?))).collect()
}

/// The family of queues to draw with.
pub(super) fn graphics_family(instance: &Instance, device: vk::PhysicalDevice) -> Option<(u32, u32)> {
    // SAFETY: `device` comes from this instance.
    let families = unsafe { instance.raw().get_physical_device_queue_family_properties(device) };
    let index = families.iter().position(|family| family.queue_flags.contains(vk::QueueFlags::GRAPHICS))?;
    Some((index as u32, families[index].timestamp_valid_bits))
}

fn capabilities_of(instance: &Instance, device: vk::PhysicalDevice) -> Result<Capabilities, GpuError> {
    let raw = instance.raw();
    // SAFETY: `device` comes from this instance (likewise in the next calls).
    let extensions =
        unsafe { raw.enumerate_device_extension_properties(device) }.during("listing device extensions")?;
    let has = |name: &CStr| extensions.iter().any(|found| found.extension_name_as_c_str() == Ok(name));
    let has_import = has(ext::external_memory_host::NAME);
    // SAFETY: as above; the plain query is valid for every version of Vulkan.
    let basic = unsafe { raw.get_physical_device_properties(device) };
    let api_version = [vk::api_version_major(basic.api_version), vk::api_version_minor(basic.api_version)];

    let mut driver = vk::PhysicalDeviceDriverProperties::default();
    let mut import = vk::PhysicalDeviceExternalMemoryHostPropertiesEXT::default();
    let mut features12 = vk::PhysicalDeviceVulkan12Features::default();
    let mut features13 = vk::PhysicalDeviceVulkan13Features::default();
    let mut features = vk::PhysicalDeviceFeatures::default();
    // The structures of 1.2 and 1.3 may be asked for only where these versions are.
    if api_version >= [1, 3] {
        let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut driver);
        if has_import {
            properties = properties.push_next(&mut import);
        }
        // SAFETY: the chain consists of structures that this version and these extensions know.
        unsafe { raw.get_physical_device_properties2(device, &mut properties) };
        let mut asked = vk::PhysicalDeviceFeatures2::default().push_next(&mut features12).push_next(&mut features13);
        // SAFETY: as above.
        unsafe { raw.get_physical_device_features2(device, &mut asked) };
        features = asked.features;
    }
    let family = graphics_family(instance, device);
    let limits = &basic.limits;
    let text = |bytes: Result<&CStr, _>| bytes.map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let name = text(basic.device_name_as_c_str());
    let driver = format!("{} {}", text(driver.driver_name_as_c_str()), text(driver.driver_info_as_c_str()));
    Ok(Capabilities {
        name,
        driver: driver.trim().to_owned(),
        kind: match basic.device_type {
            vk::PhysicalDeviceType::DISCRETE_GPU => DeviceKind::Discrete,
            vk::PhysicalDeviceType::INTEGRATED_GPU => DeviceKind::Integrated,
            vk::PhysicalDeviceType::VIRTUAL_GPU => DeviceKind::Virtual,
            vk::PhysicalDeviceType::CPU => DeviceKind::Cpu,
            _ => DeviceKind::Other,
        },
        api_version,
        has_graphics_queue: family.is_some(),
        has_dynamic_rendering: features13.dynamic_rendering == vk::TRUE,
        has_synchronization2: features13.synchronization2 == vk::TRUE,
        has_timeline_semaphore: features12.timeline_semaphore == vk::TRUE,
        has_robust_buffer_access: features.robust_buffer_access == vk::TRUE,
        has_color_format: has_format(instance, device, vk::Format::R8G8B8A8_UNORM, {
            use vk::FormatFeatureFlags as F;
            F::SAMPLED_IMAGE_FILTER_LINEAR | F::COLOR_ATTACHMENT | F::TRANSFER_SRC | F::TRANSFER_DST
        }),
        has_depth_format: has_format(
            instance,
            device,
            vk::Format::D32_SFLOAT,
            vk::FormatFeatureFlags::DEPTH_STENCIL_ATTACHMENT | vk::FormatFeatureFlags::TRANSFER_SRC,
        ),
        has_block_compression: features.texture_compression_bc == vk::TRUE
            && has_format(instance, device, image_format(TexelFormat::Bc1), {
                use vk::FormatFeatureFlags as F;
                F::SAMPLED_IMAGE_FILTER_LINEAR | F::TRANSFER_DST
            }),
        max_image_side: limits.max_image_dimension2_d,
        max_image_layers: limits.max_image_array_layers,
        max_framebuffer: [
            limits.max_framebuffer_width.min(limits.max_viewport_dimensions[0]),
            limits.max_framebuffer_height.min(limits.max_viewport_dimensions[1]),
        ],
        sample_counts: (limits.framebuffer_color_sample_counts & limits.framebuffer_depth_sample_counts).as_raw(),
        max_storage_range: limits.max_storage_buffer_range.into(),
        max_push_constants: limits.max_push_constants_size,
        max_anisotropy: if features.sampler_anisotropy == vk::TRUE { limits.max_sampler_anisotropy } else { 1.0 },
        host_import_alignment: has_import.then_some(import.min_imported_host_pointer_alignment),
        timestamp_period_nanos: family.filter(|(_, bits)| *bits == 64).map(|_| limits.timestamp_period.into()),
        has_swapchain: has(khr::swapchain::NAME),
    })
}

fn has_format(
    instance: &Instance,
    device: vk::PhysicalDevice,
    format: vk::Format,
    wanted: vk::FormatFeatureFlags,
) -> bool {
    // SAFETY: `device` comes from this instance.
    let found = unsafe { instance.raw().get_physical_device_format_properties(device, format) };
    found.optimal_tiling_features.contains(wanted)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn device(name: &str, kind: DeviceKind, is_complete: bool) -> Capabilities {
        Capabilities {
            name: name.into(),
            driver: String::new(),
            kind,
            api_version: if is_complete { [1, 3] } else { [1, 2] },
            has_graphics_queue: true,
            has_dynamic_rendering: true,
            has_synchronization2: true,
            has_timeline_semaphore: true,
            has_robust_buffer_access: true,
            has_color_format: true,
            has_depth_format: true,
            has_block_compression: true,
            max_image_side: 16384,
            max_image_layers: 2048,
            max_framebuffer: [16384; 2],
            sample_counts: 5,
            max_storage_range: 1 << 27,
            max_push_constants: 128,
            max_anisotropy: 16.0,
            host_import_alignment: Some(4096),
            timestamp_period_nanos: Some(1.0),
            has_swapchain: true,
        }
    }

    #[test]
    fn the_best_complete_device_is_chosen() {
        let cpu = device("llvmpipe", DeviceKind::Cpu, true);
        let gpu = device("Big GPU", DeviceKind::Discrete, true);
        let old = device("Old GPU", DeviceKind::Discrete, false);
        let best = |list: &[&Capabilities]| choose(list, &DeviceChoice::Best, &Needs::LEAST).unwrap();
        assert_eq!(best(&[&cpu, &gpu]), 1);
        assert_eq!(best(&[&old, &cpu]), 1);
        assert_eq!(best(&[&gpu, &cpu, &gpu]), 0);
        assert!(matches!(choose(&[], &DeviceChoice::Best, &Needs::LEAST), Err(GpuError::NoDevice)));
    }

    #[test]
    fn a_device_can_be_asked_for_by_number_and_by_part_of_its_name() {
        let cpu = device("llvmpipe (LLVM 15)", DeviceKind::Cpu, true);
        let gpu = device("Big GPU 9000", DeviceKind::Discrete, true);
        let pick = |text: &str| choose(&[&gpu, &cpu], &DeviceChoice::Matching(text.into()), &Needs::LEAST);
        assert_eq!(pick("1").unwrap(), 1);
        assert_eq!(pick("LLVM").unwrap(), 1);
        assert_eq!(pick("9000").unwrap(), 0);
        let error = pick("radeon").unwrap_err().to_string();
        assert!(error.contains("0: Big GPU 9000, 1: llvmpipe (LLVM 15)"), "{error}");
    }
}

//! The Vulkan device that a flight would draw with, as the renderer tells of it (`--doctor-json`),
//! and whether colour tiles are worth compressing for it.

use crate::machine::outcome;
use serde_json::Value;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use terravision_common::technique::FoundDevice;

/// The question, while the renderer looks around: it takes a while, in which the launcher reads its
/// own input.
#[derive(Debug)]
pub struct DeviceQuestion {
    renderer: Option<Child>,
    failure: String,
}

impl DeviceQuestion {
    /// Asks the renderer beside the launcher, in this folder.
    #[must_use]
    pub fn ask(programs: &Path) -> Self {
        let program = programs.join("terravision-renderer");
        let mut command = Command::new(&program);
        command.arg("--doctor-json").stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        match command.spawn() {
            Ok(child) => Self { renderer: Some(child), failure: String::new() },
            Err(error) => Self { renderer: None, failure: format!("{}: {error}", program.display()) },
        }
    }

    /// All that it found; or what went wrong, a message.
    ///
    /// # Errors
    /// The renderer cannot be asked.
    pub fn answer(mut self) -> Result<Value, String> {
        let Some(renderer) = self.renderer.take() else { return Err(std::mem::take(&mut self.failure)) };
        let output = renderer.wait_with_output().map_err(|error| error.to_string())?;
        let text = outcome(&output)?;
        serde_json::from_str(&text).map_err(|error| format!("the renderer's answer is not JSON: {error}"))
    }
}

impl Drop for DeviceQuestion {
    fn drop(&mut self) {
        if let Some(renderer) = &mut self.renderer {
            // It may have ended by itself.
            drop(renderer.kill());
            drop(renderer.wait());
        }
    }
}

/// The devices of an answer.
#[must_use]
pub fn devices(answer: &Value) -> &[Value] {
    let devices = answer.as_array().or_else(|| answer.get("devices").and_then(Value::as_array));
    devices.map_or(&[][..], Vec::as_slice)
}

/// The device that a flight would use.
#[must_use]
pub fn chosen(answer: &Value) -> Option<&Value> {
    let devices = devices(answer);
    devices.iter().find(|device| device["is_chosen"] == true).or(devices.first())
}

/// What a device lacks of what any flight needs.
#[must_use]
pub fn lacks(device: &Value) -> Vec<&str> {
    device["missing"].as_array().into_iter().flatten().filter_map(Value::as_str).collect()
}

/// What the device that a flight would use is, as techniques are chosen by it.
#[must_use]
pub fn found(answer: Result<&Value, &str>) -> FoundDevice {
    match answer.ok().and_then(chosen).filter(|device| lacks(device).is_empty()) {
        None => FoundDevice::Unusable,
        Some(device) if is_gpu(device) => FoundDevice::Gpu,
        Some(_) => FoundDevice::Software,
    }
}

fn is_gpu(device: &Value) -> bool {
    matches!(device["type"].as_str(), Some("discrete" | "integrated" | "virtual"))
}

/// Whether colour tiles can be compressed for a device, and whether that pays; with the reason, a
/// clause.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Compression {
    /// The device is made for it.
    Fast(String),
    /// It can, but is slower at it.
    Slow(String),
    /// It cannot.
    Impossible(String),
}

impl Compression {
    /// Of the renderer's answer.
    #[must_use]
    pub fn of(answer: Result<&Value, &str>) -> Self {
        let device = match answer {
            Ok(answer) => chosen(answer),
            Err(message) => return Self::Impossible(message.to_owned()),
        };
        let Some(device) = device.filter(|device| lacks(device).is_empty()) else {
            return Self::Impossible("there is no Vulkan device that can be used".to_owned());
        };
        let name = device["name"].as_str().unwrap_or("the device");
        if device["has_block_compression"] != true {
            return Self::Impossible(format!("{name} lacks the feature textureCompressionBC"));
        }
        match device["type"].as_str() {
            _ if is_gpu(device) => Self::Fast(format!("{name} is a GPU, which decodes them in hardware")),
            Some("cpu") => Self::Slow(format!("{name} is the processor itself, which decodes every texel in software")),
            _ => Self::Slow(format!("{name} does not say what kind of device it is")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn of(kind: &str, has_it: bool, missing: &[&str]) -> Compression {
        let others = json!({"name": "other", "type": "cpu", "is_chosen": false, "missing": []});
        let device = json!({"name": "it", "type": kind, "is_chosen": true, "has_block_compression": has_it,
                            "missing": missing});
        Compression::of(Ok(&json!({"devices": [others, device]})))
    }

    #[test]
    fn only_hardware_that_has_the_feature_is_fast() {
        for kind in ["discrete", "integrated", "virtual"] {
            assert!(matches!(of(kind, true, &[]), Compression::Fast(why) if why.starts_with("it ")));
            assert!(
                matches!(of(kind, false, &[]), Compression::Impossible(why) if why.contains("textureCompressionBC"))
            );
        }
        assert!(matches!(of("cpu", true, &[]), Compression::Slow(_)));
        assert!(matches!(of("other", true, &[]), Compression::Slow(_)));
        assert!(matches!(of("discrete", true, &["a queue"]), Compression::Impossible(_)));
        assert!(matches!(Compression::of(Ok(&json!({"devices": []}))), Compression::Impossible(_)));
        assert_eq!(Compression::of(Err("no renderer")), Compression::Impossible("no renderer".to_owned()));
    }

    #[test]
    fn a_renderer_that_is_not_there_is_an_answer_too() {
        let message = DeviceQuestion::ask(Path::new("/nonexistent")).answer().unwrap_err();
        assert!(message.starts_with("/nonexistent/terravision-renderer: "), "{message}");
    }
}

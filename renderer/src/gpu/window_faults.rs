//! What a window answers in place of the desktop, for tests: they have no other way to make it lose
//! its surface, say.

use ash::vk;
use std::sync::atomic::{AtomicU64, Ordering};

/// A call whose answer may be replaced.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Call {
    /// Taking an image.
    Acquire,
    /// Showing it.
    Present,
}

/// Answers that are replaced.
#[derive(Debug, Default)]
pub struct WindowFaults {
    planned: Vec<(Call, u64, vk::Result)>,
    /// Calls of each kind so far.
    calls: [AtomicU64; 2],
}

impl WindowFaults {
    /// Of a text like `acquire 5 surface-lost, present 9 out-of-date`: a call, its number from 1, and
    /// the answer. `None` for another text.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let fault = |text: &str| {
            let mut words = text.split_whitespace();
            let call = match words.next()? {
                "acquire" => Call::Acquire,
                "present" => Call::Present,
                _ => return None,
            };
            let number = words.next()?.parse().ok()?;
            let result = match words.next()? {
                "out-of-date" => vk::Result::ERROR_OUT_OF_DATE_KHR,
                "surface-lost" => vk::Result::ERROR_SURFACE_LOST_KHR,
                "device-lost" => vk::Result::ERROR_DEVICE_LOST,
                "timeout" => vk::Result::TIMEOUT,
                _ => return None,
            };
            words.next().is_none().then_some((call, number, result))
        };
        let planned = text.split(',').map(fault).collect::<Option<_>>()?;
        Some(Self { planned, calls: Default::default() })
    }

    /// The next call of this kind is made; what it answers, where that is replaced.
    pub(super) fn next(&self, call: Call) -> Option<vk::Result> {
        // Relaxed: one thread shows pictures.
        let number = self.calls[call as usize].fetch_add(1, Ordering::Relaxed) + 1;
        let planned = self.planned.iter().find(|(of, at, _)| *of == call && *at == number);
        planned.map(|(_, _, result)| *result)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_are_replaced_once() {
        let faults = WindowFaults::parse("acquire 2 surface-lost, present 1 timeout").unwrap();
        let lost = Some(vk::Result::ERROR_SURFACE_LOST_KHR);
        assert_eq!([(); 3].map(|()| faults.next(Call::Acquire)), [None, lost, None]);
        assert_eq!([(); 2].map(|()| faults.next(Call::Present)), [Some(vk::Result::TIMEOUT), None]);
        for text in ["", "acquire", "acquire 2 lost", "open 1 timeout", "acquire 1 timeout now"] {
            assert!(WindowFaults::parse(text).is_none(), "{text}");
        }
    }
}

//! Which vector instructions work is done with, found out when the program runs. The same bits by
//! all of them (`common::simd`).
#![cfg_attr(
    target_arch = "x86_64",
    expect(unsafe_code, reason = "a function for processors with certain instructions is called where they are")
)]

#[cfg(target_arch = "x86_64")]
use super::{Avx2, Avx512};
use super::{Portable, Simd};
use crate::terminal::complain;
use std::sync::OnceLock;

/// The environment variable that has narrower vectors used than there are.
const VARIABLE: &str = "TERRAVISION_INSTRUCTIONS";

/// What is done by whichever instructions there are. Implementations are inlined as a whole, or
/// they gain nothing.
pub trait Work {
    /// What comes of it.
    type Output;
    /// Does it.
    fn run<S: Simd>(self, simd: S) -> Self::Output;
}

/// Vector instructions that this processor has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Instructions(Set);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Set {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Instructions {
    /// Those that every processor of this kind has.
    pub const PORTABLE: Self = Self(Set::Portable);

    /// All that this processor has, the widest last.
    #[must_use]
    pub fn all() -> Vec<Self> {
        let mut found = vec![Self::PORTABLE];
        #[cfg(target_arch = "x86_64")]
        {
            if std::is_x86_feature_detected!("avx2") {
                found.push(Self(Set::Avx2));
                let is_wide = std::is_x86_feature_detected!("avx512f")
                    && std::is_x86_feature_detected!("avx512bw")
                    && std::is_x86_feature_detected!("avx512dq")
                    && std::is_x86_feature_detected!("avx512vl");
                if is_wide {
                    found.push(Self(Set::Avx512));
                }
            }
        }
        found
    }

    /// The widest that this processor has, or those that [`VARIABLE`] names, to compare with.
    #[must_use]
    pub fn widest() -> Self {
        static CHOSEN: OnceLock<Instructions> = OnceLock::new();
        *CHOSEN.get_or_init(|| {
            let widest = Self::all().pop().unwrap_or(Self::PORTABLE);
            let Ok(wanted) = std::env::var(VARIABLE) else { return widest };
            Self::named(&wanted).unwrap_or_else(|| {
                let names = Self::all().iter().map(|found| found.name()).collect::<Vec<_>>().join(", ");
                let used = widest.name();
                complain(&format!("{VARIABLE}={wanted} is none of what this processor has ({names}); {used} is used"));
                widest
            })
        })
    }

    /// Those of this name, in any case, if this processor has them.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::all().into_iter().find(|found| found.name().eq_ignore_ascii_case(name.trim()))
    }

    /// What they are called.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self.0 {
            Set::Portable => "portable",
            #[cfg(target_arch = "x86_64")]
            Set::Avx2 => "AVX2",
            #[cfg(target_arch = "x86_64")]
            Set::Avx512 => "AVX-512",
        }
    }

    /// Does work with them.
    pub fn run<W: Work>(self, work: W) -> W::Output {
        match self.0 {
            Set::Portable => work.run(Portable),
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `Set::Avx2` is made by `Instructions::all` alone, where the processor has AVX2.
            Set::Avx2 => unsafe { run_with_avx2(work) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `Set::Avx512` is made by `Instructions::all` alone, where the processor has AVX2 and these
            // parts of AVX-512.
            Set::Avx512 => unsafe { run_with_avx512(work) },
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn run_with_avx2<W: Work>(work: W) -> W::Output {
    // SAFETY: this function is called where the processor has AVX2.
    work.run(unsafe { Avx2::new() })
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,avx512f,avx512bw,avx512dq,avx512vl")]
fn run_with_avx512<W: Work>(work: W) -> W::Output {
    // SAFETY: this function is called where the processor has AVX2 and these parts of AVX-512.
    work.run(unsafe { Avx512::new() })
}

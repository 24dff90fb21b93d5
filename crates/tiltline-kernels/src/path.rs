//! Which instructions the kernels run on, chosen at run time.

#[cfg(all(target_arch = "x86_64", not(miri)))]
use crate::lanes::{Avx2, Avx512};
use crate::lanes::{Lanes, Portable};
use std::fmt;

/// A set of instructions that kernels exist for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Instructions {
    /// 16 floats at a time (x86-64, AVX-512 F, VL, BW and DQ with FMA).
    Avx512,
    /// 8 floats at a time (x86-64, AVX2 and FMA).
    Avx2,
    /// Plain Rust for any machine.
    Portable,
}

impl Instructions {
    /// All of them, best first.
    pub const ALL: [Self; 3] = [Self::Avx512, Self::Avx2, Self::Portable];

    fn is_present(self) -> bool {
        // The standard library caches the answer. Under Miri, and so wherever undefined behaviour is looked for, only
        // the portable path exists.
        match self {
            #[cfg(all(target_arch = "x86_64", not(miri)))]
            Self::Avx512 => {
                is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512vl")
                    && is_x86_feature_detected!("avx512bw")
                    && is_x86_feature_detected!("avx512dq")
                    && is_x86_feature_detected!("fma")
            }
            #[cfg(all(target_arch = "x86_64", not(miri)))]
            Self::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            #[cfg(not(all(target_arch = "x86_64", not(miri))))]
            Self::Avx512 | Self::Avx2 => false,
            Self::Portable => true,
        }
    }
}

impl fmt::Display for Instructions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Avx512 => "AVX-512",
            Self::Avx2 => "AVX2+FMA",
            Self::Portable => "portable",
        })
    }
}

/// Instructions that this machine is known to have. A kernel given a path may rely on them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Path(Instructions);

impl Path {
    /// The best path of this machine.
    #[must_use]
    pub fn best() -> Self {
        Instructions::ALL.into_iter().find_map(Self::forced).unwrap_or(Self(Instructions::Portable))
    }

    /// The path with these instructions, or `None` where the machine lacks them. For tests and benchmarks.
    #[must_use]
    pub fn forced(instructions: Instructions) -> Option<Self> {
        instructions.is_present().then_some(Self(instructions))
    }

    /// What it runs on.
    #[must_use]
    pub fn instructions(self) -> Instructions {
        self.0
    }

    /// Output channels in a full register tile; weights are packed accordingly.
    pub(crate) fn tile(self) -> usize {
        match self.0 {
            #[cfg(all(target_arch = "x86_64", not(miri)))]
            Instructions::Avx512 => Avx512::TILE,
            #[cfg(all(target_arch = "x86_64", not(miri)))]
            Instructions::Avx2 => Avx2::TILE,
            _ => Portable::TILE,
        }
    }

    /// Runs a kernel with these instructions.
    pub(crate) fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self.0 {
            // SAFETY: a `Path` to AVX-512 is only made by `forced`, after the machine was found to have it.
            #[cfg(all(target_arch = "x86_64", not(miri)))]
            Instructions::Avx512 => unsafe { run_avx512(kernel) },
            // SAFETY: likewise for AVX2 and FMA.
            #[cfg(all(target_arch = "x86_64", not(miri)))]
            Instructions::Avx2 => unsafe { run_avx2(kernel) },
            _ => kernel.run(Portable),
        }
    }
}

/// Work that is compiled once for each path.
///
/// `run`, and all that it calls per element, must be `#[inline(always)]` and free of closures: only what is inlined into the
/// functions below is compiled for their instructions.
pub(crate) trait Kernel {
    type Output;
    fn run<L: Lanes>(self, lanes: L) -> Self::Output;
}

// All five together: without the last four the compiler may use only 16 of the 32 registers, and spills.
#[cfg(all(target_arch = "x86_64", not(miri)))]
#[target_feature(enable = "avx512f,avx512vl,avx512bw,avx512dq,fma")]
fn run_avx512<K: Kernel>(kernel: K) -> K::Output {
    kernel.run(Avx512::new())
}

#[cfg(all(target_arch = "x86_64", not(miri)))]
#[target_feature(enable = "avx2,fma")]
fn run_avx2<K: Kernel>(kernel: K) -> K::Output {
    kernel.run(Avx2::new())
}

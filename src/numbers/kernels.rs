//! Vectorized kernels: matrix products, elementwise functions, sine and cosine, and workspaces.
//!
//! The instruction set is chosen at run time ([`SimdLevel`]), since builds use default target flags. A
//! portable path serves all other processors. Contains the only unsafe code of the library. Start
//! with [`dispatch`].

pub mod elementwise;
pub mod gemm;
pub(crate) mod scratch;
pub mod tanh;
pub mod trig;

use std::sync::OnceLock;

/// Instruction set of the kernels, in ascending order. Each level implies the levels before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd)]
pub enum SimdLevel {
    /// Plain Rust, vectorized for the target of the build.
    Portable,
    /// AVX2 and fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AVX-512 (F, VL, DQ, BW).
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl SimdLevel {
    /// All levels of this processor, in ascending order.
    pub fn available() -> Vec<SimdLevel> {
        #[allow(unused_mut)]
        let mut levels = vec![SimdLevel::Portable];
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            levels.push(SimdLevel::Avx2);
            if is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512bw")
            {
                levels.push(SimdLevel::Avx512);
            }
        }
        levels
    }

    /// The highest level of this processor. Cached after the first call.
    #[inline]
    pub fn best() -> SimdLevel {
        static BEST: OnceLock<SimdLevel> = OnceLock::new();
        *BEST.get_or_init(|| SimdLevel::available().pop().unwrap_or(SimdLevel::Portable))
    }

    /// Returns the level.
    ///
    /// # Panics
    /// If this processor does not support it.
    #[inline]
    fn checked(self) -> SimdLevel {
        assert!(self <= SimdLevel::best(), "this processor has no {self:?}");
        self
    }
}

/// Code to be compiled once per instruction set.
///
/// Implement `run` as `#[inline(always)]`. Code that is not inlined into the dispatching function
/// is compiled for the default target: correct, but slower.
pub trait Vectorized {
    /// Executes the code. `FMA` states whether fused multiply-add is an instruction.
    fn run<const FMA: bool>(self);
}

/// Runs `work` with the instructions of `level`.
///
/// # Panics
/// If this processor does not support `level`.
#[inline]
pub fn dispatch(level: SimdLevel, work: impl Vectorized) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2,fma")]
        unsafe fn avx2(work: impl Vectorized) {
            work.run::<true>();
        }
        #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,avx2,fma")]
        unsafe fn avx512(work: impl Vectorized) {
            work.run::<true>();
        }
        match level.checked() {
            SimdLevel::Portable => {}
            // SAFETY: `checked` asserts that this processor supports the level.
            SimdLevel::Avx2 => return unsafe { avx2(work) },
            SimdLevel::Avx512 => return unsafe { avx512(work) },
        }
    }
    let _ = level;
    work.run::<false>();
}

/// Whether simulators process samples in lanes, given the `FMA` of the current dispatch.
///
/// On x86-64 without AVX2, samples are processed one by one with bit-identical results. This avoids
/// a second compilation of all simulators in lanes for such processors.
#[inline(always)]
pub(crate) fn in_lanes<const FMA: bool>() -> bool {
    FMA || !cfg!(target_arch = "x86_64")
}

/// Whether rollouts on this processor use lanes; see [`in_lanes`].
pub(crate) fn has_lanes() -> bool {
    SimdLevel::best() != SimdLevel::Portable || !cfg!(target_arch = "x86_64")
}

/// Runs `work` with AVX2 if available, else with the portable path.
///
/// Used for simulators. Eight lanes gain little from wider registers, and a further level would
/// increase compile time.
#[inline]
pub fn dispatch_narrow(work: impl Vectorized) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2,fma")]
        unsafe fn avx2(work: impl Vectorized) {
            work.run::<true>();
        }
        if SimdLevel::best() != SimdLevel::Portable && !portable::is_forced() {
            // SAFETY: all levels above `Portable` include these instructions.
            return unsafe { avx2(work) };
        }
    }
    work.run::<false>();
}

/// Runs `work` on lanes with AVX2; portably on other architectures than x86-64.
///
/// # Panics
/// On x86-64 without AVX2, where simulators do not use lanes (see [`in_lanes`]).
#[inline]
pub(crate) fn dispatch_lanes(work: impl Vectorized) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2,fma")]
        unsafe fn avx2(work: impl Vectorized) {
            work.run::<true>();
        }
        assert!(SimdLevel::best() != SimdLevel::Portable, "systems take eight lanes at once only with AVX2, else four");
        // SAFETY: all levels above `Portable` include these instructions.
        unsafe { avx2(work) }
    }
    #[cfg(not(target_arch = "x86_64"))]
    work.run::<false>();
}

/// Forces the portable path of [`dispatch_narrow`], for tests.
#[cfg(test)]
pub(crate) mod portable {
    use std::cell::Cell;

    thread_local! {
        static FORCED: Cell<bool> = const { Cell::new(false) };
    }

    pub(crate) fn is_forced() -> bool {
        FORCED.get()
    }

    /// Runs `work` with [`dispatch_narrow`](super::dispatch_narrow) forced to the portable path on
    /// this thread.
    pub(crate) fn force<T>(work: impl FnOnce() -> T) -> T {
        FORCED.set(true);
        let result = work();
        FORCED.set(false);
        result
    }
}

#[cfg(not(test))]
mod portable {
    #[inline(always)]
    pub(super) fn is_forced() -> bool {
        false
    }
}

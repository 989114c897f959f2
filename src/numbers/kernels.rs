//! Vectorized kernels: matrix products, elementwise functions, sine and cosine.
//!
//! Builds use default target flags. [`SimdLevel::best`] therefore detects the instruction set of
//! the processor at run time, and [`dispatch`] runs code compiled for a given instruction set. A
//! portable path serves architectures other than x86-64 and aarch64. Simulators and policies have
//! it on x86-64 only with the feature `portable`, because it lengthens the build by a quarter.
//! Contains the only unsafe code of the library. Start with [`dispatch`].

pub mod elementwise;
pub mod gemm;
pub mod interpreter;
pub mod tanh;
pub mod trig;

use std::sync::OnceLock;

/// Instruction sets of the kernels, in ascending order. Each level implies the levels before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd)]
pub enum SimdLevel {
    /// Plain Rust without fused operations, vectorized for the target of the build.
    Portable,
    /// NEON with fused multiply-add. Every aarch64 processor supports it.
    #[cfg(target_arch = "aarch64")]
    Neon,
    /// AVX2 and fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AVX-512 (F, VL, DQ, BW).
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl SimdLevel {
    /// All levels that this processor supports, in ascending order.
    pub fn available() -> Vec<SimdLevel> {
        #[allow(unused_mut)]
        let mut levels = vec![SimdLevel::Portable];
        #[cfg(target_arch = "aarch64")]
        levels.push(SimdLevel::Neon);
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

    /// The highest level that this processor supports. Cached after the first call.
    #[inline]
    pub fn best() -> SimdLevel {
        static BEST: OnceLock<SimdLevel> = OnceLock::new();
        *BEST.get_or_init(|| SimdLevel::available().pop().unwrap_or(SimdLevel::Portable))
    }

    /// Returns the level if this processor supports it.
    ///
    /// # Panics
    /// If this processor does not support the level.
    #[inline]
    fn checked(self) -> SimdLevel {
        assert!(
            self <= SimdLevel::best(),
            "this processor does not support {self:?}; use `SimdLevel::best()`"
        );
        self
    }
}

/// Code to be compiled once per instruction set.
///
/// Implement `run` as `#[inline(always)]`. Code that is not inlined into the dispatching function
/// is compiled for the default target: correct, but slower.
pub trait Vectorized {
    /// Executes the code. `FMA` is true if the instruction set has fused multiply-add.
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
    #[cfg(target_arch = "aarch64")]
    if level == SimdLevel::Neon {
        return work.run::<true>();
    }
    let _ = level;
    work.run::<false>();
}

/// Runs `work` with AVX2 or NEON, or with the portable path, bit for bit equal.
///
/// Used for simulators and policies on eight lanes, which gain little from wider registers. A
/// further level would increase compile time.
///
/// # Panics
/// Where [`check_processor`] returns an error.
#[inline]
pub fn dispatch_lanes(work: impl Vectorized) {
    if portable::is_forced() {
        return work.run::<false>();
    }
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2,fma")]
        unsafe fn avx2(work: impl Vectorized) {
            work.run::<true>();
        }
        if SimdLevel::best() != SimdLevel::Portable {
            // SAFETY: all levels above `Portable` include these instructions.
            return unsafe { avx2(work) };
        }
        #[cfg(not(any(test, feature = "portable")))]
        unsupported();
    }
    // NEON has fused multiply-add.
    #[cfg(any(test, feature = "portable", not(target_arch = "x86_64")))]
    work.run::<{ cfg!(target_arch = "aarch64") }>();
}

/// Returns an error if simulations need instructions that this processor does not have.
///
/// # Errors
/// The processor is an x86-64 processor without AVX2 and fused multiply-add, and the build has no
/// feature `portable`. Rollouts then panic with the same message.
pub fn check_processor() -> Result<(), &'static str> {
    let runs = cfg!(any(feature = "portable", not(target_arch = "x86_64")))
        || SimdLevel::best() != SimdLevel::Portable;
    if runs { Ok(()) } else { Err(UNSUPPORTED) }
}

const UNSUPPORTED: &str = "this processor has no AVX2 and fused multiply-add, which physgrad needs on x86-64; build it with the feature \
                           `portable`, as in `cargo build --release --features portable`";

#[cfg(all(target_arch = "x86_64", not(any(test, feature = "portable"))))]
#[cold]
#[inline(never)]
fn unsupported() -> ! {
    panic!("{UNSUPPORTED}")
}

/// Forces the portable path of [`dispatch_lanes`], for tests.
#[cfg(test)]
pub(crate) mod portable {
    use std::cell::Cell;

    thread_local! {
        static FORCED: Cell<bool> = const { Cell::new(false) };
    }

    pub(crate) fn is_forced() -> bool {
        FORCED.get()
    }

    /// Runs `work` with [`dispatch_lanes`](super::dispatch_lanes) forced to the portable path on
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

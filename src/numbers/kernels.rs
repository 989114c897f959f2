//! The three loops that decide the speed of training: matrix products, the tanh of a layer, and sine with cosine; and the room
//! that steps work in.
//!
//! Users build with default flags, so the instruction set is chosen at run time; a portable path serves every other
//! processor. Nothing of the library outside this module is `unsafe`.

pub mod elementwise;
pub mod gemm;
pub(crate) mod scratch;
pub mod tanh;
pub mod trig;

use std::sync::OnceLock;

/// The instruction set that the kernels use, slowest first; every processor that has one has those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd)]
pub enum Level {
    /// Plain Rust, vectorized as the build's target allows.
    Portable,
    /// AVX2 and fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AVX-512 (F, VL, DQ, BW).
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Level {
    /// Every level of this processor, slowest first.
    pub fn available() -> Vec<Level> {
        #[allow(unused_mut)]
        let mut levels = vec![Level::Portable];
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            levels.push(Level::Avx2);
            if is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512bw")
            {
                levels.push(Level::Avx512);
            }
        }
        levels
    }

    /// The fastest level of this processor, looked up once.
    #[inline]
    pub fn best() -> Level {
        static BEST: OnceLock<Level> = OnceLock::new();
        *BEST.get_or_init(|| Level::available().pop().unwrap_or(Level::Portable))
    }

    /// The level itself.
    ///
    /// # Panics
    /// If this processor does not have it.
    #[inline]
    fn checked(self) -> Level {
        assert!(self <= Level::best(), "this processor has no {self:?}");
        self
    }
}

/// Work that is compiled once per instruction set. `run` must be `#[inline(always)]`: what is not inlined into the
/// dispatching function is compiled without its instructions (still right, only slower).
pub trait Vectorized {
    /// Does the work.
    fn run<const FMA: bool>(self);
}

/// Runs the work with the instructions of `level`.
#[inline]
pub fn dispatch(level: Level, work: impl Vectorized) {
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
            Level::Portable => {}
            // SAFETY: it is checked that this processor has the level's instructions.
            Level::Avx2 => return unsafe { avx2(work) },
            Level::Avx512 => return unsafe { avx512(work) },
        }
    }
    let _ = level;
    work.run::<false>();
}

/// Whether work on simulators goes through samples in lanes. On an x86-64 without AVX2 they go one by one, with the same
/// bits: such processors are old, and every simulator would have to be compiled in lanes for them once more.
#[inline(always)]
pub(crate) fn in_lanes<const FMA: bool>() -> bool {
    FMA || !cfg!(target_arch = "x86_64")
}

/// Whether rollouts on this processor go in lanes, see [`in_lanes`].
pub(crate) fn has_lanes() -> bool {
    Level::best() != Level::Portable || !cfg!(target_arch = "x86_64")
}

/// As [`dispatch`], with AVX2 at most: simulators are compiled once per level, and eight lanes gain little from wider
/// registers.
#[inline]
pub fn dispatch_narrow(work: impl Vectorized) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2,fma")]
        unsafe fn avx2(work: impl Vectorized) {
            work.run::<true>();
        }
        if Level::best() != Level::Portable && !portable::is_forced() {
            // SAFETY: every level but the portable one has these instructions.
            return unsafe { avx2(work) };
        }
    }
    work.run::<false>();
}

/// As [`dispatch_narrow`], for work on lanes alone, which the loops of an x86-64 without AVX2 do not use.
#[inline]
pub(crate) fn dispatch_lanes(work: impl Vectorized) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2,fma")]
        unsafe fn avx2(work: impl Vectorized) {
            work.run::<true>();
        }
        assert!(Level::best() != Level::Portable, "systems take eight lanes at once only with AVX2, else four");
        // SAFETY: every level but the portable one has these instructions.
        unsafe { avx2(work) }
    }
    #[cfg(not(target_arch = "x86_64"))]
    work.run::<false>();
}

/// What an old processor would do, for tests.
#[cfg(test)]
pub(crate) mod portable {
    use std::cell::Cell;

    thread_local! {
        static FORCED: Cell<bool> = const { Cell::new(false) };
    }

    pub(crate) fn is_forced() -> bool {
        FORCED.get()
    }

    /// Does the work, on this thread, without the instructions of [`dispatch_narrow`](super::dispatch_narrow).
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

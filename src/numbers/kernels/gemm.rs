//! A register-tiled matrix product for small matrices, such as those of policy layers.
//!
//! `C = A·B` or `C += A·B`. `A` (m × k) and `C` (m × n) are column-major and padded to whole
//! registers; `B` (k × n) has arbitrary strides. Start with [`Product`].
//!
//! Every element of `C` is one sequential sum over `k`, independent of tile, vector width and
//! number of columns. The result of a column is therefore independent of the other columns, and of
//! the distribution of a batch over threads.

/// Operands of one matrix product. The product checks the shapes against the slices before any
/// access.
pub struct Product<'a, F> {
    /// Rows of `A` and `C`, including padding: a multiple of the numbers per register.
    pub rows: usize,
    /// Columns of `A`, rows of `B`.
    pub depth: usize,
    /// Columns of `B` and `C`.
    pub cols: usize,
    /// `A[i, p] = a[i + p·lda]`.
    pub a: &'a [F],
    /// Leading dimension of `A`.
    pub lda: usize,
    /// `B[p, j] = b[p·b_row + j·b_col]`.
    pub b: &'a [F],
    /// Distance between rows of `B`.
    pub b_row: usize,
    /// Distance between columns of `B`.
    pub b_col: usize,
    /// `C[i, j] = c[i + j·ldc]`.
    pub c: &'a mut [F],
    /// Leading dimension of `C`.
    pub ldc: usize,
    /// `C += A·B` instead of `C = A·B`.
    pub accumulate: bool,
}

impl<F> Product<'_, F> {
    fn check(&self, pad: usize) {
        let Self { rows, depth, cols, lda, b_row, b_col, ldc, .. } = *self;
        // Offset of the last entry; arithmetic overflow counts as out of bounds.
        let last = |count: usize, step: usize| (count - 1).checked_mul(step);
        let within = |a: Option<usize>, b: Option<usize>, len: usize| {
            a.zip(b).and_then(|(a, b)| a.checked_add(b)).is_some_and(|i| i < len)
        };
        assert!(
            rows > 0 && depth > 0 && cols > 0 && rows.is_multiple_of(pad),
            "product: shape {rows}x{depth}x{cols} has a 0, or rows not divisible by {pad}"
        );
        assert!(
            lda >= rows && within(last(depth, lda), Some(rows - 1), self.a.len()),
            "product: A has {} entries, which do not fit its shape",
            self.a.len()
        );
        assert!(
            within(last(depth, b_row), last(cols, b_col), self.b.len()),
            "product: B has {} entries, which do not fit its shape",
            self.b.len()
        );
        assert!(
            ldc >= rows && within(last(cols, ldc), Some(rows - 1), self.c.len()),
            "product: C has {} entries, which do not fit its shape",
            self.c.len()
        );
    }
}

/// A vector register, or an array in its place on the portable path.
trait Register: Copy {
    type Float: Copy;
    /// Numbers per register.
    const LANES: usize;
    unsafe fn zero() -> Self;
    unsafe fn splat(value: Self::Float) -> Self;
    unsafe fn load(from: *const Self::Float) -> Self;
    unsafe fn store(self, to: *mut Self::Float);
    /// `a·b + self`, fused except on the portable path.
    unsafe fn plus_product(self, a: Self, b: Self) -> Self;
}

/// Largest number of columns in a tile of one register of rows.
const SINGLE: usize = 8;

/// Computes the product in panels of up to `MAX` registers of rows, and tiles of up to `NR`
/// columns, [`SINGLE`] for one register. The widths of the tiles differ by at most one column: a
/// narrow tile has too few independent sums for the latency of the processor.
///
/// The panel of `A` stays in the L1 cache for all its tiles.
///
/// # Safety
/// `p.check()` has passed, and the processor supports the instructions of `R`.
#[inline(always)]
unsafe fn panels<R: Register, const MAX: usize, const NR: usize>(p: Product<'_, R::Float>) {
    let c = p.c.as_mut_ptr();
    let mut row = 0;
    while row < p.rows {
        let registers = match (p.rows - row) / R::LANES {
            // Splits four registers as 2 + 2, which is faster than 3 + 1.
            4 if MAX == 3 => 2,
            left => left.min(MAX),
        };
        match registers {
            3 if MAX >= 3 => unsafe { tiles::<R, 3, NR>(&p, c, row) },
            2 if MAX >= 2 => unsafe { tiles::<R, 2, NR>(&p, c, row) },
            _ if MAX == 1 => unsafe { tiles::<R, 1, NR>(&p, c, row) },
            _ => unsafe { tiles::<R, 1, SINGLE>(&p, c, row) },
        }
        row += registers * R::LANES;
    }
}

/// Computes the tiles of one panel.
///
/// # Safety
/// As for [`panels`].
#[inline(always)]
unsafe fn tiles<R: Register, const H: usize, const NR: usize>(
    p: &Product<'_, R::Float>,
    c: *mut R::Float,
    row: usize,
) {
    let count = p.cols.div_ceil(NR);
    let (narrow, wider) = (p.cols / count, p.cols % count);
    let mut col = 0;
    for i in 0..count {
        let width = narrow + usize::from(i < wider);
        match width {
            1 => unsafe { tile::<R, H, 1>(p, c, row, col) },
            2 => unsafe { tile::<R, H, 2>(p, c, row, col) },
            3 => unsafe { tile::<R, H, 3>(p, c, row, col) },
            4 if NR > 4 => unsafe { tile::<R, H, 4>(p, c, row, col) },
            5 if NR > 5 => unsafe { tile::<R, H, 5>(p, c, row, col) },
            6 if NR > 6 => unsafe { tile::<R, H, 6>(p, c, row, col) },
            7 if NR > 7 => unsafe { tile::<R, H, 7>(p, c, row, col) },
            _ => unsafe { tile::<R, H, NR>(p, c, row, col) },
        }
        col += width;
    }
}

/// Computes one tile of `H` registers by `NR` columns, accumulated in registers.
///
/// # Safety
/// As for [`panels`]; the tile lies within `C`.
#[inline(always)]
unsafe fn tile<R: Register, const H: usize, const NR: usize>(
    p: &Product<'_, R::Float>,
    c: *mut R::Float,
    row: usize,
    col: usize,
) {
    unsafe {
        let a = p.a.as_ptr().add(row);
        let b = p.b.as_ptr().add(col * p.b_col);
        let c = c.add(row + col * p.ldc);
        let mut sum = [[R::zero(); H]; NR];
        if p.accumulate {
            for (j, column) in sum.iter_mut().enumerate() {
                for (i, sum) in column.iter_mut().enumerate() {
                    *sum = R::load(c.add(i * R::LANES + j * p.ldc));
                }
            }
        }
        for k in 0..p.depth {
            let a = a.add(k * p.lda);
            let mut a_k = [R::zero(); H];
            for (i, a_k) in a_k.iter_mut().enumerate() {
                *a_k = R::load(a.add(i * R::LANES));
            }
            for (j, column) in sum.iter_mut().enumerate() {
                let b_kj = R::splat(*b.add(k * p.b_row + j * p.b_col));
                // Index loop: `std::iter::zip` may not be inlined here.
                for i in 0..H {
                    column[i] = column[i].plus_product(a_k[i], b_kj);
                }
            }
        }
        for (j, column) in sum.iter().enumerate() {
            for (i, sum) in column.iter().enumerate() {
                sum.store(c.add(i * R::LANES + j * p.ldc));
            }
        }
    }
}

/// Implements [`Register`]. Some of the expressions need no `unsafe`, hence the `allow`.
macro_rules! register {
    ($register:ty, $float:ty, $width:literal, $splat:expr, $load:expr, $store:expr, $plus_product:expr) => {
        #[allow(unused_unsafe)]
        impl Register for $register {
            type Float = $float;
            const LANES: usize = $width;
            #[inline(always)]
            unsafe fn zero() -> Self {
                unsafe { $splat(0.0) }
            }
            #[inline(always)]
            unsafe fn splat(value: $float) -> Self {
                unsafe { $splat(value) }
            }
            #[inline(always)]
            unsafe fn load(from: *const $float) -> Self {
                unsafe { $load(from) }
            }
            #[inline(always)]
            unsafe fn store(self, to: *mut $float) {
                unsafe { $store(to, self) }
            }
            #[inline(always)]
            unsafe fn plus_product(self, a: Self, b: Self) -> Self {
                unsafe { $plus_product(a, b, self) }
            }
        }
    };
}

macro_rules! gemm {
    ($module:ident, $float:ident, $neon:ident, $avx2:ident, $avx512:ident, $quarter:literal, $half:literal, $pad:literal,
     [$s1:ident $l1:ident $st1:ident $f1:ident], [$s2:ident $l2:ident $st2:ident $f2:ident],
     [$s5:ident $l5:ident $st5:ident $f5:ident]) => {
        pub mod $module {
            use super::{Product, Register, panels};
            use crate::numbers::kernels::SimdLevel;
            #[cfg(target_arch = "aarch64")]
            use std::arch::aarch64::*;
            #[cfg(target_arch = "x86_64")]
            use std::arch::x86_64::*;

            /// Entries per cache line.
            pub const PAD: usize = $pad;

            /// Numbers per register. The number of rows of a product is a multiple of it.
            pub fn lanes(level: SimdLevel) -> usize {
                match level {
                    SimdLevel::Portable => $half,
                    #[cfg(target_arch = "aarch64")]
                    SimdLevel::Neon => $quarter,
                    #[cfg(target_arch = "x86_64")]
                    SimdLevel::Avx2 => $half,
                    #[cfg(target_arch = "x86_64")]
                    SimdLevel::Avx512 => $pad,
                }
            }

            #[derive(Clone, Copy)]
            struct Array([$float; $half]);
            register!(
                Array,
                $float,
                $half,
                |value| Array([value; $half]),
                |from: *const $float| Array(*from.cast()),
                |to: *mut $float, Array(from)| *to.cast() = from,
                |a: Array, b: Array, c: Array| Array(std::array::from_fn(
                    |i| a.0[i] * b.0[i] + c.0[i]
                ))
            );
            #[cfg(target_arch = "aarch64")]
            register!($neon, $float, $quarter, $s1, $l1, $st1, |a, b, c| $f1(c, a, b));
            #[cfg(target_arch = "x86_64")]
            register!($avx2, $float, $half, $s2, $l2, $st2, $f2);
            #[cfg(target_arch = "x86_64")]
            register!($avx512, $float, $pad, $s5, $l5, $st5, $f5);

            /// Computes the product with the instruction set `level`.
            ///
            /// # Panics
            /// If a dimension is 0, if the shapes do not fit the slices or the padding, or if the
            /// processor does not support `level`.
            pub fn product(level: SimdLevel, p: Product<'_, $float>) {
                p.check(lanes(level));
                let level = level.checked();
                // A tile of H × NR registers needs H · NR + H + 1 of them: 15 of 16 with AVX2, 28
                // of 32 with AVX-512 and NEON.
                #[cfg(target_arch = "x86_64")]
                #[target_feature(enable = "avx2,fma")]
                unsafe fn avx2(p: Product<'_, $float>) {
                    unsafe { panels::<$avx2, 2, 6>(p) }
                }
                #[cfg(target_arch = "x86_64")]
                #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,avx2,fma")]
                unsafe fn avx512(p: Product<'_, $float>) {
                    unsafe { panels::<$avx512, 3, 8>(p) }
                }
                match level {
                    // SAFETY: the code above checks the shapes and the level.
                    SimdLevel::Portable => unsafe { panels::<Array, 1, 4>(p) },
                    #[cfg(target_arch = "aarch64")]
                    SimdLevel::Neon => unsafe { panels::<$neon, 3, 8>(p) },
                    #[cfg(target_arch = "x86_64")]
                    SimdLevel::Avx2 => unsafe { avx2(p) },
                    #[cfg(target_arch = "x86_64")]
                    SimdLevel::Avx512 => unsafe { avx512(p) },
                }
            }
        }
    };
}

gemm!(single, f32, float32x4_t, __m256, __m512, 4, 8, 16,
    [vdupq_n_f32 vld1q_f32 vst1q_f32 vfmaq_f32],
    [_mm256_set1_ps _mm256_loadu_ps _mm256_storeu_ps _mm256_fmadd_ps],
    [_mm512_set1_ps _mm512_loadu_ps _mm512_storeu_ps _mm512_fmadd_ps]);
gemm!(double, f64, float64x2_t, __m256d, __m512d, 2, 4, 8,
    [vdupq_n_f64 vld1q_f64 vst1q_f64 vfmaq_f64],
    [_mm256_set1_pd _mm256_loadu_pd _mm256_storeu_pd _mm256_fmadd_pd],
    [_mm512_set1_pd _mm512_loadu_pd _mm512_storeu_pd _mm512_fmadd_pd]);

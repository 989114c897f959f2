//! Elementwise operations, dot products and moments, dispatched by instruction set at run time.
//!
//! Loops use indices: zipped iterators are not always vectorized.

use super::{SimdLevel, Vectorized, dispatch};
use crate::numbers::scalar::Float;

/// `v ← tanh v` elementwise in the given columns.
pub fn tanh<F: Float>(level: SimdLevel, values: &mut [F], columns: Strided) {
    struct Work<'a, F>(&'a mut [F], Strided);
    impl<F: Float> Vectorized for Work<'_, F> {
        #[inline(always)]
        fn run<const FMA: bool>(self) {
            for start in self.1.starts() {
                for value in &mut self.0[start..start + self.1.len] {
                    *value = value.layer_tanh::<FMA>();
                }
            }
        }
    }
    dispatch(level, Work(values, columns));
}

/// `bar ← bar·slope` elementwise in the given columns of `bar` and `slopes`.
pub fn times<F: Float>(level: SimdLevel, slopes: &[F], bar: &mut [F], columns: Strided) {
    struct Work<'a, F>(&'a [F], &'a mut [F], Strided);
    impl<F: Float> Vectorized for Work<'_, F> {
        #[inline(always)]
        fn run<const FMA: bool>(self) {
            for start in self.2.starts() {
                let (slopes, bar) =
                    (&self.0[start..][..self.2.len], &mut self.1[start..][..self.2.len]);
                for i in 0..slopes.len() {
                    bar[i] *= slopes[i];
                }
            }
        }
    }
    dispatch(level, Work(slopes, bar, columns));
}

/// `bar ← bar·(1 - h²)` elementwise: VJP of tanh, given its output `h`.
pub fn tanh_bar<F: Float>(level: SimdLevel, h: &[F], bar: &mut [F], columns: Strided) {
    struct Work<'a, F>(&'a [F], &'a mut [F], Strided);
    impl<F: Float> Vectorized for Work<'_, F> {
        #[inline(always)]
        fn run<const FMA: bool>(self) {
            for start in self.2.starts() {
                let (h, bar) = (&self.0[start..][..self.2.len], &mut self.1[start..][..self.2.len]);
                for i in 0..h.len() {
                    bar[i] *= F::one() - h[i] * h[i];
                }
            }
        }
    }
    dispatch(level, Work(h, bar, columns));
}

/// `to[:, c] = from[:, c]·weight[c]` for contiguous columns of `len` numbers.
pub fn scale<F: Float>(level: SimdLevel, from: &[F], weight: &[F], len: usize, to: &mut [F]) {
    struct Work<'a, F>(&'a [F], &'a [F], usize, &'a mut [F]);
    impl<F: Float> Vectorized for Work<'_, F> {
        #[inline(always)]
        fn run<const FMA: bool>(self) {
            let Work(from, weight, len, to) = self;
            for (c, &weight) in weight.iter().enumerate().take(to.len() / len) {
                let (from, to) = (&from[c * len..][..len], &mut to[c * len..][..len]);
                for i in 0..len {
                    to[i] = from[i] * weight;
                }
            }
        }
    }
    dispatch(level, Work(from, weight, len, to));
}

/// `out[c·out_step + r]` is the dot product of row r of `a` and column c of `b`. Rows and columns
/// have equal length.
pub fn dots<F: Float>(
    level: SimdLevel,
    a: &[F],
    rows: Strided,
    b: &[F],
    columns: Strided,
    out: &mut [F],
    out_step: usize,
) {
    struct Work<'a, F>(&'a [F], Strided, &'a [F], Strided, &'a mut [F], usize);
    impl<F: Float> Vectorized for Work<'_, F> {
        #[inline(always)]
        fn run<const FMA: bool>(self) {
            let Work(a, rows, b, columns, out, out_step) = self;
            for (c, start) in columns.starts().enumerate() {
                let column = &b[start..start + columns.len];
                for (r, start) in rows.starts().enumerate() {
                    out[c * out_step + r] = dot::<F, FMA>(&a[start..start + rows.len], column);
                }
            }
        }
    }
    dispatch(level, Work(a, rows, b, columns, out, out_step));
}

/// Dot product: 16 partial sums, then a tree. The order is independent of the vector width.
#[inline(always)]
fn dot<F: Float, const FMA: bool>(a: &[F], b: &[F]) -> F {
    /// Number of partial sums.
    const LANES: usize = 16;
    let mut sum = [F::zero(); LANES];
    let (a, a_rest) = a.as_chunks::<LANES>();
    let (b, b_rest) = b.as_chunks::<LANES>();
    for c in 0..a.len().min(b.len()) {
        for i in 0..LANES {
            sum[i] = F::plus_product::<FMA>(sum[i], a[c][i], b[c][i]);
        }
    }
    for i in 0..a_rest.len().min(b_rest.len()) {
        sum[i] = F::plus_product::<FMA>(sum[i], a_rest[i], b_rest[i]);
    }
    let mut half = LANES / 2;
    while half > 0 {
        for i in 0..half {
            sum[i] += sum[i + half];
        }
        half /= 2;
    }
    sum[0]
}

/// A strided selection of columns in a buffer.
#[derive(Clone, Copy, Debug)]
pub struct Strided {
    /// Offset of the first column.
    pub first: usize,
    /// Distance between the starts of successive columns.
    pub step: usize,
    /// Number of columns.
    pub count: usize,
    /// Length of each column.
    pub len: usize,
}

impl Strided {
    #[inline(always)]
    pub(crate) fn starts(self) -> impl Iterator<Item = usize> {
        (0..self.count).map(move |i| self.first + i * self.step)
    }
}

/// `(Σ a·b, Σ a², Σ b²)` in double precision, summed in an order independent of the processor.
pub fn moments<F: Float>(level: SimdLevel, a: &[F], b: &[F]) -> (f64, f64, f64) {
    /// Number of partial sums.
    const LANES: usize = 16;
    struct Work<'a, F>(&'a [F], &'a [F], &'a mut [[f64; LANES]; 3]);
    impl<F: Float> Vectorized for Work<'_, F> {
        #[inline(always)]
        fn run<const FMA: bool>(self) {
            let Work(a, b, sums) = self;
            let mut add = |i: usize, a: F, b: F| {
                let (a, b): (f64, f64) = (a.as_(), b.as_());
                sums[0][i] += a * b;
                sums[1][i] += a * a;
                sums[2][i] += b * b;
            };
            let (a, a_rest) = a.as_chunks::<LANES>();
            let (b, b_rest) = b.as_chunks::<LANES>();
            for c in 0..a.len().min(b.len()) {
                for i in 0..LANES {
                    add(i, a[c][i], b[c][i]);
                }
            }
            for i in 0..a_rest.len().min(b_rest.len()) {
                add(i, a_rest[i], b_rest[i]);
            }
        }
    }
    let mut sums = [[0.0; LANES]; 3];
    dispatch(level, Work(a, b, &mut sums));
    let [ab, aa, bb] = sums.map(|sum| sum.iter().sum());
    (ab, aa, bb)
}

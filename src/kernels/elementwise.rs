//! Passes over a layer's numbers, vectorized for the processor at hand.

use super::{Level, Vectorized, dispatch};
use crate::scalar::Float;

/// `v ← tanh v` in every one of the strided columns.
pub fn tanh<F: Float>(level: Level, values: &mut [F], columns: Strided) {
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

/// `bar ← bar·(1 - h²)`: the cotangent of a tanh layer's output `h` becomes that of its input.
pub fn tanh_bar<F: Float>(level: Level, h: &[F], bar: &mut [F], columns: Strided) {
    struct Work<'a, F>(&'a [F], &'a mut [F], Strided);
    impl<F: Float> Vectorized for Work<'_, F> {
        #[inline(always)]
        fn run<const FMA: bool>(self) {
            for start in self.2.starts() {
                let h = &self.0[start..start + self.2.len];
                for (bar, &h) in self.1[start..start + self.2.len].iter_mut().zip(h) {
                    *bar *= F::one() - h * h;
                }
            }
        }
    }
    dispatch(level, Work(h, bar, columns));
}

/// `to[:, c] = from[:, c]·weight[c]` for columns of `len` numbers, contiguous in both.
pub fn scale<F: Float>(level: Level, from: &[F], weight: &[F], len: usize, to: &mut [F]) {
    struct Work<'a, F>(&'a [F], &'a [F], usize, &'a mut [F]);
    impl<F: Float> Vectorized for Work<'_, F> {
        #[inline(always)]
        fn run<const FMA: bool>(self) {
            let columns = self.0.chunks_exact(self.2).zip(self.3.chunks_exact_mut(self.2));
            for ((from, to), &weight) in columns.zip(self.1) {
                for (to, &from) in to.iter_mut().zip(from) {
                    *to = from * weight;
                }
            }
        }
    }
    dispatch(level, Work(from, weight, len, to));
}

/// `out[c·rows.count + r] = row r · column c`. Rows and columns have the same length, a multiple of the padding.
pub fn dots<F: Float>(level: Level, a: &[F], rows: Strided, b: &[F], columns: Strided, out: &mut [F], out_step: usize) {
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

/// Partial sums of a cache line each, then a tree: the same order for every vector width.
#[inline(always)]
fn dot<F: Float, const FMA: bool>(a: &[F], b: &[F]) -> F {
    const WIDTH: usize = 16;
    let mut sum = [F::zero(); WIDTH];
    let (a, a_rest) = a.as_chunks::<WIDTH>();
    let (b, b_rest) = b.as_chunks::<WIDTH>();
    for (a, b) in a.iter().zip(b) {
        for i in 0..WIDTH {
            sum[i] = F::plus_product::<FMA>(sum[i], a[i], b[i]);
        }
    }
    for (i, (&a, &b)) in a_rest.iter().zip(b_rest).enumerate() {
        sum[i] = F::plus_product::<FMA>(sum[i], a, b);
    }
    let mut half = WIDTH / 2;
    while half > 0 {
        for i in 0..half {
            sum[i] += sum[i + half];
        }
        half /= 2;
    }
    sum[0]
}

/// Columns of `len` numbers, `step` apart.
#[derive(Clone, Copy, Debug)]
pub struct Strided {
    /// Where the first starts.
    pub first: usize,
    /// From the start of one to the start of the next.
    pub step: usize,
    /// How many.
    pub count: usize,
    /// Numbers in each.
    pub len: usize,
}

impl Strided {
    #[inline(always)]
    fn starts(self) -> impl Iterator<Item = usize> {
        (0..self.count).map(move |i| self.first + i * self.step)
    }
}

/// `(Σ a·b, Σ a², Σ b²)` in double precision, in an order that does not depend on the processor.
pub fn moments<F: Float>(level: Level, a: &[F], b: &[F]) -> (f64, f64, f64) {
    const WIDTH: usize = 16;
    struct Work<'a, F>(&'a [F], &'a [F], &'a mut [[f64; WIDTH]; 3]);
    impl<F: Float> Vectorized for Work<'_, F> {
        #[inline(always)]
        fn run<const FMA: bool>(self) {
            let Work(a, b, sums) = self;
            let mut add = |a: &[F], b: &[F]| {
                for (i, (&a, &b)) in a.iter().zip(b).enumerate() {
                    let (a, b): (f64, f64) = (a.as_(), b.as_());
                    sums[0][i] += a * b;
                    sums[1][i] += a * a;
                    sums[2][i] += b * b;
                }
            };
            let (a_chunks, a_rest) = a.as_chunks::<WIDTH>();
            let (b_chunks, b_rest) = b.as_chunks::<WIDTH>();
            for (a, b) in a_chunks.iter().zip(b_chunks) {
                add(a, b);
            }
            add(a_rest, b_rest);
        }
    }
    let mut sums = [[0.0; WIDTH]; 3];
    dispatch(level, Work(a, b, &mut sums));
    let [ab, aa, bb] = sums.map(|sum| sum.iter().sum());
    (ab, aa, bb)
}

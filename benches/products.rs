//! Benchmark of the matrix product at the shapes of the paper, against the peak of the processor for
//! fused multiply-adds, which it measures with sums in registers alone.
//!
//! Usage: `cargo bench --bench products`. All products and the peak alternate within each round;
//! numbers are medians, for one thread.

#[allow(dead_code)]
mod measure;

use measure::{median, ratio, rounds};
use physgrad::engine::kernels::SimdLevel;
use physgrad::engine::kernels::gemm::{self, Product};
use std::hint::black_box;

/// Rows and depth: hidden layers of 100 units with a bias, from 10 inputs and from 100.
const LAYERS: [(usize, usize); 2] = [(112, 11), (112, 101)];
const COLUMNS: [usize; 7] = [1, 8, 12, 16, 24, 32, 64];
const ROUNDS: usize = 200;
/// Multiply-adds of one measurement.
const WORK: usize = 2_000_000;

/// From the first cache line on, as in policies and rollouts.
fn aligned<F>(memory: &mut [F]) -> &mut [F] {
    let offset = memory.as_ptr().align_offset(64);
    &mut memory[offset..]
}

/// Multiply-adds in chains that hide the latency, and their number. None where the peak is not
/// measured.
#[cfg(target_arch = "x86_64")]
mod peak {
    use super::{SimdLevel, WORK, black_box};
    use std::arch::x86_64::*;

    const CHAINS: usize = 10;

    macro_rules! chains {
        ($name:ident, $features:literal, $float:ident, $register:ident, $set:ident, $fma:ident) => {
            #[target_feature(enable = $features)]
            fn $name() -> Option<usize> {
                let (a, mut sums) = (black_box($set(0.5)), [$set(1.0); CHAINS]);
                let lanes = size_of::<$register>() / size_of::<$float>();
                let count = WORK / (CHAINS * lanes);
                for _ in 0..count {
                    for sum in &mut sums {
                        *sum = $fma(a, a, *sum);
                    }
                }
                black_box(sums);
                Some(count * CHAINS * lanes)
            }
        };
    }

    chains!(single_avx2, "avx2,fma", f32, __m256, _mm256_set1_ps, _mm256_fmadd_ps);
    chains!(single_avx512, "avx512f", f32, __m512, _mm512_set1_ps, _mm512_fmadd_ps);
    chains!(double_avx2, "avx2,fma", f64, __m256d, _mm256_set1_pd, _mm256_fmadd_pd);
    chains!(double_avx512, "avx512f", f64, __m512d, _mm512_set1_pd, _mm512_fmadd_pd);

    macro_rules! dispatch {
        ($name:ident, $avx2:ident, $avx512:ident) => {
            pub fn $name(level: SimdLevel) -> Option<usize> {
                // SAFETY: the processor supports the level.
                match level {
                    SimdLevel::Avx512 => unsafe { $avx512() },
                    SimdLevel::Avx2 => unsafe { $avx2() },
                    SimdLevel::Portable => None,
                }
            }
        };
    }

    dispatch!(single, single_avx2, single_avx512);
    dispatch!(double, double_avx2, double_avx512);
}

#[cfg(not(target_arch = "x86_64"))]
mod peak {
    use super::SimdLevel;

    pub fn single(_: SimdLevel) -> Option<usize> {
        None
    }
    pub use single as double;
}

macro_rules! bench {
    ($name:ident, $float:ident) => {
        fn $name() {
            let level = SimdLevel::best();
            let mut done = None;
            let mut peak = || done = peak::$name(level);
            let shapes: Vec<(usize, usize, usize)> = LAYERS
                .iter()
                .flat_map(|&(rows, depth)| COLUMNS.map(|cols| (rows, depth, cols)))
                // Gradients of weights.
                .chain([(112, 64, 11), (112, 64, 101)])
                .collect();
            let mut memory = vec![0.5; 112 * 128 + 64];
            let (a, b) = (&*aligned(&mut memory), vec![0.25; 128 * 128]);
            let mut jobs: Vec<_> = { shapes.iter() }
                .map(|&(rows, depth, cols)| {
                    let b = &b;
                    let mut memory = vec![0.0; 112 * 128 + 64];
                    let times = WORK.div_ceil(rows * depth * cols);
                    move || {
                        let c = aligned(&mut memory);
                        for _ in 0..times {
                            let (a, b) = (black_box(&a[..]), black_box(&b[..]));
                            let (lda, ldc, b_row, b_col) = (rows, rows, 1, depth);
                            let accumulate = false;
                            gemm::$name::product(
                                level,
                                Product {
                                    rows,
                                    depth,
                                    cols,
                                    a,
                                    lda,
                                    b,
                                    b_row,
                                    b_col,
                                    c: &mut *c,
                                    ldc,
                                    accumulate,
                                },
                            );
                        }
                        black_box(c);
                    }
                })
                .collect();
            let mut all: Vec<&mut dyn FnMut()> = vec![&mut peak];
            all.extend(jobs.iter_mut().map(|job| job as &mut dyn FnMut()));
            let times = rounds(ROUNDS, &mut all);
            println!("\n{}, {level:?}", stringify!($float));
            let billions = |work: usize, times: &[f64]| 2.0 * work as f64 / (median(times) * 1e3);
            if let Some(done) = done {
                println!("  peak               {:5.1} GFLOP/s", billions(done, &times[0]));
            }
            for ((rows, depth, cols), times_of) in shapes.iter().zip(&times[1..]) {
                let work = WORK.div_ceil(rows * depth * cols) * rows * depth * cols;
                let share = done.map(|done| {
                    let share = ratio(&times[0], times_of) * work as f64 / done as f64;
                    format!("   {share:.2} of the peak")
                });
                println!(
                    "  {rows:>3} x {depth:>3} x {cols:>3}    {:5.1} GFLOP/s{}",
                    billions(work, times_of),
                    share.unwrap_or_default()
                );
            }
        }
    };
}

bench!(single, f32);
bench!(double, f64);

fn main() {
    single();
    double();
}

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

macro_rules! bench {
    ($name:ident, $float:ident, $module:ident, $avx2:ident, $set2:ident, $fma2:ident, $avx512:ident, $set5:ident, $fma5:ident) => {
        fn $name() {
            use std::arch::x86_64::*;
            const CHAINS: usize = 10;
            /// Multiply-adds in chains that hide the latency.
            #[target_feature(enable = "avx2,fma")]
            fn avx2() -> usize {
                let (a, mut sums) = (black_box($set2(0.5)), [$set2(1.0); CHAINS]);
                let lanes = size_of::<$avx2>() / size_of::<$float>();
                let count = WORK / (CHAINS * lanes);
                for _ in 0..count {
                    for sum in &mut sums {
                        *sum = $fma2(a, a, *sum);
                    }
                }
                black_box(sums);
                count * CHAINS * lanes
            }
            #[target_feature(enable = "avx512f")]
            fn avx512() -> usize {
                let (a, mut sums) = (black_box($set5(0.5)), [$set5(1.0); CHAINS]);
                let lanes = size_of::<$avx512>() / size_of::<$float>();
                let count = WORK / (CHAINS * lanes);
                for _ in 0..count {
                    for sum in &mut sums {
                        *sum = $fma5(a, a, *sum);
                    }
                }
                black_box(sums);
                count * CHAINS * lanes
            }
            let level = SimdLevel::best();
            let mut done = 0;
            // SAFETY: the processor supports the level.
            let mut peak = || {
                done = match level {
                    SimdLevel::Avx512 => unsafe { avx512() },
                    _ => unsafe { avx2() },
                }
            };
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
                            gemm::$module::product(
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
            println!(
                "\n{}, {level:?}: peak {:.1} GFLOP/s",
                stringify!($float),
                2.0 * done as f64 / (median(&times[0]) * 1e3)
            );
            for ((rows, depth, cols), times_of) in shapes.iter().zip(&times[1..]) {
                let work = WORK.div_ceil(rows * depth * cols) * rows * depth * cols;
                let share = ratio(&times[0], times_of) * work as f64 / done as f64;
                println!("  {rows:>3} x {depth:>3} x {cols:>2}   {share:.2} of the peak");
            }
        }
    };
}

bench!(
    single,
    f32,
    single,
    __m256,
    _mm256_set1_ps,
    _mm256_fmadd_ps,
    __m512,
    _mm512_set1_ps,
    _mm512_fmadd_ps
);
bench!(
    double,
    f64,
    double,
    __m256d,
    _mm256_set1_pd,
    _mm256_fmadd_pd,
    __m512d,
    _mm512_set1_pd,
    _mm512_fmadd_pd
);

fn main() {
    single();
    double();
}

//! Branch-free sine and cosine, computed together without fused operations.
//!
//! Results are bitwise equal for scalars and lanes, and on every processor. For |x| up to 1e6, the
//! error is at most 1.6 units in the last place (ulps) in `f32`, tested for all arguments. In `f64`
//! it is at most 2.6 ulps. Callers use the standard library beyond [`REACH`].
//!
//! The bound in `f64` has three terms. The argument reduction rounds twice, an error of up to 1 ulp
//! of the angle. If a power of two lies between sine and angle, 1 ulp of the angle is 2 ulps of the
//! sine. The last sum adds 0.5 ulp, the polynomial less than 0.1 ulp.

/// Bound on |x| for the argument reduction `x = n·π/2 + r`.
///
/// |n| is below 2^20, so the products of n with the first two parts of π/2 are exact.
pub const REACH: f64 = 1e6;

/// 1.5·2^52: adding and subtracting it rounds to an integer. The low bits of the sum are those of
/// the integer.
const ROUND: f64 = 6_755_399_441_055_744.0;
/// π/2 in three parts. The first two have 33 significant bits, so their products with |n| < 2^20
/// are exact (fdlibm).
const HALF_PI: [f64; 3] =
    [1.570_796_326_734_125_6, 6.077_100_506_303_966e-11, 2.022_266_248_795_950_6e-21];

/// Reduces `x = n·π/2 + r` with |r| ≤ π/4 up to rounding. Returns `r` and a word with the low bits
/// of `n`.
#[inline(always)]
fn reduce(x: f64) -> (f64, u64) {
    let n = x * std::f64::consts::FRAC_2_PI + ROUND;
    let bits = n.to_bits();
    let n = n - ROUND;
    (((x - n * HALF_PI[0]) - n * HALF_PI[1]) - n * HALF_PI[2], bits)
}

/// Returns sin and cos for |x| ≤ [`REACH`], which callers must check; NaN for NaN.
#[inline(always)]
pub fn sin_cos_64(x: f64) -> (f64, f64) {
    let (r, n) = reduce(x);
    let r2 = r * r;
    // Minimax polynomials on [-π/4, π/4] (fdlibm, k_sin.c and k_cos.c).
    let sin = 1.589_690_995_211_55e-10;
    let sin = sin * r2 - 2.505_076_025_340_686_3e-8;
    let sin = sin * r2 + 2.755_731_370_707_006_8e-6;
    let sin = sin * r2 - 1.984_126_982_985_795e-4;
    let sin = sin * r2 + 8.333_333_333_322_49e-3;
    let sin = sin * r2 - 1.666_666_666_666_663_2e-1;
    let sin = r + r * r2 * sin;
    let cos = -1.135_964_755_778_819_5e-11;
    let cos = cos * r2 + 2.087_572_321_298_175e-9;
    let cos = cos * r2 - 2.755_731_435_139_066_3e-7;
    let cos = cos * r2 + 2.480_158_728_947_673e-5;
    let cos = cos * r2 - 1.388_888_888_887_411e-3;
    let cos = cos * r2 + 4.166_666_666_666_66e-2;
    let half = 0.5 * r2;
    let one = 1.0 - half;
    let cos = one + ((1.0 - one - half) + r2 * r2 * cos);
    // Odd quadrants swap sine and cosine. Quadrants 2 and 3 negate the sine, 1 and 2 the cosine.
    let swap = 0u64.wrapping_sub(n & 1);
    let (s, c) = (sin.to_bits(), cos.to_bits());
    let (s, c) = ((s & !swap) | (c & swap), (c & !swap) | (s & swap));
    (f64::from_bits(s ^ ((n & 2) << 62)), f64::from_bits(c ^ ((n.wrapping_add(1) & 2) << 62)))
}

/// Returns sin and cos for |x| ≤ [`REACH`], which callers must check; NaN for NaN. Reduces the
/// argument in double precision.
#[inline(always)]
pub fn sin_cos_32(x: f32) -> (f32, f32) {
    let (r, n) = reduce(f64::from(x));
    let (r, n) = (r as f32, n as u32);
    let r2 = r * r;
    // Minimax polynomials on [-π/4, π/4] (Cephes, sinf.c).
    let sin = -1.951_529_6e-4;
    let sin = sin * r2 + 8.332_161e-3;
    let sin = sin * r2 - 1.666_665_5e-1;
    let sin = r + r * r2 * sin;
    let cos = 2.443_315_7e-5;
    let cos = cos * r2 - 1.388_731_6e-3;
    let cos = cos * r2 + 4.166_664_6e-2;
    let cos = (1.0 - 0.5 * r2) + r2 * r2 * cos;
    let swap = 0u32.wrapping_sub(n & 1);
    let (s, c) = (sin.to_bits(), cos.to_bits());
    let (s, c) = ((s & !swap) | (c & swap), (c & !swap) | (s & swap));
    (f32::from_bits(s ^ ((n & 2) << 30)), f32::from_bits(c ^ ((n.wrapping_add(1) & 2) << 30)))
}

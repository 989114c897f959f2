//! Operations of a [`Scalar`], and functions composed of them.

use physgrad::Scalar;

/// Function of two numbers. Some functions ignore one or both.
pub type Operation<T> = fn(T, T) -> T;

/// Returns all operations by name, for any scalar type.
pub fn operations<T: Scalar>() -> [(&'static str, Operation<T>); 27] {
    [
        ("add", |a, b| a + b),
        ("sub", |a, b| a - b),
        ("mul", |a, b| a * b),
        ("div", |a, b| a / b),
        ("add_assign", |mut a, b| {
            a += b;
            a
        }),
        ("sub_assign", |mut a, b| {
            a -= b;
            a
        }),
        ("mul_assign", |mut a, b| {
            a *= b;
            a
        }),
        ("div_assign", |mut a, b| {
            a /= b;
            a
        }),
        ("neg", |a, _| -a),
        ("sqrt", |a, _| a.sqrt()),
        ("exp", |a, _| a.exp()),
        ("ln", |a, _| a.ln()),
        ("sin", |a, _| a.sin()),
        ("cos", |a, _| a.cos()),
        ("tanh", |a, _| a.tanh()),
        ("atan2", |a, b| a.atan2(b)),
        ("select_lt", |a, b| T::select_lt(a, b, b, a)),
        ("powi", |a, _| a.powi(3)),
        ("abs", |a, _| a.abs()),
        ("min", |a, b| a.min(b)),
        ("max", |a, b| a.max(b)),
        ("add_f64", |a, _| a + 0.7),
        ("sub_f64", |a, _| a - 0.7),
        ("mul_f64", |a, _| a * 0.7),
        ("div_f64", |a, _| a / 0.7),
        ("from", |_, _| T::from(0.1)),
        ("detach", |a, _| a.detach()),
    ]
}

/// Returns the functions that are composed of [`operations`], by name.
///
/// Functions whose name starts with `div` divide by the second number.
#[allow(dead_code)]
pub fn compositions<T: Scalar>() -> [(&'static str, Operation<T>); 13] {
    [
        ("tan", |a, _| a.tan()),
        // The factor 0.05 keeps the arguments of asin and acos within ±1 for |a| ≤ 20.
        ("asin", |a, _| (a * 0.05).asin()),
        ("acos", |a, _| (a * 0.05).acos()),
        ("powf", |a, _| a.powf(1.7)),
        ("hypot", |a, b| a.hypot(b)),
        ("div_recip", |_, b| b.recip()),
        ("div_powi", |_, b| b.powi(-2)),
        ("clamp", |a, _| a.clamp(0.5, 2.0)),
        ("wrap_angle", |a, _| a.wrap_angle()),
        ("sum", |a, b| [a, b, a].into_iter().sum()),
        ("min_f64", |a, _| a.min(0.4)),
        ("max_f64", |a, _| a.max(0.4)),
        ("assign_f64", |mut a, _| {
            a += 0.3;
            a *= 1.7;
            a -= 0.2;
            a /= 0.9;
            a
        }),
    ]
}

/// Zeros, infinities, NaN, and finite values with magnitudes from 1e-300 to 1e300.
pub const NUMBERS: [f64; 12] = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.3,
    -2.7,
    1e-300,
    1e300,
    1e7,
    f64::INFINITY,
    f64::NEG_INFINITY,
    f64::NAN,
];

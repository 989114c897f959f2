//! All operations of a [`Scalar`].

use physgrad::Scalar;

/// Operation on two numbers, not necessarily using both.
pub type Operation<T> = fn(T, T) -> T;

/// Returns all operations by name, for any scalar type.
pub fn operations<T: Scalar>() -> [(&'static str, Operation<T>); 23] {
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
        ("lift", |_, _| T::lift(0.1)),
        ("detach", |a, _| a.detach()),
    ]
}

/// Special and ordinary values.
pub const NUMBERS: [f64; 12] = [0.0, -0.0, 1.0, -1.0, 0.3, -2.7, 1e-300, 1e300, 1e7, f64::INFINITY, f64::NEG_INFINITY, f64::NAN];

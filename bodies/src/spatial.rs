//! Spatial algebra in world axes at one point O.
//!
//! A motion is an angular velocity and the velocity of the body's point at O. A force is a moment
//! about O and a force. Components are scalars, or cotangents, which are multiplied by scalars on
//! their right. Source: R. Featherstone, Rigid Body Dynamics Algorithms, Springer 2008, chapter 2.

use crate::model::{Mat3, Vec3};
use physgrad::Scalar;
use std::ops::{Add, AddAssign, Mul, Neg, Sub};

/// Element of a vector space over `T`: a scalar or a cotangent.
pub(crate) trait Linear<T>:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Neg<Output = Self>
    + Mul<T, Output = Self>
    + AddAssign
{
}
impl<T, X> Linear<T> for X where
    X: Copy + Add<Output = X> + Sub<Output = X> + Neg<Output = X> + Mul<T, Output = X> + AddAssign
{
}

/// A vector.
pub(crate) type V<X> = [X; 3];
/// A matrix, in rows.
pub(crate) type M<T> = [[T; 3]; 3];

/// `[x(0), x(1), x(2)]`, unrolled. The compiler does not inline `array::map` over lanes, which then
/// lacks their instructions.
macro_rules! three {
    (|$i:ident| $x:expr) => {
        [
            {
                let $i = 0;
                $x
            },
            {
                let $i = 1;
                $x
            },
            {
                let $i = 2;
                $x
            },
        ]
    };
}
pub(crate) use three;

/// A constant vector.
#[inline(always)]
pub(crate) fn constant<T: From<f64>>(a: Vec3) -> V<T> {
    [a[0].into(), a[1].into(), a[2].into()]
}

#[inline(always)]
pub(crate) fn neg<X: Copy + Neg<Output = X>>(a: V<X>) -> V<X> {
    [-a[0], -a[1], -a[2]]
}

#[inline(always)]
pub(crate) fn add<X: Copy + Add<Output = X>>(a: V<X>, b: V<X>) -> V<X> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
pub(crate) fn sub<X: Copy + Sub<Output = X>>(a: V<X>, b: V<X>) -> V<X> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(crate) fn scale<T: Copy, X: Copy + Mul<T, Output = X>>(a: V<X>, by: T) -> V<X> {
    [a[0] * by, a[1] * by, a[2] * by]
}

/// `by a` for scalars `a` and a cotangent.
#[inline(always)]
pub(crate) fn spread<T: Copy, X: Copy + Mul<T, Output = X>>(by: X, a: V<T>) -> V<X> {
    [by * a[0], by * a[1], by * a[2]]
}

/// `a · b`.
#[inline(always)]
pub(crate) fn dot<T: Copy, X: Linear<T>>(a: V<X>, b: V<T>) -> X {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// `a × b`.
#[inline(always)]
pub(crate) fn cross<T: Copy, X: Linear<T>>(a: V<X>, b: V<T>) -> V<X> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// `b × a`, with scalars `b` on the left.
#[inline(always)]
pub(crate) fn cross_left<T: Copy, X: Linear<T>>(b: V<T>, a: V<X>) -> V<X> {
    [a[2] * b[1] - a[1] * b[2], a[0] * b[2] - a[2] * b[0], a[1] * b[0] - a[0] * b[1]]
}

/// A motion or a force.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spatial<X> {
    /// Angular velocity or moment.
    pub(crate) a: V<X>,
    /// Velocity or force.
    pub(crate) l: V<X>,
}

impl<X: Copy + Add<Output = X>> Add for Spatial<X> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self { a: add(self.a, other.a), l: add(self.l, other.l) }
    }
}

impl<X: Copy + Sub<Output = X>> Sub for Spatial<X> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self { a: sub(self.a, other.a), l: sub(self.l, other.l) }
    }
}

impl<X: Copy + Add<Output = X>> AddAssign for Spatial<X> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<X: Copy> Spatial<X> {
    #[inline(always)]
    pub(crate) fn fill(x: X) -> Self {
        Self { a: [x; 3], l: [x; 3] }
    }

    #[inline(always)]
    pub(crate) fn times<T: Copy>(self, by: T) -> Self
    where
        X: Mul<T, Output = X>,
    {
        Self { a: scale(self.a, by), l: scale(self.l, by) }
    }

    /// Product of a motion and a force: power.
    #[inline(always)]
    pub(crate) fn dot<T: Copy>(self, other: Spatial<T>) -> X
    where
        X: Linear<T>,
    {
        dot(self.a, other.a) + dot(self.l, other.l)
    }

    /// `self × m` of motions.
    #[inline(always)]
    pub(crate) fn cross_motion<T: Copy>(self, m: Spatial<T>) -> Self
    where
        X: Linear<T>,
    {
        Self { a: cross(self.a, m.a), l: add(cross(self.a, m.l), cross(self.l, m.a)) }
    }

    /// `self ×* f` of a motion and a force of scalars: `y · (m ×* f) = (y × m) · f` for motions y.
    #[inline(always)]
    pub(crate) fn cross_force<T: Copy>(self, f: Spatial<T>) -> Self
    where
        X: Linear<T>,
    {
        Self { a: add(cross(self.a, f.a), cross(self.l, f.l)), l: cross(self.a, f.l) }
    }

    /// Velocity of the point `x` of the body.
    #[inline(always)]
    pub(crate) fn at<T: Copy>(self, x: V<T>) -> V<X>
    where
        X: Linear<T>,
    {
        add(self.l, cross(self.a, x))
    }

    /// The force `f` at the point `x`.
    #[inline(always)]
    pub(crate) fn force<T: Copy>(f: V<X>, x: V<T>) -> Self
    where
        X: Linear<T>,
    {
        Self { a: cross_left(x, f), l: f }
    }
}

/// `by f` for a motion or force of scalars and a cotangent.
#[inline(always)]
pub(crate) fn spread_spatial<T: Copy, X: Copy + Mul<T, Output = X>>(
    by: X,
    f: Spatial<T>,
) -> Spatial<X> {
    Spatial { a: spread(by, f.a), l: spread(by, f.l) }
}

/// `m ×* f` with a motion of scalars.
#[inline(always)]
pub(crate) fn cross_force_left<T: Copy, X: Linear<T>>(m: Spatial<T>, f: Spatial<X>) -> Spatial<X> {
    Spatial { a: add(cross_left(m.a, f.a), cross_left(m.l, f.l)), l: cross_left(m.a, f.l) }
}

/// Inertia of rigid bodies about O: mass, first moment, moments xx, yy, zz, xy, xz, yz.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Inertia<T> {
    pub(crate) m: T,
    pub(crate) h: V<T>,
    pub(crate) j: [T; 6],
}

impl<T: Scalar> Inertia<T> {
    #[inline(always)]
    pub(crate) fn zero() -> Self {
        Self { m: T::zero(), h: [T::zero(); 3], j: [T::zero(); 6] }
    }

    /// Inertia of a body with mass `m`, centre of mass `c` and moments `j` about the centre.
    #[inline(always)]
    pub(crate) fn of(m: T, c: V<T>, mut j: [T; 6]) -> Self {
        let h = scale(c, m);
        j[0] += h[1] * c[1] + h[2] * c[2];
        j[1] += h[0] * c[0] + h[2] * c[2];
        j[2] += h[0] * c[0] + h[1] * c[1];
        j[3] -= h[0] * c[1];
        j[4] -= h[0] * c[2];
        j[5] -= h[1] * c[2];
        Self { m, h, j }
    }

    /// `I m`: the momentum of a motion.
    #[inline(always)]
    pub(crate) fn times<X: Linear<T>>(&self, m: Spatial<X>) -> Spatial<X> {
        let (j, w) = (&self.j, m.a);
        let jw = [
            w[0] * j[0] + w[1] * j[3] + w[2] * j[4],
            w[0] * j[3] + w[1] * j[1] + w[2] * j[5],
            w[0] * j[4] + w[1] * j[5] + w[2] * j[2],
        ];
        Spatial {
            a: add(jw, cross_left(self.h, m.l)),
            l: add(scale(m.l, self.m), cross(w, self.h)),
        }
    }

    #[inline(always)]
    pub(crate) fn add(&mut self, other: &Self) {
        self.m += other.m;
        for i in 0..3 {
            self.h[i] += other.h[i];
        }
        for i in 0..6 {
            self.j[i] += other.j[i];
        }
    }
}

/// `R v` of a constant vector.
#[inline(always)]
pub(crate) fn rotate<T: Scalar>(r: &M<T>, v: Vec3) -> V<T> {
    three!(|i| r[i][0] * v[0] + r[i][1] * v[1] + r[i][2] * v[2])
}

/// Product of rotations.
#[inline(always)]
pub(crate) fn product<T: Scalar>(a: &M<T>, b: &M<T>) -> M<T> {
    three!(|i| three!(|j| a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j]))
}

/// Product with a constant rotation.
#[inline(always)]
pub(crate) fn product_with<T: Scalar>(a: &M<T>, b: &Mat3) -> M<T> {
    three!(|i| three!(|j| a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j]))
}

/// `R S Rᵀ` for a constant symmetric matrix: xx, yy, zz, xy, xz, yz.
#[inline(always)]
pub(crate) fn congruence<T: Scalar>(r: &M<T>, s: &[f64; 6]) -> [T; 6] {
    let full = [[s[0], s[3], s[4]], [s[3], s[1], s[5]], [s[4], s[5], s[2]]];
    let rs = product_with(r, &full);
    let entry = |i: usize, j: usize| rs[i][0] * r[j][0] + rs[i][1] * r[j][1] + rs[i][2] * r[j][2];
    [entry(0, 0), entry(1, 1), entry(2, 2), entry(0, 1), entry(0, 2), entry(1, 2)]
}

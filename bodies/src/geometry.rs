//! Nearest points of balls and capsules, and tangents of normals, with their reverse derivatives.

use crate::spatial::*;
use physgrad::{Cotangent, Real, Scalar};

/// A capsule in axes of the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Capsule<T> {
    pub(crate) centre: V<T>,
    /// From the centre to one end.
    pub(crate) half: V<T>,
    pub(crate) radius: f64,
    /// Whether it has no length.
    pub(crate) is_ball: bool,
}

/// Nearest points of two capsules.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Near<T> {
    /// Distance of the surfaces, negative where they overlap.
    pub(crate) gap: T,
    /// The middle between the surfaces.
    pub(crate) point: V<T>,
    /// From the first to the second.
    pub(crate) normal: V<T>,
    /// Positions along the axes, from -1 to 1.
    along: [T; 2],
    /// Whether each is inside its axis rather than at an end: 1 or 0.
    inside: [T; 2],
    between: V<T>,
    /// Reciprocal of the distance of the axes, 0 where they meet.
    per_length: T,
}

/// Axes with a squared sine below this are parallel: the first capsule touches at its centre, or
/// at the end of an axis.
const PARALLEL: f64 = 1e-12;
/// Square of the distance below which axes meet, m².
const MEETING: f64 = 1e-30;

#[inline(always)]
pub(crate) fn nearest<T: Scalar>(a: &Capsule<T>, b: &Capsule<T>) -> Near<T> {
    let (o, one) = (T::zero(), T::one());
    let apart = sub(b.centre, a.centre);
    let (aa, bb) = (square(a), square(b));
    let ab = dot(a.half, b.half);
    let (ua, ub) = (dot(apart, a.half), dot(apart, b.half));
    let clamp = |x: T| x.clamp(-1.0, 1.0);
    let (mut s, mut t) = (o, o);
    if !a.is_ball && !b.is_ball {
        let det = aa * bb - ab * ab;
        let parallel = aa * bb * PARALLEL;
        let free = (ua * bb - ub * ab) / T::select_lt(parallel, det, det, one);
        s = T::select_lt(parallel, det, clamp(free), o);
        t = clamp((ab * s - ub) / bb);
        s = clamp((ab * t + ua) / aa);
    } else if !a.is_ball {
        s = clamp(ua / aa);
    } else if !b.is_ball {
        t = clamp(-ub / bb);
    }
    let between = sub(add(apart, scale(b.half, t)), scale(a.half, s));
    let (square, least) = (dot(between, between), T::from(MEETING));
    let length = square.max(least).sqrt();
    let per_length = T::select_lt(least, square, length.recip(), o);
    let normal = scale(between, length.recip());
    let crossed = crossed(a, b);
    let normal = three!(|i| T::select_lt(least, square, normal[i], crossed[i]));
    let gap = T::select_lt(least, square, length, o) - (a.radius + b.radius);
    let inside = |x: T, ball: bool| {
        if ball { o } else { T::select_lt(x.abs(), one, one, o) }
    };
    Near {
        gap,
        point: add(add(a.centre, scale(a.half, s)), scale(normal, gap * 0.5 + a.radius)),
        normal,
        along: [s, t],
        inside: [inside(s, a.is_ball), inside(t, b.is_ball)],
        between,
        per_length,
    }
}

/// Normal where axes meet: across both. It is constant there.
#[inline(always)]
fn crossed<T: Scalar>(a: &Capsule<T>, b: &Capsule<T>) -> V<T> {
    let (o, one) = (T::zero(), T::one());
    let across = cross(a.half, b.half);
    let across = three!(|i| across[i].detach());
    let (square, least) = (dot(across, across), T::from(MEETING));
    let unit = scale(across, square.max(least).sqrt().recip());
    let otherwise = [one, o, o];
    three!(|i| T::select_lt(least, square, unit[i], otherwise[i]))
}

#[inline(always)]
fn square<T: Scalar>(a: &Capsule<T>) -> T {
    if a.is_ball { T::one() } else { dot(a.half, a.half) }
}

/// Cotangents of a capsule: centre and half.
pub(crate) type CapsuleBar<C> = [V<C>; 2];

/// Cotangents of two capsules from those of gap, point and normal.
#[inline(always)]
pub(crate) fn nearest_vjp<R: Real, C: Cotangent<R>>(
    [a, b]: [&Capsule<R>; 2],
    near: &Near<R>,
    gap_bar: C,
    point_bar: V<C>,
    mut normal_bar: V<C>,
) -> [CapsuleBar<C>; 2] {
    let n = near.normal;
    let gap_bar = gap_bar + dot(point_bar, n) * R::from(0.5);
    let offset = near.gap * 0.5 + a.radius;
    normal_bar = add(normal_bar, scale(point_bar, offset));
    let across = sub(normal_bar, spread(dot(normal_bar, n), n));
    let mut second = add(scale(across, near.per_length), spread(gap_bar, n));
    let mut first = sub(point_bar, second);
    let [s, t] = near.along;
    // Positions inside their axes solve `between · half = 0`.
    let (s_bar, t_bar) = (dot(first, a.half), dot(second, b.half));
    let [inside_s, inside_t] = near.inside;
    let (aa, bb, ab) = (square(a), square(b), dot(a.half, b.half));
    let coupled = inside_s * inside_t * ab;
    let det = aa * bb - coupled * ab;
    let det = R::select_lt(aa * bb * PARALLEL, det, det, aa * bb);
    let (s_bar, t_bar) = (s_bar * inside_s, t_bar * inside_t);
    let along_a = (s_bar * bb + t_bar * coupled) * det.recip();
    let along_b = (t_bar * aa + s_bar * coupled) * det.recip();
    let shift = sub(spread(along_a, a.half), spread(along_b, b.half));
    second = add(second, shift);
    first = sub(first, shift);
    let half_a = add(scale(first, s), spread(along_a, near.between));
    let half_b = sub(scale(second, t), spread(along_b, near.between));
    [[first, half_a], [second, half_b]]
}

/// A unit tangent of a constant normal: the y axis, or the z axis near the y axis, made orthogonal.
pub(crate) fn tangent(normal: [f64; 3]) -> [f64; 3] {
    tangent_of(normal)
}

/// The same for a normal that moves.
#[inline(always)]
pub(crate) fn tangent_of<T: Scalar>(n: V<T>) -> V<T> {
    let (axis, along) = reference(n);
    let flat = sub(axis, scale(n, along));
    scale(flat, dot(flat, flat).sqrt().recip())
}

/// The axis for tangents, and its component along the normal.
#[inline(always)]
fn reference<T: Scalar>(n: V<T>) -> (V<T>, T) {
    let half = T::from(0.5);
    let (o, one) = (T::zero(), T::one());
    let y = T::select_lt(n[1].abs(), half, one, o);
    let z = -y + 1.0;
    ([o, y, z], n[1] * y + n[2] * z)
}

/// Cotangent of the normal from those of the tangents `t1` and `n × t1`.
#[inline(always)]
pub(crate) fn tangents_vjp<R: Real, C: Cotangent<R>>(
    n: V<R>,
    t1: V<R>,
    mut t1_bar: V<C>,
    t2_bar: V<C>,
) -> V<C> {
    let mut n_bar = cross_left(t1, t2_bar);
    t1_bar = add(t1_bar, cross(t2_bar, n));
    let (axis, along) = reference(n);
    let flat = sub(axis, scale(n, along));
    let across = sub(t1_bar, spread(dot(t1_bar, t1), t1));
    let flat_bar = scale(across, dot(flat, flat).sqrt().recip());
    n_bar = sub(n_bar, add(spread(dot(flat_bar, n), axis), scale(flat_bar, along)));
    n_bar
}

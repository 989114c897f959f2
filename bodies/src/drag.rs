//! [`Drag`]: forces of a medium at rest or in wind on each body.
//!
//! A body is replaced by the box with its mass and moments. In the principal axes at the centre of
//! mass, force and moment are `-linear velocity - square |velocity| velocity` per component.
//! Source: MuJoCo documentation, chapter Fluid forces, section Inertia model.

use crate::model::{Mat3, Options, Vec3};
use crate::spatial::*;
use crate::tree::{Drag, Inertial};
use nalgebra::{Matrix3, SymmetricEigen};
use physgrad::{Cotangent, Real, Scalar};
use std::f64::consts::PI;

/// Drag of a body with these principal axes, if there is a medium.
pub(crate) fn of(
    options: &Options,
    dof: usize,
    body: &Inertial,
    axes: Option<Mat3>,
) -> Option<Drag> {
    if options.density == 0.0 && options.viscosity == 0.0 {
        return None;
    }
    let (moments, axes) = principal(body.moments, axes);
    let edge = |i: usize| {
        let others = moments.iter().sum::<f64>() - 2.0 * moments[i];
        (others.max(1e-15) / body.mass * 6.0).sqrt()
    };
    let [x, y, z] = [edge(0), edge(1), edge(2)];
    let diameter = (x + y + z) / 3.0;
    let (rho, beta) = (options.density, options.viscosity);
    let turn = |a: f64, b: f64, c: f64| rho * a * (b.powi(4) + c.powi(4)) / 64.0;
    let (slow, fast) = (PI * beta * diameter.powi(3), 3.0 * PI * beta * diameter);
    Some(Drag {
        dof,
        centre: body.centre,
        axes,
        linear: [slow, slow, slow, fast, fast, fast],
        square: [
            turn(x, y, z),
            turn(y, x, z),
            turn(z, x, y),
            0.5 * rho * y * z,
            0.5 * rho * x * z,
            0.5 * rho * x * y,
        ],
    })
}

/// Principal moments and axes in columns: along the given axes, or any.
///
/// Drag depends on the axes of the box also if moments are equal.
fn principal(j: [f64; 6], axes: Option<Mat3>) -> (Vec3, Mat3) {
    let matrix = Matrix3::new(j[0], j[3], j[4], j[3], j[1], j[5], j[4], j[5], j[2]);
    if let Some(axes) = axes {
        let turn = Matrix3::from_fn(|i, k| axes[i][k]);
        let moments = turn.transpose() * matrix * turn;
        return ([0, 1, 2].map(|k| moments[(k, k)]), axes);
    }
    let eigen = SymmetricEigen::new(matrix);
    let axes = [0, 1, 2].map(|i| [0, 1, 2].map(|k| eigen.eigenvectors[(i, k)]));
    ([0, 1, 2].map(|k| eigen.eigenvalues[k]), axes)
}

/// Principal axes and centre of mass of a body at a pose of its link.
#[inline(always)]
fn frame<T: Scalar>(drag: &Drag, r: &M<T>, p: V<T>) -> (M<T>, V<T>) {
    (product_with(r, &drag.axes), add(p, rotate(r, drag.centre)))
}

/// Velocity of the link relative to the medium.
#[inline(always)]
fn relative<T: Scalar>(options: &Options, v: Spatial<T>) -> Spatial<T> {
    Spatial { a: v.a, l: three!(|i| v.l[i] - options.wind[i]) }
}

/// Components of a motion in the principal axes at the centre of mass.
#[inline(always)]
fn local<T: Scalar, X: Linear<T>>(axes: &M<T>, centre: V<T>, m: Spatial<X>) -> [V<X>; 2] {
    let at = m.at(centre);
    let in_axes = |x: V<X>| three!(|j| x[0] * axes[0][j] + x[1] * axes[1][j] + x[2] * axes[2][j]);
    [in_axes(m.a), in_axes(at)]
}

/// The force with these components.
#[inline(always)]
fn global<T: Scalar, X: Linear<T>>(
    axes: &M<T>,
    centre: V<T>,
    [moment, force]: [V<X>; 2],
) -> Spatial<X> {
    let out = |x: V<X>| three!(|i| x[0] * axes[i][0] + x[1] * axes[i][1] + x[2] * axes[i][2]);
    let force = out(force);
    let at = Spatial::force(force, centre);
    Spatial { a: add(out(moment), at.a), l: at.l }
}

/// Force of the medium.
#[inline(always)]
pub(crate) fn force<T: Scalar>(
    drag: &Drag,
    options: &Options,
    r: &M<T>,
    p: V<T>,
    v: Spatial<T>,
) -> Spatial<T> {
    let (axes, centre) = frame(drag, r, p);
    push(drag, &axes, centre, local(&axes, centre, relative(options, v)))
}

/// Force at these velocities in the principal axes.
#[inline(always)]
fn push<T: Scalar>(drag: &Drag, axes: &M<T>, centre: V<T>, mut parts: [V<T>; 2]) -> Spatial<T> {
    for (k, x) in parts.iter_mut().flatten().enumerate() {
        *x = -(*x * (x.abs() * drag.square[k] + drag.linear[k]));
    }
    global(axes, centre, parts)
}

/// Cotangents of `-w · force` for a virtual motion w: of w, of the velocity, and the twist of the
/// pose.
#[inline(always)]
pub(crate) fn vjp<R: Real, C: Cotangent<R>>(
    drag: &Drag,
    options: &Options,
    (r, p): (&M<R>, V<R>),
    v: Spatial<R>,
    w: Spatial<C>,
) -> (Spatial<R>, Spatial<C>, Spatial<C>) {
    let (axes, centre) = frame(drag, r, p);
    let v = relative(options, v);
    let speeds = local(&axes, centre, v);
    let push = push(drag, &axes, centre, speeds);
    let w_bar = Spatial { a: neg(push.a), l: neg(push.l) };
    let mut parts = local(&axes, centre, w);
    for (k, (x, speed)) in parts.iter_mut().flatten().zip(speeds.iter().flatten()).enumerate() {
        *x = *x * (speed.abs() * (2.0 * drag.square[k]) + drag.linear[k]);
    }
    let v_bar = global(&axes, centre, parts);
    // The power does not change if pose, velocity and virtual motion move together.
    let twist = w.cross_force(w_bar) + cross_force_left(v, v_bar);
    (w_bar, v_bar, Spatial::fill(C::null()) - twist)
}

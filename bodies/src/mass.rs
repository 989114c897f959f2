//! Masses and moments of inertia of solid forms and of bodies.

use crate::model::{Body, Form, Joint, Mat3, Vec3};
use crate::rotation::{IDENTITY, Pose, product, transposed};
use std::f64::consts::PI;

/// Mass with its centre and its inertia about the centre, in the axes of the body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Part {
    pub mass: f64,
    pub centre: Vec3,
    pub inertia: Mat3,
    /// Principal axes in columns, if the file gives them.
    pub axes: Option<Mat3>,
}

impl Part {
    /// The part of an inner frame in the axes of the outer frame.
    pub fn placed(&self, pose: &Pose) -> Self {
        let turned = product(&pose.rotation, &self.inertia);
        Self {
            mass: self.mass,
            centre: pose.point(self.centre),
            inertia: product(&turned, &transposed(&pose.rotation)),
            axes: self.axes.map(|axes| product(&pose.rotation, &axes)),
        }
    }
}

/// Volume of a form, m³. Planes have none.
pub(crate) fn volume(form: Form) -> f64 {
    match form {
        Form::Plane => 0.0,
        Form::Sphere(r) => 4.0 / 3.0 * PI * r * r * r,
        Form::Capsule(r, h) => PI * r * r * (2.0 * h + 4.0 / 3.0 * r),
        Form::Cylinder(r, h) => PI * r * r * 2.0 * h,
        Form::Ellipsoid([a, b, c]) => 4.0 / 3.0 * PI * a * b * c,
        Form::Box([a, b, c]) => 8.0 * a * b * c,
    }
}

/// Moments of inertia about the centre of a form with constant density, over its mass, in m².
pub(crate) fn moments(form: Form) -> Vec3 {
    // Sum of two squares for each axis.
    let pairs = |s: Vec3| {
        let [a, b, c] = s.map(|x| x * x);
        [b + c, a + c, a + b]
    };
    match form {
        Form::Plane => [0.0; 3],
        Form::Sphere(r) => [0.4 * r * r; 3],
        Form::Capsule(r, h) => capsule(r, h),
        Form::Cylinder(r, h) => {
            let across = (3.0 * r * r + 4.0 * h * h) / 12.0;
            [across, across, 0.5 * r * r]
        }
        Form::Ellipsoid(s) => pairs(s).map(|x| x / 5.0),
        Form::Box(s) => pairs(s).map(|x| x / 3.0),
    }
}

/// A cylinder and two half balls whose centres of mass are 3/8 r beyond its ends.
fn capsule(r: f64, h: f64) -> Vec3 {
    let balls = 4.0 * r / (4.0 * r + 6.0 * h);
    let cylinder = 1.0 - balls;
    let across = cylinder * (3.0 * r * r + 4.0 * h * h) / 12.0
        + balls * (0.4 * r * r + h * h + 0.75 * h * r);
    [across, across, cylinder * 0.5 * r * r + balls * 0.4 * r * r]
}

/// The inertia with these principal moments, whose axes are the columns of the rotation.
pub(crate) fn turned(moments: Vec3, rotation: &Mat3) -> Mat3 {
    let scaled = rotation.map(|row| [0, 1, 2].map(|k| row[k] * moments[k]));
    product(&scaled, &transposed(rotation))
}

/// Parts as one: about the common centre, by the parallel axis theorem.
pub(crate) fn together(parts: &[Part]) -> Part {
    if let [only] = parts {
        return *only;
    }
    let mass: f64 = parts.iter().map(|p| p.mass).sum();
    let moment = |i: usize| parts.iter().map(|p| p.mass * p.centre[i]).sum::<f64>();
    let centre = if mass > 0.0 { [0, 1, 2].map(|i| moment(i) / mass) } else { [0.0; 3] };
    let mut inertia = [[0.0; 3]; 3];
    for part in parts {
        let d = [0, 1, 2].map(|i| part.centre[i] - centre[i]);
        let square: f64 = d.iter().map(|x| x * x).sum();
        for i in 0..3 {
            for j in 0..3 {
                inertia[i][j] +=
                    part.inertia[i][j] + part.mass * (square * IDENTITY[i][j] - d[i] * d[j]);
            }
        }
    }
    Part { mass, centre, inertia, axes: None }
}

/// Principal moments of a symmetric matrix and their axes as columns: Jacobi's method.
pub(crate) fn principal(matrix: &Mat3) -> (Vec3, Mat3) {
    let (mut m, mut axes) = (*matrix, IDENTITY);
    // Convergence is quadratic; 6 sweeps are ample for 3 rows.
    for _ in 0..12 {
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            if m[i][j] == 0.0 {
                continue;
            }
            let ratio = (m[j][j] - m[i][i]) / (2.0 * m[i][j]);
            let t = ratio.signum() / (ratio.abs() + (1.0 + ratio * ratio).sqrt());
            let c = 1.0 / (1.0 + t * t).sqrt();
            let s = t * c;
            let mut turn = IDENTITY;
            (turn[i][i], turn[j][j], turn[i][j], turn[j][i]) = (c, c, s, -s);
            m = product(&transposed(&turn), &product(&m, &turn));
            (m[i][j], m[j][i]) = (0.0, 0.0);
            axes = product(&axes, &turn);
        }
    }
    ([m[0][0], m[1][1], m[2][2]], axes)
}

/// The matrix of moments in the order of [`Body`].
pub(crate) fn matrix([xx, yy, zz, xy, xz, yz]: [f64; 6]) -> Mat3 {
    [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
}

/// The moments of a matrix in the order of [`Body`].
pub(crate) fn flat(i: &Mat3) -> [f64; 6] {
    [i[0][0], i[1][1], i[2][2], i[0][1], i[0][2], i[1][2]]
}

/// Whether a moment is negative, beyond rounding.
pub(crate) fn negative(moments: Vec3) -> bool {
    let largest = moments.into_iter().fold(0.0, f64::max);
    moments.iter().any(|m| *m < -1e-12 * largest)
}

/// Whether a moment exceeds the sum of the other two, beyond rounding. No body has such moments.
pub(crate) fn unbalanced(moments: Vec3) -> bool {
    let largest = moments.into_iter().fold(0.0, f64::max);
    2.0 * largest > moments.iter().sum::<f64>() * (1.0 + 1e-9)
}

/// The first body that has a joint and cannot move, with the reason: it has no mass, no inertia, or
/// moments of inertia that no body has. Bodies that are fixed to it belong to it.
pub(crate) fn immovable(bodies: &[Body], joints: &[Joint]) -> Option<(usize, &'static str)> {
    // MuJoCo's smallest mass and moment of inertia of a body that moves.
    const LEAST: f64 = 1e-15;
    let mut moves = vec![false; bodies.len()];
    joints.iter().for_each(|j| moves[j.body] = true);
    let mut parts: Vec<Part> = bodies
        .iter()
        .map(|b| Part { mass: b.mass, centre: b.centre, inertia: matrix(b.inertia), axes: None })
        .collect();
    let mut found = None;
    // Children follow their parents.
    for body in (1..bodies.len()).rev() {
        if !moves[body] {
            let pose = Pose { position: bodies[body].position, rotation: bodies[body].rotation };
            let parent = bodies[body].parent;
            parts[parent] = together(&[parts[parent], parts[body].placed(&pose)]);
            continue;
        }
        let Part { mass, inertia, .. } = parts[body];
        let (moments, _) = principal(&inertia);
        if mass < LEAST || moments.iter().any(|m| (0.0..LEAST).contains(m)) {
            found = Some((body, "it moves and has no mass or no inertia; add mass"));
        } else if negative(moments) || unbalanced(moments) {
            let what = "a principal moment of its inertia is negative or exceeds the sum of the \
                        other two, which no body has; correct the inertia";
            found = Some((body, what));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mass and moments by sums over a grid of points inside.
    fn sampled(inside: impl Fn(Vec3) -> bool, half: Vec3) -> (f64, Vec3) {
        let n = 60;
        let (mut count, mut moments) = (0.0, [0.0; 3]);
        for index in 0..n * n * n {
            let cell = [index % n, index / n % n, index / n / n];
            let p = [0, 1, 2].map(|k| half[k] * ((2 * cell[k] + 1) as f64 / n as f64 - 1.0));
            if inside(p) {
                let [x, y, z] = p.map(|v| v * v);
                count += 1.0;
                moments = [moments[0] + y + z, moments[1] + x + z, moments[2] + x + y];
            }
        }
        let cell = half.iter().map(|h| 2.0 * h / n as f64).product::<f64>();
        (count * cell, moments.map(|m| m / count))
    }

    #[test]
    fn forms_agree_with_sums_over_points() {
        let (r, h) = (0.3, 0.5);
        let round = |p: Vec3| p[0] * p[0] + p[1] * p[1];
        let over = |p: Vec3| (p[2].abs() - h).max(0.0);
        let s = [0.2, 0.3, 0.5];
        let ellipsoid = |p: Vec3| (0..3).map(|k| (p[k] / s[k]).powi(2)).sum::<f64>() <= 1.0;
        let cases: [(Form, (f64, Vec3)); 5] = [
            (Form::Sphere(r), sampled(|p| round(p) + p[2] * p[2] <= r * r, [r; 3])),
            (Form::Capsule(r, h), sampled(|p| round(p) + over(p).powi(2) <= r * r, [r, r, h + r])),
            (Form::Cylinder(r, h), sampled(|p| round(p) <= r * r, [r, r, h])),
            (Form::Ellipsoid(s), sampled(ellipsoid, s)),
            (Form::Box(s), sampled(|_| true, s)),
        ];
        for (form, (expected, expected_moments)) in cases {
            let close = |a: f64, b: f64| (a / b - 1.0).abs() < 1e-2;
            assert!(close(volume(form), expected), "{form:?}");
            for (a, b) in moments(form).into_iter().zip(expected_moments) {
                assert!(close(a, b), "{form:?}: {a} and {b}");
            }
        }
    }

    #[test]
    fn two_halves_of_a_box_are_the_box() {
        let half = Form::Box([0.1, 0.2, 0.3]);
        let part = |x: f64| Part {
            mass: 2.0,
            centre: [x, 1.0, -1.0],
            inertia: turned(moments(half).map(|m| 2.0 * m), &IDENTITY),
            axes: None,
        };
        let both = together(&[part(0.1), part(-0.1)]);
        let whole = moments(Form::Box([0.2, 0.2, 0.3]));
        assert_eq!(both.mass, 4.0);
        assert!(both.centre[0].abs() < 1e-15);
        for (k, moment) in whole.into_iter().enumerate() {
            assert!((both.inertia[k][k] - 4.0 * moment).abs() < 1e-15);
        }
    }

    #[test]
    fn principal_moments_and_axes_make_the_matrix() {
        let m = [[2.0, 0.3, -0.1], [0.3, 1.5, 0.4], [-0.1, 0.4, 1.0]];
        let (moments, axes) = principal(&m);
        let again = turned(moments, &axes);
        for (a, b) in again.iter().flatten().zip(m.iter().flatten()) {
            assert!((a - b).abs() < 1e-14);
        }
    }
}

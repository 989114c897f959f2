//! [`Distribution`]: mass, centre of mass and moments of inertia of a body as ten numbers.
//!
//! Every body is a distribution of mass with a second moment `S = ∫ (x - c)(x - c)ᵀ dm / m` about its
//! centre c, and has the moments of inertia `m (tr S - S)`. The numbers stretch and shear the
//! distribution of the file, S₀: `S = F S₀ Fᵀ` with an upper triangular F. So S is positive
//! semidefinite for all numbers, which the triangle inequality of the moments follows from, and every
//! body is reached if S₀ is positive definite. With logarithms of m and of the diagonal, and S₀ = 1,
//! the numbers would be those of C. Rucker and P. Wensing, doi:10.1109/LRA.2022.3144517.

use crate::components::word;
use crate::mass::matrix;
use crate::model::{Body, Mat3, Options, Vec3};
use crate::spatial::*;
use crate::tree::{Coefficient, Placed};
use physgrad::{Cotangent, Real, Scalar};

/// Keys of the centre, and of F: its diagonal and what is above it.
const CENTRE: [&str; 3] = ["centre_x", "centre_y", "centre_z"];
const MAP: [&str; 6] = ["stretch_x", "stretch_y", "stretch_z", "shear_xy", "shear_xz", "shear_yz"];
/// Rows and columns of these entries of F, and F of the file.
const ENTRIES: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
const UNCHANGED: [f64; 6] = [1.0, 1.0, 1.0, 0.0, 0.0, 0.0];

/// The distribution of the mass of a body whose numbers may vary.
#[derive(Clone, Debug)]
pub(crate) struct Distribution {
    pub(crate) mass: Coefficient,
    pub(crate) centre: [Coefficient; 3],
    map: [Coefficient; 6],
    /// S₀ of the file, m².
    second: Mat3,
    /// Frame of the body in that of its link.
    position: Vec3,
    rotation: Mat3,
}

/// Names and values of the numbers of a body, without its mass. The box of a body that moves through a
/// medium is constant, so a medium excludes these numbers.
pub(crate) fn numbers(body: &Body, options: &Options) -> Vec<(&'static str, f64)> {
    if options.density != 0.0 || options.viscosity != 0.0 {
        return Vec::new();
    }
    let keys = CENTRE.into_iter().chain(MAP);
    keys.zip(body.centre.into_iter().chain(UNCHANGED)).collect()
}

impl Distribution {
    pub(crate) fn new(body: &Body, coefficient: &dyn Fn(&str, f64) -> Coefficient) -> Self {
        let name = word(&body.name);
        let number = |key: &str, value: f64| coefficient(&format!("body.{name}.{key}"), value);
        let inertia = matrix(body.inertia);
        let half = (inertia[0][0] + inertia[1][1] + inertia[2][2]) / 2.0;
        let second = |i: usize, j: usize| (half * IDENTITY[i][j] - inertia[i][j]) / body.mass;
        Self {
            mass: number("mass", body.mass),
            centre: [0, 1, 2].map(|i| number(CENTRE[i], body.centre[i])),
            map: [0, 1, 2, 3, 4, 5].map(|i| number(MAP[i], UNCHANGED[i])),
            second: [0, 1, 2].map(|i| [0, 1, 2].map(|j| second(i, j))),
            position: [0.0; 3],
            rotation: IDENTITY,
        }
    }

    /// The distribution in the frame of a link.
    pub(crate) fn placed(&self, at: &Placed) -> Self {
        Self { position: at.position, rotation: at.rotation, ..self.clone() }
    }

    /// Whether numbers besides the mass vary.
    pub(crate) fn varies(&self) -> bool {
        self.centre.iter().chain(&self.map).any(|number| number.entry.is_some())
    }

    pub(crate) fn coefficients(&self) -> impl Iterator<Item = &Coefficient> {
        [&self.mass].into_iter().chain(&self.centre).chain(&self.map)
    }

    /// Gives a body the typical values of the numbers, except for its mass.
    pub(crate) fn apply(&self, body: &mut Body) {
        body.centre = self.centre.map(|x| x.value);
        if self.map.map(|x| x.value) != UNCHANGED {
            let map = self.map.map(|x| Coefficient { entry: None, ..x });
            body.inertia = Self { map, ..self.clone() }.moments(&[]).map(|x: f64| x * body.mass);
        }
    }

    #[inline(always)]
    fn map<T: Scalar>(&self, p: &[T]) -> M<T> {
        let [x, y, z, xy, xz, yz] = &self.map;
        let o = T::zero();
        [[x.of(p), xy.of(p), xz.of(p)], [o, y.of(p), yz.of(p)], [o, o, z.of(p)]]
    }

    /// S: xx, yy, zz, xy, xz, yz.
    #[inline(always)]
    fn second<T: Scalar>(&self, p: &[T]) -> [T; 6] {
        let [xx, yy, zz] = [0, 1, 2].map(|i| self.second[i][i]);
        let second = [xx, yy, zz, self.second[0][1], self.second[0][2], self.second[1][2]];
        congruence(&self.map(p), &second)
    }

    /// Moments of inertia per mass about the centre, in axes of the body.
    #[inline(always)]
    fn moments<T: Scalar>(&self, p: &[T]) -> [T; 6] {
        let s = self.second(p);
        [s[1] + s[2], s[0] + s[2], s[0] + s[1], -s[3], -s[4], -s[5]]
    }

    /// Pose of the body at one of its link.
    #[inline(always)]
    fn pose<T: Scalar>(&self, turn: &M<T>, at: V<T>) -> (M<T>, V<T>) {
        (product_with(turn, &self.rotation), add(at, rotate(turn, self.position)))
    }

    /// Inertia about the origin at a pose of the link.
    #[inline(always)]
    pub(crate) fn inertia<T: Scalar>(&self, turn: &M<T>, at: V<T>, p: &[T]) -> Inertia<T> {
        let (turn, at) = self.pose(turn, at);
        let mass = self.mass.of(p);
        let centre: V<T> = three!(|i| self.centre[i].of(p));
        let centre = add(at, times(&turn, centre));
        let mut moments = turned(&turn, &self.moments(p));
        moments.iter_mut().for_each(|moment| *moment *= mass);
        Inertia::of(mass, centre, moments)
    }

    /// Adds the cotangents of the numbers from the power `Σ w · I n` of pairs of motions (w, n), at a
    /// pose of the link.
    ///
    /// With the velocities of the centre w(c) and n(c), and angular velocities ω and ν in axes of the
    /// body, the power of a pair is `m (w(c) · n(c) + tr(S) ω · ν - ω · S ν)`.
    #[inline(always)]
    pub(crate) fn pull<R: Real, C: Cotangent<R>>(
        &self,
        (turn, at): (&M<R>, V<R>),
        pairs: &[(Spatial<C>, Spatial<R>)],
        p: &[R],
        p_bar: &mut [C],
    ) {
        let (turn, at) = self.pose(turn, at);
        let centre: V<R> = three!(|i| self.centre[i].of(p));
        let (mass, s, map) = (self.mass.of(p), self.second(p), self.map(p));
        let s = [[s[0], s[3], s[4]], [s[3], s[1], s[5]], [s[4], s[5], s[2]]];
        let trace = s[0][0] + s[1][1] + s[2][2];
        let mut mass_bar = C::null();
        let mut centre_bar = [C::null(); 3];
        let mut second_bar = [[C::null(); 3]; 3];
        for &(w, n) in pairs {
            let (omega, nu) = (back(&turn, w.a), back(&turn, n.a));
            let w_c = add(back(&turn, w.at(at)), cross(omega, centre));
            let n_c = add(back(&turn, n.at(at)), cross(nu, centre));
            let along = dot(omega, nu);
            mass_bar += dot(w_c, n_c) + along * trace - dot(omega, times(&s, nu));
            centre_bar = add(centre_bar, add(cross_left(n_c, omega), cross(w_c, nu)));
            for i in 0..3 {
                second_bar[i][i] += along;
                for j in 0..3 {
                    // The derivative by the symmetric S is symmetric.
                    second_bar[i][j] += (omega[i] * nu[j] + omega[j] * nu[i]) * R::from(-0.5);
                }
            }
        }
        let mut give = |number: &Coefficient, bar: C| {
            if let Some(entry) = number.entry {
                p_bar[entry] += bar;
            }
        };
        give(&self.mass, mass_bar);
        for (number, bar) in self.centre.iter().zip(centre_bar) {
            give(number, bar * mass);
        }
        // F S₀ by columns; the derivative by F is 2 m S̄ F S₀.
        let product = product_with(&map, &self.second);
        for (number, (i, j)) in self.map.iter().zip(ENTRIES) {
            let column = [product[0][j], product[1][j], product[2][j]];
            give(number, dot(second_bar[i], column) * (mass * 2.0));
        }
    }
}

/// `R x`.
#[inline(always)]
fn times<T: Scalar>(r: &M<T>, x: V<T>) -> V<T> {
    three!(|i| dot(r[i], x))
}

/// `Rᵀ x`.
#[inline(always)]
fn back<T: Scalar, X: Linear<T>>(r: &M<T>, x: V<X>) -> V<X> {
    three!(|j| x[0] * r[0][j] + x[1] * r[1][j] + x[2] * r[2][j])
}

/// `R S Rᵀ` of a symmetric matrix: xx, yy, zz, xy, xz, yz.
#[inline(always)]
fn turned<T: Scalar>(r: &M<T>, s: &[T; 6]) -> [T; 6] {
    let full = [[s[0], s[3], s[4]], [s[3], s[1], s[5]], [s[4], s[5], s[2]]];
    let rs = product(r, &full);
    let entry = |i: usize, j: usize| rs[i][0] * r[j][0] + rs[i][1] * r[j][1] + rs[i][2] * r[j][2];
    [entry(0, 0), entry(1, 1), entry(2, 2), entry(0, 1), entry(0, 2), entry(1, 2)]
}

const IDENTITY: Mat3 = crate::tree::IDENTITY;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mass::{flat, moments, negative, principal, turned, unbalanced};
    use crate::model::Form;

    fn solid(form: Form) -> Body {
        let inertia = flat(&turned(moments(form).map(|m| 3.0 * m), &IDENTITY));
        Body { mass: 3.0, inertia, ..Body::new("solid", 0, [0.0; 3], IDENTITY) }
    }

    /// The body with these numbers, by their keys.
    fn with(body: &Body, numbers: &[(&str, f64)]) -> Body {
        let coefficient = |name: &str, value: f64| {
            let given = numbers.iter().find(|(key, _)| name == format!("body.solid.{key}"));
            Coefficient { value: given.map_or(value, |(_, value)| *value), entry: None }
        };
        let mut body = body.clone();
        Distribution::new(&body, &coefficient).apply(&mut body);
        body
    }

    #[test]
    fn a_stretched_box_is_a_box_with_a_longer_edge() {
        let stretched = with(&solid(Form::Box([0.1, 0.2, 0.3])), &[("stretch_y", 1.5)]);
        let expected = solid(Form::Box([0.1, 0.3, 0.3]));
        for (a, b) in stretched.inertia.iter().zip(expected.inertia) {
            assert!((a - b).abs() < 1e-15, "{a} and {b}");
        }
    }

    #[test]
    fn a_sheared_ball_has_the_moments_of_its_points() {
        // A ball has S0 = r² / 5; x' = x + 0.5 z turns z² of the moments into x² and xz.
        let sheared = with(&solid(Form::Sphere(1.0)), &[("shear_xz", 0.5)]);
        let (s, [xx, yy, zz, xy, xz, yz]) = (3.0 / 5.0, sheared.inertia);
        for (a, b) in [(xx, 2.0 * s), (yy, 2.25 * s), (zz, 2.25 * s), (xy, 0.0), (xz, -0.5 * s)] {
            assert!((a - b).abs() < 1e-15, "{a} and {b}");
        }
        assert_eq!(yz, 0.0);
    }

    #[test]
    fn all_numbers_are_those_of_a_body() {
        let start = solid(Form::Box([0.1, 0.2, 0.3]));
        let keys = ["stretch_x", "stretch_y", "stretch_z", "shear_xy", "shear_xz", "shear_yz"];
        for seed in 0..1000_u32 {
            let value = |k: usize| {
                f64::from(seed.pow(2) * 31 % 997 + seed * 7 * k as u32 % 89) / 50.0 - 9.0
            };
            let numbers: Vec<_> =
                keys.iter().enumerate().map(|(k, key)| (*key, value(k))).collect();
            let body = with(&start, &numbers);
            let (moments, _) = principal(&matrix(body.inertia));
            assert!(!negative(moments) && !unbalanced(moments), "{numbers:?} gives {moments:?}");
        }
    }
}

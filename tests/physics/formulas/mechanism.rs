//! Motion of point masses on massless rods, by d'Alembert's principle.

use super::*;

/// Point mass at `(X + Σ arms_k sin θ_k, Σ arms_k cos θ_k)`. X is the position of the cart, or 0
/// without a cart.
pub(super) struct Point {
    pub(super) mass: f64,
    pub(super) arms: Vec<f64>,
}

/// Point masses on massless rods. The coordinates q are the position of the cart, if there is one,
/// and the angles.
pub(super) struct Mechanism {
    pub(super) points: Vec<Point>,
    pub(super) cart: bool,
    pub(super) gravity: f64,
}

impl Mechanism {
    /// Returns `∂position/∂q_i` of a point.
    fn slope(&self, point: &Point, i: usize, q: &[f64]) -> [f64; 2] {
        match (self.cart, i) {
            (true, 0) => [1.0, 0.0],
            _ => {
                let arm = point.arms[i - usize::from(self.cart)];
                [arm * q[i].cos(), -arm * q[i].sin()]
            }
        }
    }

    /// Returns q̈ for the applied forces Q, by d'Alembert's principle:
    /// `Σ m J_i · (J q̈ + dJ/dt q̇ - g) = Q_i`. The sum is over the points. J is the Jacobian of
    /// the position of a point, with the columns J_i. The vector g is the acceleration of gravity.
    pub(super) fn accelerations(&self, x: &[f64], applied: &[f64]) -> Vec<f64> {
        let (q, speed): (Vec<f64>, Vec<f64>) =
            x.chunks_exact(2).map(|pair| (pair[0], pair[1])).unzip();
        let (n, first) = (q.len(), usize::from(self.cart));
        let (mut matrix, mut right) = (vec![vec![0.0; n]; n], applied.to_vec());
        for point in &self.points {
            let j: Vec<[f64; 2]> = (0..n).map(|i| self.slope(point, i, &q)).collect();
            let mut outward = [0.0, self.gravity];
            for i in first..n {
                let spin = point.arms[i - first] * speed[i] * speed[i];
                outward[0] -= spin * q[i].sin();
                outward[1] -= spin * q[i].cos();
            }
            for a in 0..n {
                right[a] -= point.mass * (j[a][0] * outward[0] + j[a][1] * outward[1]);
                for b in 0..n {
                    matrix[a][b] += point.mass * (j[a][0] * j[b][0] + j[a][1] * j[b][1]);
                }
            }
        }
        solve(matrix, right)
    }

    /// Returns kinetic plus potential energy.
    pub(super) fn energy(&self, x: &[f64]) -> f64 {
        let (q, speed): (Vec<f64>, Vec<f64>) =
            x.chunks_exact(2).map(|pair| (pair[0], pair[1])).unzip();
        let of_point = |point: &Point| {
            let (mut v, mut height) = ([0.0; 2], 0.0);
            for (i, speed) in speed.iter().enumerate() {
                let slope = self.slope(point, i, &q);
                v = [v[0] + slope[0] * speed, v[1] + slope[1] * speed];
            }
            for (arm, theta) in point.arms.iter().zip(&q[usize::from(self.cart)..]) {
                height += arm * theta.cos();
            }
            point.mass * (0.5 * (v[0] * v[0] + v[1] * v[1]) + self.gravity * height)
        };
        self.points.iter().map(of_point).sum()
    }
}

/// Returns point masses with the mass, center and inertia of a uniform rod. Each end has a sixth of
/// the mass, and the middle has the rest.
pub(super) fn rod(
    mass: f64,
    half_length: f64,
    base: &[f64],
    of_poles: usize,
    pole: usize,
) -> impl Iterator<Item = Point> {
    [(1.0 / 6.0, 0.0), (4.0 / 6.0, 1.0), (1.0 / 6.0, 2.0)].into_iter().map(move |(share, place)| {
        let mut arms = base.to_vec();
        arms.resize(of_poles, 0.0);
        arms[pole] = place * half_length;
        Point { mass: share * mass, arms }
    })
}

/// Returns a model whose numbers differ from the defaults.
pub(super) fn model(poles: usize) -> CartPoleSystem {
    CartPoleSystem {
        poles,
        cart_mass: 1.3.into(),
        pole_mass: 0.4.into(),
        half_length: 0.7.into(),
        gravity: 9.1.into(),
        dt: 0.02,
    }
}

/// Returns a cart with all poles hinged on it. If `chained`, only the first pole is hinged on the
/// cart, and each further pole on the end of the previous pole.
pub(super) fn on_cart(model: &CartPoleSystem, chained: bool) -> Mechanism {
    let (poles, [cart_mass, pole_mass, half_length, gravity]) = (model.poles, model.nominal());
    let mut points = vec![Point { mass: cart_mass, arms: vec![0.0; poles] }];
    for pole in 0..poles {
        let base = vec![if chained { 2.0 * half_length } else { 0.0 }; pole];
        points.extend(rod(pole_mass, half_length, &base, poles, pole));
    }
    Mechanism { points, cart: true, gravity }
}

/// Returns the next state: first updates speeds, then positions with the new speeds.
pub(super) fn semi_implicit(x: &[f64], accelerations: &[f64], dt: f64) -> Vec<f64> {
    let moved = |(pair, a): (&[f64], &f64)| [pair[0] + dt * (pair[1] + dt * a), pair[1] + dt * a];
    x.chunks_exact(2).zip(accelerations).flat_map(moved).collect()
}

//! [`DoublePendulum`]: a planar double pendulum without friction, one of the simplest chaotic
//! systems.

use crate::dynamics::inputs::{Cotangents, OdeInputs};
use crate::dynamics::ode::Ode;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use serde::{Deserialize, Serialize};

/// Two point masses on massless rods, the second hanging from the first, with a torque on the first
/// joint.
///
/// State `[θ₁, ω₁, θ₂, ω₂]` in rad and rad/s, both angles from upright. Control `[u]`, the torque
/// in N m about the fixed joint. With Δ = θ₁ - θ₂, Lagrange's equations are:
///
/// ```text
/// (m₁ + m₂) l₁² α₁ + m₂ l₁ l₂ cos Δ α₂ = (m₁ + m₂) g l₁ sin θ₁ - m₂ l₁ l₂ sin Δ ω₂² + u
/// m₂ l₁ l₂ cos Δ α₁ + m₂ l₂² α₂        = m₂ g l₂ sin θ₂ + m₂ l₁ l₂ sin Δ ω₁²
/// ```
///
/// The code computes the determinant of the mass matrix as `m₂ l₁² l₂² (m₁ + m₂ sin² Δ)`. The
/// difference of the products of matrix entries would lose all digits for small m₁ and sin Δ.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct DoublePendulum {
    /// Masses m₁ and m₂, kg.
    pub masses: [f64; 2],
    /// Rod lengths l₁ and l₂, m.
    pub lengths: [f64; 2],
    /// Gravitational acceleration g, m/s².
    pub gravity: f64,
}

impl Default for DoublePendulum {
    /// Returns masses of 1 kg on rods of 1 m, with g = 9.81 m/s².
    fn default() -> Self {
        Self { masses: [1.0; 2], lengths: [1.0; 2], gravity: 9.81 }
    }
}

/// Trigonometric functions of the angles, and accelerations.
struct Motion<T> {
    /// `[sin, cos]` of θ₁.
    first: [T; 2],
    /// `[sin, cos]` of θ₂.
    second: [T; 2],
    /// `[sin, cos]` of Δ.
    between: [T; 2],
    /// `[α₁, α₂]`, rad/s².
    accelerations: [T; 2],
}

impl DoublePendulum {
    /// Returns kinetic plus potential energy of a state, J. The energy is 0 at rest with both rods
    /// horizontal. Without torque, the equations conserve the energy.
    pub fn energy(&self, x: &[f64]) -> f64 {
        let ([inertia, coupling, second_inertia], [weight, second_weight]) =
            (self.inertias(), self.weights());
        let [theta, omega, second_theta, second_omega] = [x[0], x[1], x[2], x[3]];
        let kinetic = 0.5
            * (inertia * omega * omega + second_inertia * second_omega * second_omega)
            + coupling * omega * second_omega * (theta - second_theta).cos();
        kinetic + weight * theta.cos() + second_weight * second_theta.cos()
    }

    /// Returns `(m₁ + m₂) l₁²`, `m₂ l₁ l₂`, `m₂ l₂²`, in kg m².
    fn inertias(&self) -> [f64; 3] {
        let ([m1, m2], [l1, l2]) = (self.masses, self.lengths);
        [(m1 + m2) * l1 * l1, m2 * l1 * l2, m2 * l2 * l2]
    }

    /// Returns `(m₁ + m₂) g l₁`, `m₂ g l₂`, in N m.
    fn weights(&self) -> [f64; 2] {
        let ([m1, m2], [l1, l2]) = (self.masses, self.lengths);
        [(m1 + m2) * self.gravity * l1, m2 * self.gravity * l2]
    }

    /// Solves `M y = b` for the mass matrix M at `[sin, cos]` of Δ. If `b` contains torques, y
    /// contains accelerations. `b` may also contain cotangents.
    #[inline(always)]
    fn solve<T: Scalar, V: Copy + std::ops::Sub<Output = V> + std::ops::Mul<T, Output = V>>(
        &self,
        [sin, cos]: [T; 2],
        [first, second]: [V; 2],
    ) -> [V; 2] {
        let [inertia, coupling, second_inertia] = self.inertias();
        let ([m1, m2], [l1, l2]) = (self.masses, self.lengths);
        let per_determinant = T::one()
            / (T::from(m2 * (l1 * l2) * (l1 * l2)) * (T::from(m1) + T::from(m2) * sin * sin));
        let across = T::from(coupling) * cos * per_determinant;
        [
            first * (T::from(second_inertia) * per_determinant) - second * across,
            second * (T::from(inertia) * per_determinant) - first * across,
        ]
    }

    #[inline(always)]
    fn motion<T: Scalar>(&self, x: &[T], u: &[T]) -> Motion<T> {
        let coupling = T::from(self.inertias()[1]);
        let [weight, second_weight] = self.weights();
        let (weight, second_weight) = (T::from(weight), T::from(second_weight));
        let ((s1, c1), (s2, c2)) = (x[0].sin_cos(), x[2].sin_cos());
        let between = [s1 * c2 - c1 * s2, c1 * c2 + s1 * s2];
        let centrifugal = coupling * between[0];
        let torques = [
            weight * s1 - centrifugal * x[3] * x[3] + u[0],
            second_weight * s2 + centrifugal * x[1] * x[1],
        ];
        Motion {
            first: [s1, c1],
            second: [s2, c2],
            between,
            accelerations: self.solve(between, torques),
        }
    }
}

impl Ode for DoublePendulum {
    fn state_dim(&self) -> usize {
        4
    }

    fn control_dim(&self) -> usize {
        1
    }

    #[inline(always)]
    fn rate<T: Scalar>(&self, OdeInputs { x, u, .. }: OdeInputs<'_, T>, rate: &mut [T]) {
        let [first, second] = self.motion(x, u).accelerations;
        (rate[0], rate[1], rate[2], rate[3]) = (x[1], first, x[3], second);
    }

    /// Computes the reverse of `M α = τ`: with `M w = ᾱ`, the cotangent of τ is w and that of M is
    /// -w αᵀ.
    #[inline(always)]
    fn rate_vjp<R: Real, C: Cotangent<R>>(
        &self,
        OdeInputs { x, u, .. }: OdeInputs<'_, R>,
        rate_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let Motion { first, second, between: [sin, cos], accelerations: [alpha, second_alpha] } =
            self.motion(x, u);
        let coupling = R::from(self.inertias()[1]);
        let [weight, second_weight] = self.weights();
        let (weight, second_weight) = (R::from(weight), R::from(second_weight));
        let [w, second_w] = self.solve([sin, cos], [rate_bar[1], rate_bar[3]]);
        let (rate_squared, second_rate_squared) = (x[1] * x[1], x[3] * x[3]);
        let centrifugal_slope = coupling * sin * R::from(2.0);
        // Cotangent of Δ: sin Δ enters the torques τ, cos Δ the matrix M.
        let delta_bar = w * (coupling * (sin * second_alpha - cos * second_rate_squared))
            + second_w * (coupling * (sin * alpha + cos * rate_squared));
        if let Some(x_bar) = cotangents.x {
            x_bar[0] += w * (weight * first[1]) + delta_bar;
            x_bar[1] += rate_bar[0] + second_w * (centrifugal_slope * x[1]);
            x_bar[2] += second_w * (second_weight * second[1]) - delta_bar;
            x_bar[3] += rate_bar[2] - w * (centrifugal_slope * x[3]);
        }
        if let Some(u_bar) = cotangents.u {
            u_bar[0] += w;
        }
    }

    fn velocity(&self, i: usize) -> Option<usize> {
        i.is_multiple_of(2).then_some(i + 1)
    }
}

//! A chain of poles, end to end, on a cart.

mod factor;

use crate::dynamics::ode::Ode;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::tasks::{CartPoleSystem, MassError};
use arrayvec::ArrayVec;
use factor::{factor, solve};

/// Rigid, uniform poles, the first on a joint on the cart, every other on the end of the one before.
///
/// State, control and parameters are those of [`CartPoleSystem`], and angles are from upright, each by itself:
/// `[x, ẋ, θ₁, ω₁, θ₂, ω₂, …]`, the lowest pole first. Its `dt` is not used: an [`Integrator`](crate::Integrator) makes the
/// steps. Lagrange's equations for n poles, each of mass m, half length l and inertia m l²/3 about its middle, with M the mass
/// of the cart and all poles:
///
/// ```text
/// M ẍ + Σ_k p_k cos θ_k α_k                        = u + Σ_k p_k sin θ_k ω_k²
/// p_j cos θ_j ẍ + Σ_k I_jk cos(θ_j - θ_k) α_k      = p_j g sin θ_j - Σ_k I_jk sin(θ_j - θ_k) ω_k²
/// p_k  = m l (1 + 2 (n - k)),   I_jj = m l² (4/3 + 4 (n - j)),   I_jk = m l² (2 + 4 (n - k)) for j < k
/// ```
///
/// The mass matrix is symmetric and positive definite, even where the cart has no mass, and is solved by Cholesky's method
/// in O(n³). The reverse solves with the same factors. With one pole these are the equations of
/// [`CoupledCartPole`](crate::tasks::CoupledCartPole).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PoleChain(pub CartPoleSystem);

/// The cart and all poles.
const MOST: usize = PoleChain::MOST_POLES + 1;
/// A number for each of them.
type Each<T> = ArrayVec<T, MOST>;
/// The lower triangle of a matrix, by rows.
type Triangle<T> = ArrayVec<T, { MOST * (MOST + 1) / 2 }>;

/// What the equations of motion are made of.
struct Motion<T> {
    sin: Each<T>,
    cos: Each<T>,
    /// Of the mass matrix.
    factors: Triangle<T>,
    /// `[ẍ, α₁, α₂, …]`.
    accelerations: Each<T>,
}

impl<T> Motion<T> {
    fn new() -> Self {
        Self { sin: Each::new(), cos: Each::new(), factors: Triangle::new(), accelerations: Each::new() }
    }
}

impl PoleChain {
    /// The most poles there can be: what a step works with is on the stack.
    pub const MOST_POLES: usize = 20;

    /// Whether its masses can be computed with, and its poles are not too many.
    ///
    /// # Errors
    /// [`MassError`].
    pub fn check(&self) -> Result<(), MassError> {
        self.0.check_up_to(Self::MOST_POLES)
    }

    /// Kinetic and potential energy of a state, J, 0 at rest with the cart's height for zero. Free of control, the equations
    /// keep it.
    pub fn energy(&self, x: &[f64]) -> f64 {
        let pole = |k: usize| (x[2 + 2 * k], x[3 + 2 * k]);
        let mut energy = 0.5 * self.mass() * x[1] * x[1];
        for k in 0..self.0.poles {
            let (theta, omega) = pole(k);
            energy += self.moment(k) * (self.0.gravity + x[1] * omega) * theta.cos();
            energy += 0.5 * self.inertia(k, k) * omega * omega;
            for j in 0..k {
                let (other_theta, other_omega) = pole(j);
                energy += self.inertia(j, k) * (theta - other_theta).cos() * omega * other_omega;
            }
        }
        energy
    }

    fn mass(&self) -> f64 {
        self.0.cart_mass + self.0.poles as f64 * self.0.pole_mass
    }

    /// p of pole `k`, counted from 0.
    #[inline(always)]
    fn moment(&self, k: usize) -> f64 {
        let above = (self.0.poles - 1 - k) as f64;
        self.0.pole_mass * self.0.half_length * (1.0 + 2.0 * above)
    }

    /// I of poles `j ≤ k`, counted from 0.
    #[inline(always)]
    fn inertia(&self, j: usize, k: usize) -> f64 {
        let above = (self.0.poles - 1 - k) as f64;
        let own = if j == k { 4.0 / 3.0 } else { 2.0 };
        self.0.pole_mass * self.0.half_length * self.0.half_length * (own + 4.0 * above)
    }

    /// Written where it is: a full array that is returned is a copy of all there is room for.
    #[inline(always)]
    fn move_on<T: Scalar>(&self, x: &[T], u: &[T], motion: &mut Motion<T>) {
        let Motion { sin, cos, factors, accelerations } = motion;
        accelerations.push(u[0]);
        factors.push(T::lift(self.mass()));
        for j in 0..self.0.poles {
            let (s, c) = x[2 + 2 * j].sin_cos();
            let spin = x[3 + 2 * j] * x[3 + 2 * j];
            let moment = T::lift(self.moment(j));
            accelerations[0] += moment * s * spin;
            factors.push(moment * c);
            let mut torque = moment * T::lift(self.0.gravity) * s;
            for k in 0..j {
                let inertia = T::lift(self.inertia(k, j));
                let throw = inertia * (s * cos[k] - c * sin[k]);
                factors.push(inertia * (c * cos[k] + s * sin[k]));
                torque -= throw * x[3 + 2 * k] * x[3 + 2 * k];
                accelerations[1 + k] += throw * spin;
            }
            factors.push(T::lift(self.inertia(j, j)));
            accelerations.push(torque);
            sin.push(s);
            cos.push(c);
        }
        factor(factors, 1 + self.0.poles);
        solve(factors, accelerations);
    }
}

impl Ode for PoleChain {
    fn state_dim(&self) -> usize {
        2 + 2 * self.0.poles
    }

    fn control_dim(&self) -> usize {
        1
    }

    #[inline(always)]
    fn rate<T: Scalar>(&self, x: &[T], u: &[T], rate: &mut [T]) {
        let mut motion = Motion::new();
        self.move_on(x, u, &mut motion);
        for i in 0..=self.0.poles {
            rate[2 * i] = x[2 * i + 1];
            rate[2 * i + 1] = motion.accelerations[i];
        }
    }

    /// Of `M a = f`: with `M w = ā`, f has the cotangent w, and M has -w aᵀ.
    #[inline(always)]
    fn rate_vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], rate_bar: &[C], x_bar: &mut [C], u_bar: Option<&mut [C]>) {
        let mut motion = Motion::new();
        self.move_on(x, u, &mut motion);
        let Motion { sin, cos, factors, accelerations: a } = &motion;
        let mut w = Each::<C>::new();
        for i in 0..=self.0.poles {
            x_bar[2 * i + 1] += rate_bar[2 * i];
            w.push(rate_bar[2 * i + 1]);
        }
        solve(factors, &mut w);
        let two = R::lift(2.0);
        for j in 0..self.0.poles {
            let (s, c, omega) = (sin[j], cos[j], x[3 + 2 * j]);
            let (spin, alpha) = (omega * omega, a[1 + j]);
            let moment = R::lift(self.moment(j));
            let mut theta_bar = w[0] * (moment * (c * spin + s * alpha));
            theta_bar += w[1 + j] * (moment * (R::lift(self.0.gravity) * c + s * a[0]));
            let mut spin_bar = w[0] * (moment * s);
            for k in 0..j {
                let inertia = R::lift(self.inertia(k, j));
                let (throw, along) = (inertia * (s * cos[k] - c * sin[k]), inertia * (c * cos[k] + s * sin[k]));
                let other_spin = x[3 + 2 * k] * x[3 + 2 * k];
                // Of the angle between the two: in the matrix and in the throw, of each on the other.
                let between = w[1 + j] * (throw * a[1 + k] - along * other_spin) + w[1 + k] * (throw * alpha + along * spin);
                theta_bar += between;
                x_bar[2 + 2 * k] -= between;
                spin_bar += w[1 + k] * throw;
                x_bar[3 + 2 * k] -= w[1 + j] * (throw * two * x[3 + 2 * k]);
            }
            x_bar[2 + 2 * j] += theta_bar;
            x_bar[3 + 2 * j] += spin_bar * (two * omega);
        }
        if let Some(u_bar) = u_bar {
            u_bar[0] += w[0];
        }
    }

    fn velocity(&self, i: usize) -> Option<usize> {
        i.is_multiple_of(2).then_some(i + 1)
    }
}

//! [`PoleChain`]: a chain of poles, end to end, on a cart.

pub(super) mod factor;

use crate::dynamics::inputs::{Cotangents, OdeInputs};
use crate::dynamics::ode::Ode;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::tasks::{CartPoleSystem, MassError};
use arrayvec::ArrayVec;
use factor::{factor, solve};

/// Chain of rigid, uniform poles: the first is hinged on the cart, every later pole on the free end
/// of the previous pole.
///
/// State, control and constants are those of [`CartPoleSystem`]. The state is
/// `[x, ẋ, θ₁, ω₁, θ₂, ω₂, …]`, the pole on the cart first. Each angle is measured from upright.
/// All numbers must be fixed ([`check`](PoleChain::check)), because the equations use nominal
/// values. The vector field does not use `dt`; [`Integrated`](crate::Integrated) has a time step.
///
/// The n poles have mass m, half length l and inertia m l²/3 about their middle. M is the mass of
/// the cart and all poles. Lagrange's equations are:
///
/// ```text
/// M ẍ + Σ_k p_k cos θ_k α_k                        = u + Σ_k p_k sin θ_k ω_k²
/// p_j cos θ_j ẍ + Σ_k I_jk cos(θ_j - θ_k) α_k      = p_j g sin θ_j - Σ_k I_jk sin(θ_j - θ_k) ω_k²
/// p_k  = m l (1 + 2 (n - k))
/// I_jj = m l² (4/3 + 4 (n - j)),   I_jk = I_kj = m l² (2 + 4 (n - k)) for j < k
/// ```
///
/// The mass matrix is symmetric and positive definite, even for a massless cart. Cholesky's method
/// solves the equations in O(n³). The reverse pass uses the same factors. With one pole, the
/// equations are those of [`CoupledCartPole`](crate::tasks::CoupledCartPole).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PoleChain(pub CartPoleSystem);

/// Largest number of bodies: the cart and all poles.
const MAX_BODIES: usize = PoleChain::MAX_POLES + 1;
/// One value per body.
type Each<T> = ArrayVec<T, MAX_BODIES>;
/// Lower triangle of a matrix, by rows.
type Triangle<T> = ArrayVec<T, { MAX_BODIES * (MAX_BODIES + 1) / 2 }>;

/// Terms of the equations of motion.
struct Motion<T> {
    /// Sine of each angle.
    sin: Each<T>,
    /// Cosine of each angle.
    cos: Each<T>,
    /// Factors of the mass matrix.
    factors: Triangle<T>,
    /// Accelerations `[ẍ, α₁, α₂, …]`.
    accelerations: Each<T>,
}

impl<T> Motion<T> {
    fn new() -> Self {
        Self {
            sin: Each::new(),
            cos: Each::new(),
            factors: Triangle::new(),
            accelerations: Each::new(),
        }
    }
}

impl PoleChain {
    /// Largest number of poles. Buffers of a step are on the stack.
    pub const MAX_POLES: usize = 20;

    /// Checks that the masses, the half length and the number of poles are valid, and that all
    /// numbers are fixed.
    ///
    /// # Errors
    /// Returns a [`MassError`] for the first number that is not fixed, otherwise for the first
    /// invalid parameter.
    pub fn check(&self) -> Result<(), MassError> {
        if let Some(number) = self.0.numbers().placed(0).into_iter().next() {
            return Err(MassError::Varies { number: number.name });
        }
        self.0.check_up_to(Self::MAX_POLES)
    }

    /// Returns kinetic plus potential energy of a state, in joules. The energy is 0 at rest with
    /// all poles horizontal. Without control, the equations conserve the energy.
    pub fn energy(&self, x: &[f64]) -> f64 {
        let pole = |k: usize| (x[2 + 2 * k], x[3 + 2 * k]);
        let mut energy = 0.5 * self.mass() * x[1] * x[1];
        for k in 0..self.0.poles {
            let (theta, omega) = pole(k);
            energy += self.moment(k) * (self.0.gravity.nominal() + x[1] * omega) * theta.cos();
            energy += 0.5 * self.inertia(k, k) * omega * omega;
            for j in 0..k {
                let (other_theta, other_omega) = pole(j);
                energy += self.inertia(j, k) * (theta - other_theta).cos() * omega * other_omega;
            }
        }
        energy
    }

    fn mass(&self) -> f64 {
        let [cart_mass, pole_mass, ..] = self.0.nominal();
        cart_mass + self.0.poles as f64 * pole_mass
    }

    /// Returns p of pole `k`, counted from 0, in kg m.
    #[inline(always)]
    fn moment(&self, k: usize) -> f64 {
        let above = (self.0.poles - 1 - k) as f64;
        let [_, pole_mass, half_length, _] = self.0.nominal();
        pole_mass * half_length * (1.0 + 2.0 * above)
    }

    /// Returns I of poles `j ≤ k`, counted from 0, in kg m².
    #[inline(always)]
    fn inertia(&self, j: usize, k: usize) -> f64 {
        let above = (self.0.poles - 1 - k) as f64;
        let own = if j == k { 4.0 / 3.0 } else { 2.0 };
        let [_, pole_mass, half_length, _] = self.0.nominal();
        pole_mass * half_length * half_length * (own + 4.0 * above)
    }

    /// Computes all terms in an empty `motion`. Returning a [`Motion`] would copy its whole
    /// capacity.
    #[inline(always)]
    fn solve_motion<T: Scalar>(&self, x: &[T], u: &[T], motion: &mut Motion<T>) {
        let Motion { sin, cos, factors, accelerations } = motion;
        accelerations.push(u[0]);
        factors.push(T::from(self.mass()));
        for j in 0..self.0.poles {
            let (s, c) = x[2 + 2 * j].sin_cos();
            let spin = x[3 + 2 * j] * x[3 + 2 * j];
            let moment = T::from(self.moment(j));
            accelerations[0] += moment * s * spin;
            factors.push(moment * c);
            let mut torque = moment * self.0.gravity.nominal() * s;
            for k in 0..j {
                let inertia = T::from(self.inertia(k, j));
                let throw = inertia * (s * cos[k] - c * sin[k]);
                factors.push(inertia * (c * cos[k] + s * sin[k]));
                torque -= throw * x[3 + 2 * k] * x[3 + 2 * k];
                accelerations[1 + k] += throw * spin;
            }
            factors.push(T::from(self.inertia(j, j)));
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
    fn rate<T: Scalar>(&self, OdeInputs { x, u, .. }: OdeInputs<'_, T>, rate: &mut [T]) {
        let mut motion = Motion::new();
        self.solve_motion(x, u, &mut motion);
        for i in 0..=self.0.poles {
            rate[2 * i] = x[2 * i + 1];
            rate[2 * i + 1] = motion.accelerations[i];
        }
    }

    /// Computes the reverse of `M a = f`: with `M w = ā`, the cotangent of f is w and that of M is
    /// -w aᵀ.
    #[inline(always)]
    fn rate_vjp<R: Real, C: Cotangent<R>>(
        &self,
        OdeInputs { x, u, .. }: OdeInputs<'_, R>,
        rate_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let mut motion = Motion::new();
        self.solve_motion(x, u, &mut motion);
        let Motion { sin, cos, factors, accelerations: a } = &motion;
        let mut w = Each::<C>::new();
        for i in 0..=self.0.poles {
            w.push(rate_bar[2 * i + 1]);
        }
        solve(factors, &mut w);
        if let Some(u_bar) = cotangents.u {
            u_bar[0] += w[0];
        }
        let Some(x_bar) = cotangents.x else { return };
        for i in 0..=self.0.poles {
            x_bar[2 * i + 1] += rate_bar[2 * i];
        }
        let two = R::from(2.0);
        for j in 0..self.0.poles {
            let (s, c, omega) = (sin[j], cos[j], x[3 + 2 * j]);
            let (spin, alpha) = (omega * omega, a[1 + j]);
            let moment = R::from(self.moment(j));
            let mut theta_bar = w[0] * (moment * (c * spin + s * alpha));
            theta_bar += w[1 + j] * (moment * (R::from(self.0.gravity.nominal()) * c + s * a[0]));
            let mut spin_bar = w[0] * (moment * s);
            for k in 0..j {
                let inertia = R::from(self.inertia(k, j));
                let (throw, along) =
                    (inertia * (s * cos[k] - c * sin[k]), inertia * (c * cos[k] + s * sin[k]));
                let other_spin = x[3 + 2 * k] * x[3 + 2 * k];
                // Cotangent of the angle between two poles, which enters the matrix and the
                // centrifugal torques.
                let between = w[1 + j] * (throw * a[1 + k] - along * other_spin)
                    + w[1 + k] * (throw * alpha + along * spin);
                theta_bar += between;
                x_bar[2 + 2 * k] -= between;
                spin_bar += w[1 + k] * throw;
                x_bar[3 + 2 * k] -= w[1 + j] * (throw * two * x[3 + 2 * k]);
            }
            x_bar[2 + 2 * j] += theta_bar;
            x_bar[3 + 2 * j] += spin_bar * (two * omega);
        }
    }

    fn velocity(&self, i: usize) -> Option<usize> {
        i.is_multiple_of(2).then_some(i + 1)
    }
}

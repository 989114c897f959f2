//! Quantum control: a linear potential brings a particle in a box into an eigenstate.
//!
//! The task is that of "Stabilizing Backpropagation Through Time to Learn Complex Physics" (ICLR
//! 2024). Units: ħ = 1 and m = 1/2, so the Hamiltonian is `-∂²/∂x² + V`. [`Quantum`] is the task,
//! [`QuantumSystem`] the system.

mod absorbing;
mod cubic;
mod elimination;
mod pade;
mod potential;
mod propagator;
mod renormalized;
mod scheme;
mod strang;
mod system;

pub use absorbing::{Absorbing, AbsorbingEdges};
pub use cubic::Cubic;
pub use pade::Pade;
pub use potential::{Barrier, DoubleWell, Harmonic, Tabulated};
pub use renormalized::Renormalized;
pub use scheme::QuantumScheme;
pub use strang::Strang;
pub use system::{ControlShape, QuantumSystem};

use super::LossMode;
use crate::dynamics::effect::{HasModel, any_effect};
use crate::dynamics::inputs::{Cotangents, Inputs, Start};
use crate::dynamics::task::Task;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Real, Scalar};
use crate::numbers::zip::zip;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;
use system::Pair;

any_effect! {
    /// Any quantum-control effect, chosen at run time.
    QuantumEffect of QuantumSystem: Harmonic, Barrier, DoubleWell, Tabulated, Cubic
}

/// Task to bring the particle into an eigenstate of the box, with the infidelity as loss.
///
/// The infidelity of a state ψ is `1 - |⟨φ, ψ⟩|²`, between 0 and 1. Here, φ is the target, and
/// `⟨φ, ψ⟩ = Σ_j φ_j ψ_j`. The control carries no cost.
///
/// Initial states mix the two lowest eigenstates, so the third is the lowest target outside their
/// span. All eigenstates are those of the box without potential, even with effects.
///
/// `S` is any system that contains a [`QuantumSystem`]. Examples: alone, with another scheme
/// ([`Pade`], [`Strang`]), with effects, with [`Absorbing`] edges, [`Renormalized`], or behind an
/// actuator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantum<S = QuantumSystem> {
    /// System to control.
    pub system: S,
    /// Number of the target eigenstate, from 1 (the ground state) to the number of grid points. The
    /// paper counts from 0.
    pub target: usize,
    /// States that enter the loss. [`LossMode::Terminal`]: infidelity of the last state.
    /// [`LossMode::Running`]: sum of the infidelity over all states after the initial one, between
    /// 0 and the horizon.
    pub loss: LossMode,
    /// Number of steps.
    pub horizon: usize,
    /// Weights of the first and the second eigenstate in the initial states; not both zero.
    pub weighting: [f64; 2],
}

impl Quantum {
    /// Creates the paper's task: 32 grid points, 128 steps of 0.0625, running loss, initial weights
    /// 1 : 1.
    ///
    /// # Panics
    /// If the target is not between 1 and the number of grid points.
    #[track_caller]
    pub fn new(target: usize) -> Self {
        Self::with_system(QuantumSystem::default(), target)
    }
}

impl<S: HasModel<QuantumSystem>> Quantum<S> {
    /// Creates the paper's task for another system: 128 steps, running loss, initial weights 1 : 1.
    ///
    /// # Panics
    /// If the grid has fewer than 3 points, or the target is not between 1 and their number.
    #[track_caller]
    pub fn with_system(system: S, target: usize) -> Self {
        let grid = system.model().grid;
        assert!(grid >= 3, "the grid has {grid} points; allowed: 3 or more");
        assert!(
            (1..=grid).contains(&target),
            "the target is eigenstate {target}; allowed: 1, the ground state, to {grid}"
        );
        Self { system, target, loss: LossMode::Running, horizon: 128, weighting: [1.0, 1.0] }
    }

    /// Returns the overlap `⟨φ, ψ⟩` with the target.
    #[inline(always)]
    fn overlap<T: Scalar>(&self, x: &[T]) -> Pair<T> {
        let (mut re, mut im) = (T::zero(), T::zero());
        for (x, target) in zip(x.chunks_exact(2), self.system.model().eigenstate(self.target)) {
            let target = T::from(target);
            re += x[0] * target;
            im += x[1] * target;
        }
        (re, im)
    }

    #[inline(always)]
    fn infidelity<T: Scalar>(&self, x: &[T]) -> T {
        let (re, im) = self.overlap(x);
        T::one() - (re * re + im * im)
    }

    /// Adds the gradient of the infidelity, `-2 ⟨φ, ψ⟩ φ`.
    #[inline(always)]
    fn infidelity_gradient<R: Real>(&self, x: &[R], x_bar: &mut [R]) {
        let (re, im) = self.overlap(x);
        let (re, im) = (re * R::from(-2.0), im * R::from(-2.0));
        for (x_bar, target) in
            zip(x_bar.chunks_exact_mut(2), self.system.model().eigenstate(self.target))
        {
            let target = R::from(target);
            x_bar[0] += re * target;
            x_bar[1] += im * target;
        }
    }
}

impl<S: HasModel<QuantumSystem>> Task for Quantum<S> {
    type System = S;

    fn system(&self) -> &S {
        &self.system
    }

    fn horizon(&self) -> usize {
        self.horizon
    }

    /// ±20, in units of the control.
    fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        Some(vec![[-20.0, 20.0]; self.system.control_dim()])
    }

    /// Draws `(c₁ e^{ip₁} φ₁ + c₂ e^{ip₂} φ₂) / sqrt(c₁² + c₂²)`. The amplitudes c are standard
    /// normal, times the weights. The phases p are uniform.
    ///
    /// # Panics
    /// If both weights are zero, one is non-finite, or they are so large or small that the state
    /// cannot be normalized.
    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        let amplitudes = self.weighting.map(|weight| {
            let draw: f64 = StandardNormal.sample(rng);
            weight * draw
        });
        let norm = amplitudes[0].hypot(amplitudes[1]);
        assert!(
            norm.is_normal(),
            "with the weighting {:?}, an initial state cannot be normalized; use finite weights of moderate size, not both 0",
            self.weighting
        );
        for (number, amplitude) in zip(1.., amplitudes) {
            let (sin, cos) = Scalar::sin_cos(rng.random_range(0.0..TAU));
            for (x, eigenstate) in
                zip(start.x.chunks_exact_mut(2), self.system.model().eigenstate(number))
            {
                x[0] += amplitude / norm * cos * eigenstate;
                x[1] += amplitude / norm * sin * eigenstate;
            }
        }
        self.system.start_extra(rng, start);
    }

    #[inline(always)]
    fn running_cost<T: Scalar>(&self, _inputs: Inputs<'_, T>, next: &[T]) -> T {
        match self.loss {
            LossMode::Terminal => T::zero(),
            LossMode::Running => self.infidelity(next),
        }
    }

    #[inline(always)]
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        match self.loss {
            LossMode::Terminal => self.infidelity(x),
            LossMode::Running => T::zero(),
        }
    }

    #[inline(always)]
    fn running_cost_gradient<R: Real>(
        &self,
        _inputs: Inputs<'_, R>,
        next: &[R],
        _bars: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        if self.loss == LossMode::Running {
            self.infidelity_gradient(next, next_bar);
        }
    }

    #[inline(always)]
    fn terminal_cost_gradient<R: Real>(
        &self,
        x: &[R],
        _p: &[R],
        x_bar: &mut [R],
        _p_bar: Option<&mut [R]>,
    ) {
        if self.loss == LossMode::Terminal {
            self.infidelity_gradient(x, x_bar);
        }
    }
}

//! [`Lqr`]: the linear-quadratic regulator.

use super::{LinearPlant, NoOptimum, Optimum, dot};
use crate::dynamics::inputs::{Cotangents, Inputs, Start};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Real, Scalar};
use crate::numbers::zip::zip;
use crate::tasks::CartPoleSystem;
use rand::RngExt;

/// Task to hold a linear plant at 0 with a quadratic cost:
///
/// ```text
/// l(x_{t+1}, u_t) = (x_{t+1}ᵀ Q x_{t+1} + u_tᵀ R u_t)/2,    φ(x_T) = x_Tᵀ P x_T / 2
/// ```
///
/// P is the cost-to-go matrix of the infinite horizon. A single gain, [`Optimum::gain`], is
/// therefore optimal at any horizon and from any initial state, and the minimal loss is known.
///
/// This gain is a fixed point of the flows R and M and of their combination C. With
/// `λ_{t+1} = (Q + P) x_{t+1}`, the control's cotangent `h_t = Bᵀ λ_{t+1} + R u_t`, with the cost
/// matrix R, is 0 at each step. The path through the policy therefore contributes 0, and both flows
/// have equal adjoints.
#[derive(Clone, Debug, PartialEq)]
pub struct Lqr {
    plant: LinearPlant,
    state_cost: Vec<f64>,
    control_cost: Vec<f64>,
    optimum: Optimum,
    /// Center of the initial states.
    pub start: Vec<f64>,
    /// Largest deviation of each component of the initial state from the center. 0 gives a single
    /// initial state.
    pub spread: f64,
    /// Number of steps.
    pub horizon: usize,
}

impl Lqr {
    /// Creates the task with the row-major costs Q and R. Rollouts have 100 steps and start within
    /// ±1 in each component.
    ///
    /// # Errors
    /// Returns [`NoOptimum`] if R is not positive definite, or if the iteration finds no solution
    /// of Riccati's equation.
    ///
    /// # Panics
    /// If Q or R is not symmetric or has a non-finite entry, Q is not `state_dim × state_dim`, or R
    /// is not `control_dim × control_dim`.
    #[track_caller]
    pub fn new(
        plant: LinearPlant,
        state_cost: Vec<f64>,
        control_cost: Vec<f64>,
    ) -> Result<Self, NoOptimum> {
        let (n, m) = (plant.state_dim(), plant.control_dim());
        for (name, cost, n) in [("Q", &state_cost, n), ("R", &control_cost, m)] {
            assert_eq!(cost.len(), n * n, "{name} for {n} components needs {} entries", n * n);
            assert!(
                cost.iter().all(|entry| entry.is_finite()),
                "{name} has an entry that is not finite"
            );
            let symmetric = (0..n).all(|i| (0..i).all(|j| cost[i * n + j] == cost[j * n + i]));
            assert!(
                symmetric,
                "{name} is not symmetric; use ({name} + {name}ᵀ)/2, which has the same cost"
            );
        }
        let optimum = Optimum::of(&plant, &state_cost, &control_cost)?;
        Ok(Self {
            start: vec![0.0; n],
            spread: 1.0,
            horizon: 100,
            plant,
            state_cost,
            control_cost,
            optimum,
        })
    }

    /// Creates a task with a stable plant, in semi-implicit steps of 0.1 s. The plant is a mass of
    /// 1 kg on a spring of 1 N/m, with a damper of 0.4 N s/m. The running cost per second is
    /// `(|x|² + u²)/2`.
    pub fn spring() -> Self {
        let (dt, stiffness, damping) = (0.1, 1.0, 0.4);
        let (by_place, by_speed) = (-dt * stiffness, 1.0 - dt * damping);
        let a = vec![1.0 + dt * by_place, dt * by_speed, by_place, by_speed];
        Self::per_second(LinearPlant::new(2, a, vec![dt * dt, dt]), dt)
    }

    /// Creates a task with an unstable plant. The plant is the default [`CartPoleSystem`] with one
    /// pole, linearized about the upright position. The running cost per second is `(|x|² + u²)/2`,
    /// in SI units. Without control, the state grows by a factor of 1.04 per step, 1e17 in 1000
    /// steps.
    pub fn upright_cart_pole() -> Self {
        let system = CartPoleSystem::default();
        Self::per_second(
            LinearPlant::linearized(&system, Inputs::new(&[0.0; 4], &[0.0])),
            system.dt,
        )
    }

    /// Creates a task with unit costs per second.
    fn per_second(plant: LinearPlant, dt: f64) -> Self {
        let diagonal = |n: usize| {
            (0..n * n).map(|i| if i.is_multiple_of(n + 1) { dt } else { 0.0 }).collect::<Vec<f64>>()
        };
        let (q, r) = (diagonal(plant.state_dim()), diagonal(plant.control_dim()));
        Self::new(plant, q, r).expect("both plants can be held at 0 by their control")
    }

    /// Returns the optimal gain and its cost.
    pub fn optimum(&self) -> &Optimum {
        &self.optimum
    }

    /// Returns the minimal loss of a batch from `starts`, with `state_dim` components per sample:
    /// the mean of `xᵀ P x / 2`.
    ///
    /// # Panics
    /// If `starts` is empty or not a whole number of samples.
    #[track_caller]
    pub fn least_loss(&self, starts: &[f64]) -> f64 {
        let (found, n) = (starts.len(), self.plant.state_dim());
        assert!(
            found > 0 && found.is_multiple_of(n),
            "`starts` has {found} numbers; expected one or more samples of {n}"
        );
        let samples = starts.chunks_exact(self.plant.state_dim());
        let count = samples.len() as f64;
        samples.map(|x| self.terminal_cost(x, &[])).sum::<f64>() / count
    }
}

/// Returns `xᵀ M x / 2`.
#[inline(always)]
fn quadratic<T: Scalar>(matrix: &[f64], x: &[T]) -> T {
    let mut sum = T::zero();
    for (row, &x_i) in zip(matrix.chunks_exact(x.len()), x) {
        sum += dot(row, x) * x_i;
    }
    sum * 0.5
}

/// Adds the gradient `M x` of [`quadratic`], for symmetric M.
#[inline(always)]
fn quadratic_gradient<R: Real>(matrix: &[f64], x: &[R], x_bar: &mut [R]) {
    for (row, x_bar) in zip(matrix.chunks_exact(x.len()), x_bar) {
        *x_bar += dot(row, x);
    }
}

impl Task for Lqr {
    type System = LinearPlant;

    fn system(&self) -> &LinearPlant {
        &self.plant
    }

    fn horizon(&self) -> usize {
        self.horizon
    }

    /// ±50, in units of the control.
    fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        Some(vec![[-50.0, 50.0]; self.plant.control_dim()])
    }

    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        let (found, expected) = (self.start.len(), start.x.len());
        assert_eq!(
            found, expected,
            "`Lqr::start` has {found} components, but the plant has {expected}"
        );
        for (x, &center) in zip(start.x.iter_mut(), &self.start) {
            *x = center + self.spread * rng.random_range(-1.0..1.0);
        }
    }

    #[inline(always)]
    fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, next: &[T]) -> T {
        quadratic(&self.state_cost, next) + quadratic(&self.control_cost, u)
    }

    #[inline(always)]
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        quadratic(&self.optimum.cost_to_go, x)
    }

    #[inline(always)]
    fn running_cost_gradient<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        next: &[R],
        cotangents: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        quadratic_gradient(&self.state_cost, next, next_bar);
        if let Some(u_bar) = cotangents.u {
            quadratic_gradient(&self.control_cost, inputs.u, u_bar);
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
        quadratic_gradient(&self.optimum.cost_to_go, x, x_bar);
    }
}

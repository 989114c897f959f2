//! The toy examples of "Stabilizing Backpropagation Through Time to Learn Complex Physics" (ICLR 2024), in numbers:
//! vector fields over the plane of two parameters, and the paths that Adam takes in them.
//!
//! - Figure 1 samples R and M of [`Reach`](crate::tasks::Reach) with the policy [`Quadratic`](crate::policy::Quadratic).
//! - Figure 2 lets Adam follow three fields with one minimum, that of [`Bowl`](crate::tasks::Bowl) with the policy
//!   [`Constant`](crate::policy::Constant): its gradient, the gradient with a rotation, and of the latter the components that
//!   agree with the gradient in sign ([`Rotated`]).
//!
//! Nothing here is derived by hand: the tasks are tasks like any other, and every vector comes from their rollouts.

use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::engine::adjoint::Flow;
use crate::engine::batch::Batch;
use crate::engine::divergence::Divergence;
use crate::engine::gradient::Gradient;
use crate::numbers::rng::{Purpose, stream};
use crate::numbers::scalar::Float;
use crate::policy::{Policy, Weights};
use crate::train::field::{Compose, Field, SignAgreement};
use crate::train::optim::Optimizer;

/// A vector field at one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// The two parameters.
    pub theta: [f64; 2],
    /// The loss there.
    pub loss: f64,
    /// The vector that an optimizer would go against.
    pub vector: [f64; 2],
}

impl Sample {
    /// The length of the vector.
    pub fn norm(&self) -> f64 {
        self.vector[0].hypot(self.vector[1])
    }
}

/// The middles of `cells` × `cells` equal squares over `[-reach, reach]²`, row by row: θ₁ runs first.
pub fn grid(reach: f64, cells: usize) -> Vec<[f64; 2]> {
    let middle = |i: usize| reach * ((2 * i + 1) as f64 / cells as f64 - 1.0);
    (0..cells * cells).map(|i| [middle(i % cells), middle(i / cells)]).collect()
}

/// The field of a task with one start state at each of the given parameters.
///
/// # Errors
/// The first [`Divergence`].
///
/// # Panics
/// If the policy has not two parameters, or does not fit the task.
#[track_caller]
pub fn sample<T: Task, P: Policy, C: Compose>(
    task: &T,
    policy: &P,
    field: &Field<C>,
    thetas: &[[f64; 2]],
) -> Result<Vec<Sample>, Divergence> {
    let mut sampler = Sampler::new(task, policy, field);
    thetas.iter().map(|&theta| sampler.at(theta)).collect()
}

/// The path of Adam along a field: the start and where each iteration leads, `iterations + 1` samples.
///
/// # Errors
/// The first [`Divergence`].
///
/// # Panics
/// If the policy has not two parameters, or does not fit the task.
#[track_caller]
pub fn descend<T: Task, P: Policy, C: Compose>(
    task: &T,
    policy: &P,
    field: &Field<C>,
    start: [f64; 2],
    learning_rate: f64,
    iterations: usize,
) -> Result<Vec<Sample>, Divergence> {
    let mut sampler = Sampler::new(task, policy, field);
    let mut optimizer = Optimizer::adam(learning_rate, 2);
    let mut path = vec![sampler.at(start)?];
    for i in 0..iterations {
        let Sample { mut theta, vector, .. } = path[i];
        optimizer.step(&mut theta, &vector);
        path.push(sampler.at(theta)?);
    }
    Ok(path)
}

/// One rollout, run again for every parameter.
struct Sampler<'a, T: Task, P, C> {
    task: &'a T,
    policy: &'a P,
    field: &'a Field<C>,
    start: Vec<f64>,
    weights: Weights<f64>,
    batch: Batch<f64>,
    vector: Gradient<f64>,
}

impl<'a, T: Task, P: Policy, C: Compose> Sampler<'a, T, P, C> {
    #[track_caller]
    fn new(task: &'a T, policy: &'a P, field: &'a Field<C>) -> Self {
        assert_eq!(
            policy.param_count(),
            2,
            "a field in the plane needs a policy of two parameters, not {}",
            policy.param_count()
        );
        let mut start = vec![0.0; task.system().state_dim()];
        task.start(&mut stream(0, Purpose::Train, 0), &mut start);
        let weights = Weights::new(policy, vec![0.0; 2]);
        let batch = Batch::new(task, policy, 1, &field.flows(), 1);
        Self { task, policy, field, start, weights, batch, vector: Gradient::zeros(2) }
    }

    fn at(&mut self, theta: [f64; 2]) -> Result<Sample, Divergence> {
        self.weights.update(self.policy, |weights| weights.copy_from_slice(&theta));
        let loss = self.batch.run(self.task, self.policy, &self.weights, &self.start)?;
        self.field.compose(self.batch.gradients(), &mut self.vector);
        let vector = self.vector.plain();
        Ok(Sample { theta, loss, vector: [vector[0], vector[1]] })
    }
}

/// Where figure 2 starts.
pub const START: [f64; 2] = [-1.5, 1.5];
/// Adam's learning rate in figure 2.
pub const LEARNING_RATE: f64 = 0.01;
/// The share of the rotation in figure 2.
pub const ROTATION: f64 = 4.0;

/// A gradient `g` and its rotation: `g + strength · (-g₂, g₁)`. It vanishes where the gradient does, but it is no
/// gradient: it also leads around the minimum.
///
/// Plain descent in small steps still arrives, for `g` always has its share. Adam does not: near the minimum it divides
/// by ever smaller root mean squares and so lengthens its steps, until its momentum, with a memory of β₁ / (1 - β₁) = 9
/// iterations, carries it past the turn as fast as `g` pulls it in. That is where the learning rate over the root mean square
/// is `1 / (9 · strength² · curvature)`; without a rotation it may grow to `38 / curvature`. So it keeps going around at a
/// distance of about `√2 · 9 · learning rate · strength`, if the curvature is the same in all directions and the strength
/// well above 1.
///
/// The combination leads down everywhere. It arrives from most starts, not from all: with the constants of figure 2 from
/// 12 of 16 on a circle, while the others stop at losses of 0.02 to 0.2 and the rotation alone at 2 to 7. With ten times
/// the learning rate it seldom arrives, but always comes at least ten times as low as the rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotated {
    /// Length of the rotated part, as a multiple of the gradient's.
    pub strength: f64,
    /// Only the components that agree with the gradient in sign are kept, as the paper's C does with M and R.
    pub combined: bool,
}

impl Rotated {
    /// The gradient with a rotation, as a field.
    pub fn field(strength: f64) -> Field<Self> {
        Field::composed(Flow::REGULAR, Flow::REGULAR, Self { strength, combined: false })
    }

    /// The same, where it agrees with the gradient.
    pub fn combined_field(strength: f64) -> Field<Self> {
        Field::composed(Flow::REGULAR, Flow::REGULAR, Self { strength, combined: true })
    }

    /// The three fields of figure 2, with the names of its panels.
    pub fn figure() -> [(&'static str, Field<Self>); 3] {
        [
            ("gradient", Field::Flow(Flow::REGULAR)),
            ("gradient + rotation", Self::field(ROTATION)),
            ("combined", Self::combined_field(ROTATION)),
        ]
    }
}

impl Compose for Rotated {
    fn name(&self) -> &str {
        if self.combined { "rotated, combined" } else { "rotated" }
    }

    /// Of two components; rotates the first vector, and compares with the second.
    fn compose<F: Float>(&self, first: &[F], second: &[F], out: &mut [F]) {
        let strength = F::lift(self.strength);
        let rotated = [first[0] - strength * first[1], first[1] + strength * first[0]];
        if self.combined {
            SignAgreement.compose(&rotated, second, out);
        } else {
            out.copy_from_slice(&rotated);
        }
    }
}

//! Two-parameter examples of "Stabilizing Backpropagation Through Time to Learn Complex Physics"
//! (ICLR 2024): vector fields, and the paths of Adam in them.
//!
//! - Figure 1 samples R and M of [`Reach`](crate::tasks::Reach) with the policy
//!   [`Quadratic`](crate::policy::Quadratic).
//! - Figure 2 runs Adam in three fields with the same minimum, with the task
//!   [`Bowl`](crate::tasks::Bowl) and the policy [`Constant`](crate::policy::Constant). The fields
//!   are the gradient, the gradient plus a rotation ([`Rotated`]), and their combination. The
//!   combination zeroes components of the rotated field whose sign differs from the gradient's.
//!
//! All vectors come from rollouts of these tasks; no derivative is coded separately.

use crate::dynamics::task::Task;
use crate::engine::batch::Batch;
use crate::engine::divergence::Divergence;
use crate::engine::flow::Flow;
use crate::engine::gradient::Gradient;
use crate::engine::initial_states::initial_states;
use crate::numbers::rng::Purpose;
use crate::numbers::scalar::Float;
use crate::policy::{Policy, Weights};
use crate::train::combination::Combination;
use crate::train::field::{Field, GradientCombiner};
use crate::train::optim::Optimizer;

/// Vector field at one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Parameters.
    pub theta: [f64; 2],
    /// Loss.
    pub loss: f64,
    /// Vector that an optimizer descends along.
    pub vector: [f64; 2],
}

impl Sample {
    /// Norm of the vector.
    pub fn norm(&self) -> f64 {
        self.vector[0].hypot(self.vector[1])
    }
}

/// Centers of `cells` × `cells` equal squares over `[-reach, reach]²`, row by row: θ₁ varies
/// fastest.
pub fn grid(reach: f64, cells: usize) -> Vec<[f64; 2]> {
    let middle = |i: usize| reach * ((2 * i + 1) as f64 / cells as f64 - 1.0);
    (0..cells * cells).map(|i| [middle(i % cells), middle(i / cells)]).collect()
}

/// Samples the field of a task at the given parameters. All rollouts start from one initial state,
/// training sample 0 of seed 0.
///
/// # Errors
/// The first [`Divergence`].
///
/// # Panics
/// If the policy does not have two parameters or does not fit the task, or if the horizon is 0.
#[track_caller]
pub fn sample<T: Task, P: Policy, C: GradientCombiner>(
    task: &T,
    policy: &P,
    field: &Field<C>,
    thetas: &[[f64; 2]],
) -> Result<Vec<Sample>, Divergence> {
    let mut sampler = Sampler::new(task, policy, field);
    thetas.iter().map(|&theta| sampler.at(theta)).collect()
}

/// Runs Adam along a field and returns the path: `start` and every iterate, `iterations + 1`
/// samples.
///
/// # Errors
/// The first [`Divergence`].
///
/// # Panics
/// If the policy does not have two parameters or does not fit the task, or if the horizon is 0.
#[track_caller]
pub fn descend<T: Task, P: Policy, C: GradientCombiner>(
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
        optimizer.step_along(learning_rate, &mut theta, &vector);
        path.push(sampler.at(theta)?);
    }
    Ok(path)
}

/// Workspace that evaluates the field, reused for all parameters.
struct Sampler<'a, T: Task, P, C> {
    task: &'a T,
    policy: &'a P,
    field: &'a Field<C>,
    start: Vec<f64>,
    weights: Weights<f64>,
    batch: Batch<f64>,
    vector: Gradient<f64>,
}

impl<'a, T: Task, P: Policy, C: GradientCombiner> Sampler<'a, T, P, C> {
    #[track_caller]
    fn new(task: &'a T, policy: &'a P, field: &'a Field<C>) -> Self {
        assert_eq!(
            policy.param_count(),
            2,
            "a field in the plane needs a policy with two parameters, not {}",
            policy.param_count()
        );
        let start = initial_states(task, 0, Purpose::Train, 1);
        let weights = Weights::new(policy, vec![0.0; 2]);
        let batch = Batch::new(task, policy, 1, &field.flows(), 1);
        Self { task, policy, field, start, weights, batch, vector: Gradient::zeros(2) }
    }

    fn at(&mut self, theta: [f64; 2]) -> Result<Sample, Divergence> {
        self.weights.update(self.policy, |weights| weights.copy_from_slice(&theta));
        let loss = self.batch.run(self.task, self.policy, &self.weights, &self.start)?;
        self.field.combine(self.batch.gradients(), &mut self.vector);
        let vector = self.vector.to_vec();
        Ok(Sample { theta, loss, vector: [vector[0], vector[1]] })
    }
}

/// Initial parameters of figure 2.
pub const START: [f64; 2] = [-1.5, 1.5];
/// Adam's learning rate in figure 2.
pub const LEARNING_RATE: f64 = 0.01;
/// Strength of the rotation in figure 2.
pub const ROTATION: f64 = 4.0;

/// Gradient `g` plus its rotation: `g + strength · (-g₂, g₁)`.
///
/// The field vanishes where the gradient vanishes. The rotation circulates around the minimum, so
/// the field is not a gradient.
///
/// Gradient descent with small steps converges, because every step has the component `-g`, and the
/// rotation is orthogonal to `g`. Adam does not converge if the rotation is strong. Near the
/// minimum, Adam divides by ever smaller root mean squares, so steps grow relative to the field.
/// The momentum delays the field by β₁ / (1 - β₁) = 9 iterations. The delayed rotation moves the
/// iterate outwards, and `-g` moves it inwards.
///
/// Let η be the learning rate over the root mean square. The two motions balance at
/// `η = 1 / (9 · strength² · curvature)`. Without a rotation, Adam is stable up to
/// `η = 38 / curvature`. The iterate circles the minimum at a distance of about
/// `√2 · 9 · learning rate · strength`. The estimate assumes an isotropic curvature and a strength
/// well above 1.
///
/// The combination descends everywhere. Adam converges along it from most, but not all, initial
/// parameters, and rarely with a large learning rate. The final loss is far below the final loss of
/// the field with the rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotated {
    /// Norm of the rotated part, as a multiple of the norm of the gradient.
    pub strength: f64,
    /// Zeroes the components whose sign differs from the gradient's. The field C of the paper
    /// combines M and R in this way.
    pub combined: bool,
}

impl Rotated {
    /// Gradient with a rotation.
    pub fn field(strength: f64) -> Field<Self> {
        Field::custom(Flow::REGULAR, Flow::REGULAR, Self { strength, combined: false })
    }

    /// Gradient with a rotation; components whose sign differs from the gradient's are 0.
    pub fn combined_field(strength: f64) -> Field<Self> {
        Field::custom(Flow::REGULAR, Flow::REGULAR, Self { strength, combined: true })
    }

    /// Fields of figure 2, with the titles of its panels.
    pub fn figure() -> [(&'static str, Field<Self>); 3] {
        [
            ("gradient", Field::Flow(Flow::REGULAR)),
            ("gradient + rotation", Self::field(ROTATION)),
            ("combined", Self::combined_field(ROTATION)),
        ]
    }
}

impl GradientCombiner for Rotated {
    fn name(&self) -> &str {
        if self.combined { "rotated, combined" } else { "rotated" }
    }

    /// Adds to `first` its rotation. If combined, then zeroes the components whose sign differs
    /// from that in `second`. Requires two components.
    fn combine<F: Float>(&self, first: &[F], second: &[F], out: &mut [F]) {
        assert_eq!(first.len(), 2, "`Rotated` needs a policy with two parameters");
        let strength = F::from_f64(self.strength);
        let rotated = [first[0] - strength * first[1], first[1] + strength * first[0]];
        if self.combined {
            Combination::SignAgreement.combine(&rotated, second, out);
        } else {
            out.copy_from_slice(&rotated);
        }
    }
}

//! Check of the batched passes of a policy. A column is one sample at one step.

use super::{
    CASES_OF_LONG_CHECKS, Comparison, Failure, Mismatch, ONE_STEP, Passed, normal, oracle,
};
use crate::numbers::rng::{Purpose, Rng, stream};
use crate::policy::{Policy, PolicyColumns, PolicyPass, PolicyRecord, Tensor, act_on};

/// Largest number of parameters for which the check compares every component.
const FEW: usize = 1000;
/// Largest number of components compared per tensor of a larger policy.
const OF_EACH: usize = 64;
/// Number of samples per random case.
const SAMPLES: usize = 3;
/// Number of steps per sample.
const STEPS: usize = 3;
/// Number of columns per random case.
const COLUMNS: usize = SAMPLES * STEPS;

/// Checks the batched passes of a policy against [`Policy::act`] and its dual-number derivatives.
///
/// The check requires that `act` writes every component. It compares the outputs of the forward
/// pass with `act`, and the input cotangents of the backward pass with dual numbers. In every
/// second random case, it repeats the backward pass without input cotangents. It then compares the
/// parameter gradient `g`, with and without weights of the columns, with dual numbers in two ways:
///
/// - By component: all components of at most 1000 parameters, otherwise up to 64 random ones of
///   each tensor in [`Policy::tensors`].
/// - By random directions `v` over all parameters: `⟨g, v⟩` against the derivative of `act` along
///   v.
///
/// Every `|vᵢ|` is between 1/2 and 3/2, so a direction detects any single wrong component above the
/// tolerance below. If a direction fails, the check compares all components to locate the error.
/// The check also requires that [`param_gradient`](Policy::param_gradient) adds to its output.
///
/// The tolerance of a direction is `1e-12 Σ |gᵢ vᵢ|`. A sum of n terms, each rounded to
/// `ε = 1.1e-16`, has an error of about `√n ε Σ |gᵢ vᵢ|`. Cancellation within the `gᵢ`, which are
/// sums over columns and positions, increases the error about tenfold. A component with error d is
/// detected if `d > 2e-12 Σ |gᵢ vᵢ|`. This bound is at most `3e-12 n` times the largest component.
///
/// # Errors
/// Returns the first [`Mismatch`].
#[inline(never)]
pub fn policy<P: Policy>(policy: &P) -> Result<Passed, Failure> {
    check(policy, &|theta, x, c, u| act_on(policy, theta, x, c % STEPS, u), &|theta, x, c, u| {
        act_on(policy, theta, x, c % STEPS, u)
    })
    .map_err(Failure::of_policy)
}

/// Policy in double precision: θ, the inputs x, the index of the column, and the outputs u.
type Act<'a> = &'a dyn Fn(&[f64], &[f64], usize, &mut [f64]);

/// Indices of parameters, each with the slopes of the outputs per column.
type Components = Vec<(usize, Vec<f64>)>;

/// Object-safe part of [`policy`]; limits monomorphization.
fn check(
    policy: &dyn crate::policy::AnyPolicy<f64>,
    act: Act,
    by_duals: oracle::Act,
) -> Result<Passed, Mismatch> {
    let (n, m, params) = (policy.input_dim(), policy.output_dim(), policy.param_count());
    let mut c = Comparison::new(ONE_STEP);
    for case in 0..CASES_OF_LONG_CHECKS {
        c.case = case;
        let mut rng = stream(case, Purpose::Check, 0);
        let weights = oracle::weights(policy, None, 0.1, &mut rng);
        let [x, u_bar, weight] = [n, m, 1].map(|len| normal(&mut rng, COLUMNS * len));
        let (tape, u) = forward(policy, weights.packed(), &x);
        let [expected, from_nans] =
            [0.0, f64::NAN].map(|initial| outputs(act, (n, m), weights.theta(), &x, initial));
        c.equal("act leaves a component unwritten: (control, memory)", &from_nans, &expected)?;
        c.slices("forward: u", &u, &expected)?;

        // One backward pass covers all steps, as in a rollout.
        let all = PolicyPass::new(weights.packed(), PolicyColumns::range(0..COLUMNS), &x)
            .at_steps(0..STEPS);
        let (mut tape_bar, x_bar) = backward(policy, all, &tape, &u_bar);
        let expected = oracle::policy_input_gradient(by_duals, (n, m), weights.theta(), &x, &u_bar);
        c.slices("backward: x_bar", &x_bar, &expected)?;
        // Rollouts reuse `tape_bar`, so the backward pass must not read the old values. Flows
        // without a path through the inputs request no `x_bar`.
        if case % 2 == 1 {
            tape_bar.fill(f64::NAN);
            policy.backward(all, &tape, &u_bar, &mut tape_bar, None);
        }

        let components = |indices: &[usize]| {
            oracle::policy_components(by_duals, (n, m), weights.theta(), &x, &u_bar, indices)
        };
        let some = components(&some_parameters(&policy.tensors(), &mut rng));
        let directions =
            oracle::policy_directions(by_duals, (n, m), weights.theta(), &x, &u_bar, &mut rng);
        let mut scratch = vec![0.0; policy.sizes(COLUMNS).scratch];
        for weight in [None, Some(&weight[..])] {
            let mut add = |theta_bar: &mut [f64]| {
                let (tape, u_bar, tape_bar) = (&tape[..], &u_bar[..], &tape_bar[..]);
                let record = PolicyRecord { tape, u_bar, tape_bar, weight };
                policy.param_gradient(all, record, &mut scratch, theta_bar);
            };
            let mut theta_bar = vec![0.0; params];
            add(&mut theta_bar);
            c.components(&theta_bar, &some, weight)?;
            c.directions(&theta_bar, &directions, weight, &components)?;
            let once = theta_bar.clone();
            add(&mut theta_bar);
            theta_bar.iter_mut().for_each(|bar| *bar *= 0.5);
            c.slices("param_gradient, second call that adds: theta_bar", &theta_bar, &once)?;
        }
    }
    Ok(c.passed)
}

/// Tape and outputs of the forward passes. Each pass covers one step of all samples.
fn forward(
    policy: &dyn crate::policy::AnyPolicy<f64>,
    packed: &[f64],
    x: &[f64],
) -> (Vec<f64>, Vec<f64>) {
    let mut tape = vec![0.0; policy.sizes(COLUMNS).tape];
    let mut u = vec![f64::NAN; COLUMNS * policy.output_dim()];
    for t in 0..STEPS {
        let at = PolicyColumns { first: t, step: STEPS, count: SAMPLES };
        policy.forward(PolicyPass::new(packed, at, x).at_steps(t..t + 1), &mut tape, &mut u);
    }
    (tape, u)
}

/// Cotangents of the tape and of the inputs, from one backward pass.
fn backward(
    policy: &dyn crate::policy::AnyPolicy<f64>,
    pass: PolicyPass<f64>,
    tape: &[f64],
    u_bar: &[f64],
) -> (Vec<f64>, Vec<f64>) {
    let mut tape_bar = vec![0.0; policy.sizes(COLUMNS).tape_bar];
    let mut x_bar = vec![f64::NAN; pass.x.len()];
    policy.backward(pass, tape, u_bar, &mut tape_bar, Some(&mut x_bar));
    (tape_bar, x_bar)
}

/// Outputs of `act` in all columns. `initial` is their value before `act` writes them.
fn outputs(act: Act, (n, m): (usize, usize), theta: &[f64], x: &[f64], initial: f64) -> Vec<f64> {
    let mut u = vec![initial; COLUMNS * m];
    for c in 0..COLUMNS {
        act(theta, &x[c * n..][..n], c, &mut u[c * m..][..m]);
    }
    u
}

/// Selects parameter indices: all of at most [`FEW`], otherwise up to [`OF_EACH`] per tensor.
fn some_parameters(tensors: &[Tensor], rng: &mut Rng) -> Vec<usize> {
    let all = tensors.iter().map(|tensor| tensor.range.end).max().unwrap_or(0);
    if all <= FEW {
        return (0..all).collect();
    }
    let mut indices = Vec::new();
    for Tensor { range, .. } in tensors {
        indices.extend(
            rand::seq::index::sample(rng, range.len(), range.len().min(OF_EACH))
                .iter()
                .map(|i| range.start + i),
        );
    }
    indices.sort_unstable();
    indices
}

/// Sum over all columns, optionally weighted.
fn weighted(slopes: &[f64], weight: Option<&[f64]>) -> f64 {
    weight.map_or_else(
        || slopes.iter().sum(),
        |weight| slopes.iter().zip(weight).map(|(s, w)| s * w).sum(),
    )
}

impl Comparison {
    /// Compares single components of the parameter gradient with their slopes, given per column.
    fn components(
        &mut self,
        found: &[f64],
        some: &[(usize, Vec<f64>)],
        weight: Option<&[f64]>,
    ) -> Result<(), Mismatch> {
        let expected: Vec<(usize, f64)> =
            some.iter().map(|(index, slopes)| (*index, weighted(slopes, weight))).collect();
        let scale = expected.iter().fold(0.0, |scale: f64, (_, e)| scale.max(e.abs()));
        expected.iter().try_for_each(|&(index, e)| {
            self.one("param_gradient: theta_bar", index, found[index], e, scale)
        })
    }

    /// Compares the parameter gradient along random directions with the slopes, given per column.
    /// If a direction fails, compares all components to locate the error. `components` computes the
    /// slopes of parameters.
    fn directions(
        &mut self,
        found: &[f64],
        directions: &[(Vec<f64>, Vec<f64>)],
        weight: Option<&[f64]>,
        components: &dyn Fn(&[usize]) -> Components,
    ) -> Result<(), Mismatch> {
        for (index, (direction, slopes)) in directions.iter().enumerate() {
            if let Err(mismatch) = self.direction(index, found, direction, slopes, weight) {
                let all: Vec<usize> = (0..found.len()).collect();
                self.components(found, &components(&all), weight)?;
                return Err(mismatch);
            }
        }
        Ok(())
    }

    /// Compares `⟨g, v⟩`, for the parameter gradient g and the direction v, with the slopes of
    /// `act` along v, given per column.
    fn direction(
        &mut self,
        index: usize,
        found: &[f64],
        direction: &[f64],
        slopes: &[f64],
        weight: Option<&[f64]>,
    ) -> Result<(), Mismatch> {
        let terms = || found.iter().zip(direction).map(|(g, v)| g * v);
        let scale = terms().map(f64::abs).sum();
        self.one(
            "param_gradient: theta_bar in random direction",
            index,
            terms().sum(),
            weighted(slopes, weight),
            scale,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::{Conv, Linear};

    #[test]
    fn up_to_64_components_per_tensor_are_compared_and_all_of_a_small_policy() {
        let policy = Conv::new(32, 60);
        let chosen = some_parameters(&policy.tensors(), &mut stream(0, Purpose::Check, 0));
        assert!(chosen.is_sorted_by(|a, b| a < b), "indices are sorted and unique");
        let of = |tensor: crate::policy::Tensor| {
            chosen.iter().filter(|i| tensor.range.contains(i)).count()
        };
        assert_eq!(
            policy.tensors().into_iter().map(of).collect::<Vec<_>>(),
            [64, 60, 64, 60, 64, 1]
        );
        let few =
            some_parameters(&Linear::with_bias(3, 2).tensors(), &mut stream(0, Purpose::Check, 0));
        assert_eq!(few, (0..8).collect::<Vec<_>>());
    }
}

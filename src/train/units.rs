//! [`Units`]: running mean and standard deviation of the observations, as coordinates of a first layer.

use crate::engine::visited::Visited;
use crate::numbers::scalar::Float;
use crate::policy::{AnyPolicy, InputLayer};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Deviations below this one count as this one, so that the noise of a component at rest is not
/// enlarged.
const LEAST: f64 = 1e-3;

/// The same relative to the mean: the weights of y and the bias cancel where the deviation is small
/// against the mean, with an error of ε mean / deviation times the weight of a normalized component.
const LEAST_OF_MEAN: f64 = 1e-4;

/// Mean and standard deviation of each component of the observation.
///
/// A layer `z = W y + b` equals a layer `z = Ŵ (y - mean) / deviation + b̂`. An optimizer that works
/// on Ŵ and b̂ trains a network of normalized observations, while the parameters of the policy remain
/// those of a network of the observation itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Units(Vec<[f64; 2]>);

/// The layers of a policy that are trained in other units: the first one in those of the observation,
/// the last one, of bounded controls, in those of half their ranges.
#[derive(Clone, Debug)]
pub(super) struct Coordinates {
    first: InputLayer,
    last: Option<Outputs>,
}

/// The last layer of a policy with bounds.
#[derive(Clone, Debug)]
struct Outputs {
    /// Entries of the weights, row-major, with one column per control, and of the biases after them.
    entries: Range<usize>,
    /// Half the width of the range of each control.
    half_widths: Vec<f64>,
}

impl Coordinates {
    /// None for a policy without such a first layer.
    pub(super) fn of<F: Float>(policy: &dyn AnyPolicy<F>) -> Option<Self> {
        let last = policy.output_layer().zip(policy.control_bounds()).map(|(entries, bounds)| {
            let half_width = |&[low, high]: &[f64; 2]| 0.5 * high - 0.5 * low;
            Outputs { entries, half_widths: bounds.iter().map(half_width).collect() }
        });
        Some(Self { first: policy.input_layer()?, last })
    }

    /// Number of components of the observation.
    pub(super) fn inputs(&self) -> usize {
        self.first.inputs
    }

    /// Whether a bias can shift the observations.
    pub(super) fn is_shifted(&self) -> bool {
        self.first.bias.is_some()
    }

    /// Changes parameters of the policy to those in units.
    pub(super) fn enter<F: Float>(&self, units: &Units, theta: &mut [F]) {
        units.enter(&self.first, theta);
        self.scale(theta, |half_width| 1.0 / half_width);
    }

    /// Changes parameters in units to those of the policy.
    pub(super) fn leave<F: Float>(&self, units: &Units, theta: &mut [F]) {
        units.leave(&self.first, theta);
        self.scale(theta, |half_width| half_width);
    }

    /// Changes the derivatives by parameters of the policy to those by parameters in units.
    pub(super) fn enter_gradient<F: Float>(&self, units: &Units, gradient: &mut [F]) {
        units.enter_gradient(&self.first, gradient);
        self.scale(gradient, |half_width| half_width);
    }

    fn scale<F: Float>(&self, theta: &mut [F], by: impl Fn(f64) -> f64) {
        let Some(Outputs { entries, half_widths }) = &self.last else { return };
        for row in theta[entries.clone()].chunks_exact_mut(half_widths.len()) {
            for (weight, &half_width) in row.iter_mut().zip(half_widths) {
                *weight = F::from_f64(by(half_width) * weight.as_());
            }
        }
    }
}

impl Units {
    /// Changes W and b to Ŵ and b̂.
    pub(super) fn enter<F: Float>(&self, layer: &InputLayer, theta: &mut [F]) {
        self.convert(layer, theta, |_, deviation| deviation, |mean, _| mean);
    }

    /// Changes Ŵ and b̂ to W and b.
    pub(super) fn leave<F: Float>(&self, layer: &InputLayer, theta: &mut [F]) {
        let shift = |mean: f64, deviation: f64| -mean / deviation;
        self.convert(layer, theta, |_, deviation| 1.0 / deviation, shift);
    }

    /// Multiplies each row of a kernel by `scale`, and adds `shift` times the row to the bias.
    fn convert<F: Float>(
        &self,
        layer: &InputLayer,
        theta: &mut [F],
        scale: impl Fn(f64, f64) -> f64,
        shift: impl Fn(f64, f64) -> f64,
    ) {
        let (kernel, mut bias) = layer.parts(theta);
        for (row, &[mean, deviation]) in kernel.zip(&self.0) {
            let (scale, shift) = (scale(mean, deviation), shift(mean, deviation));
            for (i, weight) in row.iter_mut().enumerate() {
                if let Some(bias) = &mut bias {
                    bias[i] = F::from_f64(bias[i].as_() + shift * weight.as_());
                }
                *weight = F::from_f64(scale * weight.as_());
            }
        }
    }

    /// Changes the derivatives with respect to W and b to those with respect to Ŵ and b̂.
    pub(super) fn enter_gradient<F: Float>(&self, layer: &InputLayer, gradient: &mut [F]) {
        let (kernel, bias) = layer.parts(gradient);
        for (row, &[mean, deviation]) in kernel.zip(&self.0) {
            for (i, slope) in row.iter_mut().enumerate() {
                let of_bias = bias.as_ref().map_or(0.0, |bias| bias[i].as_());
                *slope = F::from_f64((slope.as_() - mean * of_bias) / deviation);
            }
        }
    }
}

/// Moments of all observations so far.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Moments {
    count: f64,
    /// Mean of each component, and sum of the squares of the differences from it.
    sums: Vec<[f64; 2]>,
}

impl Moments {
    /// Whether there are no observations.
    pub(super) fn is_empty(&self) -> bool {
        self.sums.is_empty()
    }

    /// Adds an observation (Welford 1962, doi:10.1080/00401706.1962.10490022).
    pub(super) fn add<F: Float>(&mut self, y: &[F]) {
        self.sums.resize(y.len(), [0.0; 2]);
        self.count += 1.0;
        for ([mean, squares], y) in self.sums.iter_mut().zip(y) {
            let difference = y.as_() - *mean;
            *mean += difference / self.count;
            *squares += difference * (y.as_() - *mean);
        }
    }

    /// Adds the observations of windows, up to the ends of episodes. States have `states` components.
    pub(super) fn add_running<F: Float>(
        &mut self,
        visited: &Visited<F>,
        ended: Option<usize>,
        states: usize,
    ) {
        let observed = visited.observations.len() / (visited.states.len() / states);
        let all = visited.states.chunks_exact(states);
        for (x, y) in all.zip(visited.observations.chunks_exact(observed)) {
            if ended.is_none_or(|ended| x[ended] == F::zero()) {
                self.add(y);
            }
        }
    }

    /// The units of these observations. `shifted` is false for a layer without a bias.
    pub(super) fn units(&self, shifted: bool) -> Units {
        let unit = |&[mean, squares]: &[f64; 2]| {
            let least = LEAST.max(LEAST_OF_MEAN * mean.abs());
            let deviation = (squares / self.count).sqrt().max(least);
            [if shifted { mean } else { 0.0 }, deviation]
        };
        Units(self.sums.iter().map(unit).collect())
    }

    /// Whether all numbers are finite, and of `components` components unless there are none.
    pub(super) fn is_valid(&self, components: usize) -> bool {
        (self.sums.is_empty() || self.sums.len() == components)
            && self.count.is_finite()
            && self.sums.iter().flatten().all(|number| number.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::PolicyRecord;
    use crate::policy::{Bounded, Mlp, Policy, PolicyColumns, PolicyPass, Weights};

    const OBSERVATIONS: [[f64; 3]; 4] =
        [[1.0, -20.0, 5.0], [1.5, 30.0, 5.0], [0.2, 10.0, 5.0], [-0.4, 2.0, 5.0]];

    #[test]
    fn a_constant_of_a_large_number_does_not_cancel_in_f32() {
        let mut moments = Moments::default();
        moments.add(&[101_325.0, 350.0]);
        moments.add(&[101_325.0, 352.0]);
        assert_eq!(moments.units(true).0, [[101_325.0, 10.1325], [351.0, 1.0]]);
    }

    /// Outputs of a policy for the observations, and the gradient of their sum.
    fn evaluate(policy: &dyn AnyPolicy<f64>, theta: &[f64], y: &[[f64; 3]]) -> [Vec<f64>; 2] {
        let sizes = policy.sizes(y.len());
        let weights = Weights::new(policy, theta.to_vec());
        let columns = PolicyColumns::range(0..y.len());
        let pass = PolicyPass::new(weights.packed(), columns, y.as_flattened());
        let mut tape = vec![0.0; sizes.tape];
        let mut tape_bar = vec![0.0; sizes.tape_bar];
        let mut u = vec![0.0; y.len() * policy.control_dim()];
        let (u_bar, mut gradient) = (vec![1.0; u.len()], vec![0.0; theta.len()]);
        policy.forward(pass, &mut tape, &mut u);
        policy.backward(pass, &tape, &u_bar, &mut tape_bar, None);
        let record = PolicyRecord { tape: &tape, u_bar: &u_bar, tape_bar: &tape_bar, weight: None };
        policy.param_gradient(pass, record, &mut vec![0.0; sizes.scratch], &mut gradient);
        [u, gradient]
    }

    /// A network of normalized observations has the outputs and the gradient of the network of the
    /// observations themselves, in the parameters of the former.
    #[test]
    fn parameters_in_units_are_those_of_a_network_of_normalized_observations() {
        for bias in [true, false] {
            let network = Mlp::new([3, 5, 2]).bias(bias);
            let policy = Bounded::new(network, [2.0, 3.0]);
            let layer = Policy::input_layer(&policy).expect("a first layer");
            let mut moments = Moments::default();
            OBSERVATIONS.iter().for_each(|y| moments.add(y));
            let units = moments.units(bias);
            let [mean, deviation] = units.0[0];
            let variance =
                [1.0, 1.5, 0.2, -0.4].map(|y: f64| (y - 0.575).powi(2)).iter().sum::<f64>() / 4.0;
            assert!((deviation - variance.sqrt()).abs() < 1e-15);
            assert!((mean - if bias { 0.575 } else { 0.0 }).abs() < 1e-15);
            assert_eq!(units.0[2][1], LEAST, "the third component is constant");
            let theta: Vec<f64> =
                (0..Policy::param_count(&policy)).map(|i| (0.7 * i as f64).sin()).collect();
            let mut inside = theta.clone();
            units.enter(&layer, &mut inside);
            let normalized = OBSERVATIONS
                .map(|y| std::array::from_fn(|i| (y[i] - units.0[i][0]) / units.0[i][1]));
            let [u, mut gradient] = evaluate(&policy, &theta, &OBSERVATIONS);
            let [u_inside, gradient_inside] = evaluate(&policy, &inside, &normalized);
            units.enter_gradient(&layer, &mut gradient);
            let mut back = inside;
            units.leave(&layer, &mut back);
            // Sums of at most four products of numbers below 5e4 (5 / 1e-3 times a weight).
            let pairs = [(&u, &u_inside), (&gradient, &gradient_inside), (&theta, &back)];
            for (a, b) in pairs.into_iter().flat_map(|(a, b)| a.iter().zip(b)) {
                assert!((a - b).abs() <= 1e-10 * a.abs().max(1.0), "{a} is not {b}, bias {bias}");
            }
        }
    }
}

//! Weights, truncation and cuts of flows.

use super::memory::{AngleOnly, Whole};
use physgrad::engine::Batch;
use physgrad::policy::{Gru, Linear, Mlp, OpenLoop};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::{Flow, Inputs, Policy, Scalar, Start, System, Task, Weights, check, initial_states};

/// Gradient of one flow over five samples.
fn gradient<T: Task, P: Policy>(task: &T, policy: &P, flow: Flow) -> Vec<f64> {
    let weights = Weights::<f64>::init(policy, &mut stream(1, Purpose::Policy, 0));
    let mut batch = Batch::new(task, policy, 5, &[flow], 1);
    batch.run(task, policy, &weights, &initial_states(task, 0, Purpose::Train, 5)).expect("finite");
    batch.gradients()[0].to_vec()
}

fn weighted_flows() -> Vec<Flow> {
    let uneven = Flow { physics: 0.8, control: 0.3, memory: 0.6, ..Flow::REGULAR };
    let mut flows = vec![uneven, uneven.truncated(4), Flow::REGULAR.discounted(0.7).truncated(5)];
    for flow in Flow::ALL {
        flows.extend([
            flow.discounted(0.9),
            flow.truncated(1),
            flow.truncated(3),
            flow.truncated(100),
        ]);
    }
    flows
}

#[test]
fn weighted_and_truncated_flows_agree_with_dual_numbers() {
    for flow in weighted_flows() {
        let checked = [
            check::flow(&AngleOnly, &Linear::with_bias(1, 1), flow, None),
            check::flow(&AngleOnly, &Gru::new(1, 3, 1), flow, None),
            check::flow(&Whole, &Mlp::new([2, 5, 2]), flow, None),
            check::flow(&Whole, &Gru::new(2, 3, 2), flow, None),
        ];
        for checked in checked {
            checked.unwrap_or_else(|failure| panic!("{flow}: {failure}"));
        }
    }
}

#[test]
fn neutral_discounts_truncations_and_cuts_keep_the_bits() {
    for flow in Flow::ALL {
        let policy = Mlp::new([1, 4, 1]);
        let plain = gradient(&AngleOnly, &policy, flow);
        for neutral in [flow.discounted(1.0), flow.truncated(12), flow.cut(f64::INFINITY)] {
            assert_eq!(gradient(&AngleOnly, &policy, neutral), plain, "{neutral}");
        }
        assert_ne!(
            gradient(&AngleOnly, &policy, Flow::REGULAR.truncated(11)),
            gradient(&AngleOnly, &policy, Flow::REGULAR)
        );
    }
}

/// With a truncation at every step and no memory, no adjoint passes between steps, as in S.
#[test]
fn truncation_at_every_step_equals_the_stopped_flow() {
    let policy = Mlp::new([2, 4, 2]);
    let stopped = gradient(&Whole, &policy, Flow::STOPPED);
    for flow in [Flow::REGULAR, Flow::MODIFIED, Flow::NETWORK] {
        assert_eq!(gradient(&Whole, &policy, flow.truncated(1)), stopped, "{flow}");
    }
}

/// `x_{t+1} = a x_t + u_t`, with a factor a per sample and the cost `x_{t+1} + x_t u_t`.
struct Growing(Vec<f64>);

impl System for Growing {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn param_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, p, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = p[0] * x[0] + u[0];
    }
}

impl Task for Growing {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        20
    }
    fn start(&self, _: &mut Rng, _: Start<'_>) {}
    fn running_cost<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &[T]) -> T {
        next[0] + x[0] * u[0]
    }
}

/// Gradient with respect to the controls of one sample, from the definition of a cut. The cost c
/// has the derivatives `∂c/∂x_{t+1} = 1`, `∂c/∂x_t = u_t` and `∂c/∂u_t = x_t`.
fn by_definition(a: f64, u: &[f64], x: &[f64], decades: f64) -> Vec<f64> {
    let (mut lambda, mut grown) = (0.0, 0.0);
    let mut gradient = vec![0.0; u.len()];
    for t in (0..u.len()).rev() {
        let before: f64 = lambda + 1.0;
        gradient[t] = before + x[t];
        lambda = a * before + u[t];
        grown += (lambda.abs() / before.abs()).log10();
        if grown > decades {
            (lambda, grown) = (u[t], 0.0);
        }
    }
    gradient
}

#[test]
fn a_cut_agrees_with_its_definition_in_each_sample() {
    let task = Growing(vec![10.0, 0.5, 3.0, -4.0, 1.0]);
    let policy = OpenLoop::new(1, 1, 20);
    let controls: Vec<f64> = (0..20).map(|t| (t as f64).sin()).collect();
    let weights = Weights::<f64>::new(&policy, controls.clone());
    let starts: Vec<f64> = task.0.iter().flat_map(|&a| [1.0, a]).collect();
    for decades in [0.3, 2.5, 7.0, 1e3] {
        let mut batch = Batch::new(&task, &policy, 5, &[Flow::REGULAR.cut(decades)], 1);
        batch.run(&task, &policy, &weights, &starts).expect("finite");
        let mut expected = vec![0.0; 20];
        for &a in &task.0 {
            let mut x = vec![1.0];
            controls.iter().for_each(|u| x.push(a * x[x.len() - 1] + u));
            for (sum, g) in expected.iter_mut().zip(by_definition(a, &controls, &x, decades)) {
                *sum += g / 5.0;
            }
        }
        let scale = expected.iter().fold(0.0, |scale: f64, g| scale.max(g.abs()));
        for (found, expected) in batch.gradients()[0].to_vec().into_iter().zip(expected) {
            assert!(
                (found - expected).abs() <= 1e-14 * scale,
                "{decades} decades: {found} and {expected}"
            );
        }
    }
}

#[test]
fn names_of_flows_state_weights_truncation_and_cut() {
    let shown = |flow: Flow| flow.to_string();
    assert_eq!(Flow::ALL.map(shown), ["R", "M", "N", "S"]);
    assert_eq!(
        shown(Flow::MODIFIED.truncated(8).cut(3.0)),
        "M, truncated every 8 steps, cut at a growth of 3 decades"
    );
    assert_eq!(
        shown(Flow { memory: 0.0, ..Flow::MODIFIED }),
        "M, weights [1.0, 0.0, 0.0] of physics, control and memory"
    );
}

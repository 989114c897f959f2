//! Policies with a dimension of 0.

use physgrad::policy::{Bounded, Constant, Elman, Gru, Sum};
use physgrad::rng::{Purpose, stream};
use physgrad::{
    Adjoint, Flow, Gradient, Inputs, Policy, Rollout, Scalar, Start, System, Task, Weights,
    rng::Rng,
};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// `x' = x/2` over three steps. The loss is the final state.
struct Decay;

impl System for Decay {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        0
    }
    fn step<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] * 0.5;
    }
}

impl Task for Decay {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        3
    }
    fn start(&self, _: &mut Rng, _: Start<'_>) {}
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        x[0]
    }
}

#[test]
fn recurrent_policies_of_systems_without_controls_have_gradients_of_0() {
    fn assert_zero(policy: &impl Policy) {
        let weights = Weights::<f64>::init(policy, &mut stream(0, Purpose::Policy, 0));
        let mut rollout = Rollout::new(&Decay, policy, 1);
        rollout.start(&[1.0]);
        rollout.run(&Decay, policy, &weights).expect("finite");
        let mut adjoint =
            Adjoint::new(&Decay, policy, &rollout, &[Flow::REGULAR]).keep_start_gradients();
        adjoint.run(&Decay, policy, &weights, &rollout, 1.0).expect("finite");
        let mut by_theta = Gradient::zeros(weights.theta().len());
        adjoint.param_gradient(0, policy, &weights, &rollout, 0..1, &mut by_theta);
        assert_eq!(adjoint.start_gradient(0, 0).to_vec(), [0.125]);
        assert!(
            !by_theta.values().is_empty() && by_theta.values().iter().all(|&g| g == 0.0),
            "{by_theta:?}"
        );
    }
    assert_zero(&Gru::new(1, 2, 0));
    assert_zero(&Elman::new(1, 2, 0));
}

#[test]
fn policies_that_need_a_dimension_name_it() {
    let message = |construct: &dyn Fn()| -> String {
        let panic = catch_unwind(AssertUnwindSafe(construct)).expect_err("an empty dimension");
        panic
            .downcast_ref::<String>()
            .cloned()
            .or(panic.downcast_ref::<&str>().map(|text| text.to_string()))
            .expect("a text")
    };
    let bounded = message(&|| _ = Bounded::new(Constant::new(0, 1), [1.0]));
    assert!(bounded.contains("at least one observed component"), "{bounded}");
    let sum = message(&|| _ = Sum::new(Constant::new(0, 1), Constant::new(0, 1)));
    assert!(sum.contains("at least one observed component"), "{sum}");
    for recurrent in [message(&|| _ = Gru::new(2, 0, 1)), message(&|| _ = Elman::new(2, 0, 1))] {
        assert!(recurrent.contains("at least one unit"), "{recurrent}");
    }
}

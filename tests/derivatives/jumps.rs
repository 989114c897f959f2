//! Losses that jump, whose mean gradient R misses.

use physgrad::check::jumps;
use physgrad::policy::Constant;
use physgrad::rng::{Purpose, Rng};
use physgrad::{Inputs, Scalar, Start, System, Task, Weights, initial_states};
use rand::RngExt;

/// The cost is a wave in u, too fast for eight nodes, and equal in all samples.
struct Wave;

impl System for Wave {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = u[0];
    }
}

impl Task for Wave {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        1
    }
    fn start(&self, _rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x[0] = 0.0;
    }
    fn running_cost<T: Scalar>(&self, _inputs: Inputs<'_, T>, next: &[T]) -> T {
        (next[0] * 1000.0).sin() + next[0] * 0.1
    }
}

#[test]
fn a_smooth_loss_that_varies_too_fast_for_the_rule_is_undecided() {
    let policy = Constant::new(1, 1);
    let starts = initial_states(&Wave, 0, Purpose::Test, 64);
    for theta in [0.0, 0.1, 0.2, 0.3] {
        let weights = Weights::new(&policy, vec![theta]);
        let found = jumps(&Wave, &policy, &weights, &starts).expect("finite losses");
        assert!(!found.is_biased(), "{theta}: {found:?}");
    }
}

/// One step `x' = x + u` from x between -1 and 1. The cost grows by 0.1 per unit, and by `jump`
/// at 0.
struct Stair {
    jump: f64,
}

impl System for Stair {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] + u[0];
    }
}

impl Task for Stair {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        1
    }
    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x[0] = rng.random_range(-1.0..1.0);
    }
    fn running_cost<T: Scalar>(&self, _inputs: Inputs<'_, T>, next: &[T]) -> T {
        next[0].exp() * 0.1 + T::select_lt(next[0], T::zero(), T::zero(), T::from(self.jump))
    }
}

#[test]
fn a_jump_of_the_cost_biases_the_gradient_and_a_curved_cost_does_not() {
    let policy = Constant::new(1, 1);
    let found = |jump: f64| {
        let task = Stair { jump };
        let starts = initial_states(&task, 0, Purpose::Test, 2048);
        jumps(&task, &policy, &Weights::new(&policy, vec![0.0]), &starts).expect("finite losses")
    };
    let smooth = found(0.0);
    assert!(!smooth.is_biased() && smooth.error < 1e-9 && smooth.interval[1] < 1e-9, "{smooth:?}");
    assert!(smooth.to_string().starts_with("no jumps"), "{smooth}");
    // The density of the initial states is 1/2, so the jump adds 1/2 to the slope of the mean.
    let biased = found(1.0);
    assert!(biased.is_biased(), "{biased:?}");
    let slope = 0.1 * f64::sinh(1.0);
    let expected = 0.5 / (0.5 + slope);
    assert!((biased.interval[0]..biased.interval[1]).contains(&expected), "{biased:?}");
    assert!((biased.predicted - slope).abs() < 0.01, "{biased:?}");
    assert!(biased.to_string().starts_with("biased"));
    // A small jump is not a bias.
    let small = found(1e-3);
    assert!(!small.is_biased() && small.error > 1e-4, "{small:?}");
}

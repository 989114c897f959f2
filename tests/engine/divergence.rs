//! Rollouts and reverse passes report non-finite numbers. Training skips the affected updates.

use physgrad::engine::{Batch, Evaluation, Variable};
use physgrad::policy::{Action, Linear, Mlp, Observed, Policy};
use physgrad::rng::Rng;
use physgrad::train::{GradientCombiner, OptimizerKind};
use physgrad::{
    Clip, Divergence, Field, Float, Flow, Inputs, Rollout, Scalar, Start, System, Task, TrainError,
    Trainer, Training, Weights,
};

/// Type and place of a fault.
#[derive(Clone, Copy)]
enum Fault {
    /// Component 1 is infinite from state 5 on, in samples that start above 0.5.
    State,
    /// The cost of the samples that start above 0.5 is NaN.
    Cost,
    /// In step 3, samples that start above 0.5 take a square root at 0. The value is finite, the
    /// derivative infinite.
    Cotangent,
    /// As `Cotangent`, with respect to the control.
    ControlCotangent,
}

struct Faulty(Fault);

impl System for Faulty {
    fn state_dim(&self) -> usize {
        3
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        let marked = |yes: T, no: T| T::select_lt(T::from(0.5), x[0], yes, no);
        next[0] = x[0];
        next[1] = x[1] + u[0] * 0.1;
        // Component 2 counts the steps.
        next[2] = x[2] + T::one();
        let (clock, huge) = (x[2], T::from(1e30));
        match self.0 {
            Fault::State => {
                let late = T::select_lt(
                    T::from(3.5),
                    clock,
                    huge * huge * huge * huge * huge * huge * huge * huge * huge * huge * huge,
                    T::zero(),
                );
                next[1] += marked(late, T::zero());
            }
            Fault::Cost => {}
            Fault::Cotangent => {
                let root = (x[1] - x[1].detach()).sqrt();
                let at_step_3 = T::select_lt((clock - 3.0).abs(), T::from(0.5), root, next[1]);
                next[1] = marked(at_step_3, next[1]);
            }
            Fault::ControlCotangent => {
                let root = (u[0] - u[0].detach()).sqrt();
                let at_step_3 = T::select_lt((clock - 3.0).abs(), T::from(0.5), root, next[1]);
                next[1] = marked(at_step_3, next[1]);
            }
        }
    }
}

impl Task for Faulty {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        8
    }
    /// Draws only initial states without a fault.
    fn start(&self, _: &mut Rng, start: Start<'_>) {
        start.x.copy_from_slice(&[0.1, 0.3, 0.0]);
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        let bad = T::select_lt(T::from(0.5), x[0], T::from(f64::NAN), T::zero());
        let cost = x[1] * x[1];
        if let Fault::Cost = self.0 { cost + bad } else { cost }
    }
}

/// Returns the initial states of eleven samples. Only sample 9 starts above 0.5 and has the fault.
fn starts() -> Vec<f64> {
    (0..11).flat_map(|sample| [if sample == 9 { 0.9 } else { 0.1 }, 0.3, 0.0]).collect()
}

fn run(fault: Fault, workers: usize) -> Result<f64, Divergence> {
    let (task, policy) = (Faulty(fault), Linear::with_bias(3, 1));
    let weights = Weights::new(&policy, vec![0.1, 0.2, -0.05, 0.3]);
    Batch::new(&task, &policy, 11, &[Flow::MODIFIED, Flow::REGULAR], workers).run(
        &task,
        &policy,
        &weights,
        &starts(),
    )
}

#[test]
fn step_sample_component_and_pass_are_named_for_1_to_3_workers() {
    for workers in [1, 2, 3] {
        assert_eq!(
            run(Fault::State, workers),
            Err(Divergence::Forward {
                variable: Variable::State,
                step: 5,
                sample: 9,
                component: 1,
                cause: None
            })
        );
        assert_eq!(run(Fault::Cost, workers), Err(Divergence::Cost { sample: 9 }));
        let cotangent = Divergence::Cotangent {
            flow: Flow::MODIFIED,
            variable: Variable::State,
            step: 3,
            sample: 9,
            component: 1,
            cause: None,
        };
        assert_eq!(run(Fault::Cotangent, workers), Err(cotangent));
        let variable = Variable::Control;
        let control = Divergence::Cotangent {
            flow: Flow::MODIFIED,
            variable,
            step: 3,
            sample: 9,
            component: 0,
            cause: None,
        };
        assert_eq!(run(Fault::ControlCotangent, workers), Err(control));
    }
}

/// Policy with a memory and a fault in samples that start below -0.5. If `forward`, the memory is
/// infinite at step 2, and samples that start above 0.5 have an infinite control at this step. If
/// not, the derivative of the control with respect to the state is infinite at step 4.
struct FaultyMemory {
    forward: bool,
}

impl Policy for FaultyMemory {
    fn observation_dim(&self) -> usize {
        3
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn memory_dim(&self) -> usize {
        1
    }
    fn param_count(&self) -> usize {
        1
    }
    fn init(&self, _: &mut Rng, theta: &mut [f64]) {
        theta[0] = 0.1;
    }
    fn act<T: Scalar>(
        &self,
        theta: &[T],
        Observed { y, .. }: Observed<'_, T>,
        action: Action<'_, T>,
    ) {
        let at =
            |step: f64, value: T| T::select_lt((y[2] - step).abs(), T::from(0.5), value, T::zero());
        let marked = |value: T| T::select_lt(y[0], T::from(-0.5), value, T::zero());
        let infinite = |is_bad: T| is_bad / (T::one() - is_bad);
        action.u[0] = theta[0] * y[1];
        action.memory[0] = T::zero();
        if self.forward {
            let others = T::select_lt(T::from(0.5), y[0], T::one(), T::zero());
            action.memory[0] = infinite(at(2.0, marked(T::one())));
            action.u[0] += infinite(at(2.0, others));
        } else {
            action.u[0] += at(4.0, marked((y[1] - y[1].detach()).sqrt()));
        }
    }
}

#[test]
fn the_first_sample_of_a_step_is_named_for_any_number_of_workers() {
    // Sample 4 has a fault in the control, or in both flows of the reverse pass. Sample 0 has one
    // in the memory, or in R only. Each worker has four samples or more.
    let starts: Vec<f64> = (0..8)
        .flat_map(|sample| [[-0.9, 0.1, 0.1, 0.1, 0.9, 0.1, 0.1, 0.1][sample], 0.3, 0.0])
        .collect();
    let task = Faulty(Fault::Cotangent);
    for (forward, workers) in [(true, 1), (true, 2), (false, 1), (false, 2)] {
        let policy = FaultyMemory { forward };
        let weights = Weights::new(&policy, vec![0.1]);
        let flows = [Flow::MODIFIED, Flow::REGULAR];
        let found =
            Batch::new(&task, &policy, 8, &flows, workers).run(&task, &policy, &weights, &starts);
        let expected = if forward {
            Divergence::Forward {
                variable: Variable::Memory,
                step: 2,
                sample: 0,
                component: 0,
                cause: None,
            }
        } else {
            let (flow, variable) = (Flow::REGULAR, Variable::State);
            // The derivative of the policy is infinite with respect to component 1, and NaN with
            // respect to the others.
            Divergence::Cotangent { flow, variable, step: 3, sample: 0, component: 0, cause: None }
        };
        assert_eq!(found, Err(expected), "{workers} workers");
    }
}

#[test]
fn the_message_names_pass_component_sample_and_step() {
    let text = run(Fault::Cotangent, 1).unwrap_err().to_string();
    for part in ["reverse pass of M", "state component 1", "sample 9", "step 3"] {
        assert!(text.contains(part), "{text}");
    }
}

#[test]
fn a_nan_in_an_initial_state_is_named() {
    let (task, policy) = (Faulty(Fault::Cost), Linear::new(3, 1));
    let weights = Weights::<f32>::new(&policy, vec![0.5; 3]);
    let mut rollout = Rollout::new(&task, &policy, 3);
    rollout.start(&[0.1, 0.1, 0.0, 0.1, f32::NAN, 0.0, 0.1, 0.1, 0.0]);
    let error = rollout.run(&task, &policy, &weights).expect_err("a NaN").to_string();
    assert!(
        error.contains("component 1 of the initial state of sample 1 is not finite"),
        "{error}"
    );
}

#[test]
fn an_evaluation_names_sample_71_of_100() {
    let (task, policy) = (Faulty(Fault::State), Linear::with_bias(3, 1));
    let weights = Weights::new(&policy, vec![0.1, 0.2, -0.05, 0.3]);
    let mut many = [0.1, 0.3, 0.0].repeat(100);
    many[71 * 3] = 0.9;
    for workers in [1, 3] {
        let found = Evaluation::new(&task, &policy, workers).run(&task, &policy, &weights, &many);
        assert_eq!(
            found,
            Err(Divergence::Forward {
                variable: Variable::State,
                step: 5,
                sample: 71,
                component: 1,
                cause: None
            })
        );
    }
}

#[test]
fn states_before_a_divergence_can_be_read() {
    let (task, policy) = (Faulty(Fault::State), Linear::with_bias(3, 1));
    let weights = Weights::new(&policy, vec![0.0; 4]);
    let mut rollout = Rollout::new(&task, &policy, 11);
    rollout.start(&starts());
    assert!(rollout.run(&task, &policy, &weights).is_err());
    assert_eq!(rollout.state(4, 9, 1), 0.3);
    assert!(rollout.state(5, 9, 1).is_infinite());
}

#[test]
fn updates_with_a_bad_sample_are_skipped_counted_and_change_nothing() {
    // Two mini-batches of 6 and 5 samples. Sample 9 is in the second.
    let training = Training { epochs: 3, batch: 6, max_skipped: 10, ..Training::default() };
    let trainer = Trainer::new(Faulty(Fault::Cotangent), Linear::with_bias(3, 1))
        .precision::<f64>()
        .training(training.clone());
    let mut session =
        trainer.session_from(vec![0.1; 4], starts(), starts()).expect("valid settings");
    let record = session.epoch().expect("one finite update").clone();
    assert_eq!(record.skipped, 1);
    assert_eq!(session.skips()[0].update, 1);
    assert_eq!(
        session.skips()[0].divergence,
        Divergence::Cotangent {
            flow: Flow::MODIFIED,
            variable: Variable::State,
            step: 3,
            sample: 3,
            component: 1,
            cause: None
        }
    );

    let warnings = session.warnings();
    assert!(
        warnings[0].starts_with(
            "epoch 1: 1 of 2 updates skipped, for example update 1 (reverse pass of M"
        ),
        "{warnings:?}"
    );

    // Identical training without the second mini-batch.
    let trainer = Trainer::new(Faulty(Fault::Cotangent), Linear::with_bias(3, 1))
        .precision::<f64>()
        .training(training);
    let mut good = trainer
        .session_from(vec![0.1; 4], starts()[..18].to_vec(), starts())
        .expect("valid settings");
    good.epoch().expect("finite");
    assert_eq!(session.weights().theta(), good.weights().theta());
}

#[test]
fn the_fourth_skip_in_a_row_stops_training_with_unchanged_parameters() {
    let training = Training { epochs: 100, batch: 11, max_skipped: 3, ..Training::default() };
    let trainer = Trainer::new(Faulty(Fault::State), Linear::with_bias(3, 1))
        .precision::<f64>()
        .training(training);
    let mut session =
        trainer.session_from(vec![0.1; 4], starts(), starts()).expect("valid settings");
    for epoch in 1..=3 {
        let record = session.epoch().expect("fewer skips than the limit");
        assert_eq!((record.epoch, record.skipped), (epoch, 1));
        assert!(record.loss.is_nan() && record.train_loss.is_nan());
    }
    let error = session.epoch().expect_err("the fourth skip in a row");
    assert!(matches!(error, TrainError::Diverged { count: 4, .. }));
    let text = error.to_string();
    assert!(text.contains("step 5") && text.contains("sample 9") && text.contains("Try"), "{text}");
    assert_eq!(session.weights().theta(), [0.1; 4]);
}

#[test]
fn an_infinite_gradient_of_finite_cotangents_is_named() {
    // Task whose cotangents fit in single precision, but whose parameter gradients do not.
    struct Steep {
        slope: f64,
    }
    impl System for Steep {
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
    impl Task for Steep {
        type System = Self;
        fn system(&self) -> &Self {
            self
        }
        fn horizon(&self) -> usize {
            1
        }
        fn start(&self, _: &mut Rng, start: Start<'_>) {
            start.x[0] = 1e20;
        }
        fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
            x[0] * self.slope
        }
    }
    let epoch = |slope: f64, start: f32, clip: Clip| {
        let training = Training { train_samples: 8, test_samples: 8, clip, ..Training::default() };
        let trainer = Trainer::new(Steep { slope }, Mlp::new([1, 1]).bias(false))
            .field(Field::regular())
            .training(training);
        let mut session = trainer
            .session_from(vec![0.0], vec![start; 8], vec![start; 8])
            .expect("valid settings");
        session.epoch().expect("one skip at most");
        (session.skips().first().map(|skip| skip.divergence), session.weights().theta()[0])
    };
    // The cotangents are representable. Their product with the state overflows.
    let gradient = Divergence::Gradient { flow: Flow::REGULAR, parameter: 0 };
    assert_eq!(epoch(1e10, 1e30, Clip::None), (Some(gradient), 0.0));
    // Cotangents above 2^60 carry an exponent, so their gradients may exceed the range of f32.
    // Training skips such a gradient unless clipping brings it into range.
    let (divergence, theta) = epoch(1e30, 1e20, Clip::None);
    let Some(Divergence::Field { parameter: 0, norm }) = divergence else {
        panic!("{divergence:?}")
    };
    assert!((norm.get() / 1e50 - 1.0).abs() < 1e-6 && theta == 0.0, "{norm}, {theta}");
    assert!(divergence.expect("one").to_string().contains("Clip by norm"));
    assert!(matches!(epoch(1e30, 1e20, Clip::Norm(1.0)), (None, theta) if theta < 0.0));
}

/// Saturated actuator: `min` and `max` hide a NaN of the control from the state.
#[derive(Debug)]
struct Saturated;

impl System for Saturated {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] + u[0].min(T::one()).max(-T::one());
    }
}

impl Task for Saturated {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        4
    }
    fn start(&self, _: &mut Rng, start: Start<'_>) {
        start.x[0] = 1.0;
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        x[0] * x[0]
    }
}

#[test]
fn a_non_finite_control_is_found_even_if_the_state_stays_finite() {
    let policy = Linear::new(1, 1);
    let weights = Weights::new(&policy, vec![f64::NAN]);
    let mut rollout = Rollout::new(&Saturated, &policy, 2);
    rollout.start(&[1.0, 2.0]);
    let found = rollout.run(&Saturated, &policy, &weights);
    assert_eq!(
        found,
        Err(Divergence::Forward {
            variable: Variable::Control,
            step: 0,
            sample: 0,
            component: 0,
            cause: None
        })
    );
}

/// Combiner that replaces component 0 by a constant.
struct Broken(f64);

impl GradientCombiner for Broken {
    fn name(&self) -> &str {
        "broken"
    }
    fn combine<F: Float>(&self, first: &[F], _: &[F], out: &mut [F]) {
        out.copy_from_slice(first);
        out[0] = F::from_f64(self.0);
    }
}

#[test]
fn an_update_with_a_non_finite_composed_field_is_skipped() {
    // In single precision, the square of 1e30 is infinite. Clipping reduces the value first.
    for (value, clip, bad) in [
        (f64::NAN, Clip::None, true),
        (f64::NAN, Clip::Value(1.0), true),
        (f64::INFINITY, Clip::Norm(1.0), true),
        (1e30, Clip::None, true),
        (1e30, Clip::Norm(1.0), false),
        (1e30, Clip::Value(1.0), false),
    ] {
        let field = Field::custom(Flow::MODIFIED, Flow::REGULAR, Broken(value));
        let training = Training { train_samples: 8, test_samples: 8, clip, ..Training::default() };
        let mut session = Trainer::new(Saturated, Linear::new(1, 1))
            .field(field)
            .training(training)
            .session()
            .expect("valid");
        let before = session.weights().theta().to_vec();
        let record = session.epoch().expect("one update").clone();
        assert_eq!(record.skipped, usize::from(bad), "{value} {clip:?}");
        assert_eq!(session.weights().theta() == before, bad, "{value} {clip:?}");
        assert!(session.weights().theta().iter().all(|t| t.is_finite()));
        if bad {
            assert!(matches!(
                session.skips()[0].divergence,
                Divergence::Field { parameter: 0, .. }
            ));
        }
    }
}

#[test]
fn a_diverging_evaluation_of_the_test_set_is_reported() {
    let training = Training { batch: 6, max_skipped: 100, ..Training::default() };
    let trainer = Trainer::new(Faulty(Fault::State), Linear::with_bias(3, 1))
        .precision::<f64>()
        .training(training);
    let good = [0.1, 0.3, 0.0].repeat(6);
    let mut session = trainer.session_from(vec![0.1; 4], good, starts()).expect("valid settings");
    assert!(session.epoch().expect("finite updates").test_loss.is_nan());
    assert_eq!(
        session.diverged(),
        [
            None,
            Some(Divergence::Forward {
                variable: Variable::State,
                step: 5,
                sample: 9,
                component: 1,
                cause: None
            })
        ]
    );
}

#[test]
fn invalid_settings_are_refused_by_name() {
    let refused = |training: Training| {
        let trainer = Trainer::new(Saturated, Linear::new(1, 1)).training(training);
        trainer.session_from(vec![0.0], vec![1.0], vec![1.0]).expect_err("invalid").to_string()
    };
    assert!(refused(Training { batch: 0, ..Training::default() }).contains("batch"));
    for learning_rate in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e9] {
        assert!(
            refused(Training { learning_rate, ..Training::default() }).contains("learning_rate")
        );
    }
    for rule in [
        OptimizerKind::Adam { beta1: 1.0, beta2: 0.999, epsilon: 1e-7 },
        OptimizerKind::Adam { beta1: 0.9, beta2: f64::NAN, epsilon: 1e-7 },
        OptimizerKind::Momentum { momentum: -0.1 },
        OptimizerKind::RmsProp { rho: 1.5, epsilon: 1e-7 },
        OptimizerKind::Adagrad { initial: -1.0, epsilon: 1e-7 },
        OptimizerKind::Adadelta { rho: 0.95, epsilon: 0.0 },
    ] {
        assert!(
            refused(Training { rule, ..Training::default() }).contains("training.rule: has "),
            "{rule:?}"
        );
    }
    let trainer = Trainer::new(Saturated, Linear::new(1, 1));
    assert!(
        trainer
            .session_from(vec![0.0], vec![1.0], vec![])
            .expect_err("invalid")
            .to_string()
            .contains("test_samples")
    );
}

/// `x' = 1000 x + b_t u`, where b_t is 1 in the last ten of 100 steps, and otherwise 0.
struct Late;

impl System for Late {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, t, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] * 1000.0 + u[0] * if t < 90 { 0.0 } else { 1.0 };
    }
}

impl Task for Late {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        100
    }
    fn start(&self, _: &mut Rng, start: Start<'_>) {
        start.x[0] = 0.0;
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        x[0]
    }
}

#[test]
fn columns_without_cotangents_and_with_large_exponents_add_nothing() {
    // Adjoints of the first steps are near 1000^100, but the control has no effect there.
    let policy = Linear::with_bias(1, 1);
    let weights = Weights::new(&policy, vec![0.0_f32, 0.0]);
    let mut batch = Batch::new(&Late, &policy, 1, &[Flow::MODIFIED], 1);
    batch.run(&Late, &policy, &weights, &[0.0]).expect("a finite gradient");
    let bias = batch.gradients()[0].to_vec()[1];
    let expected = (0..10).map(|k| 1000_f64.powi(k)).sum::<f64>();
    assert!((f64::from(bias) / expected - 1.0).abs() < 1e-5, "{bias:e} for {expected:e}");
}

//! Derivatives of a task whose step and running cost use the state, control, parameters and time.
//! The observation uses all but the control. The terminal cost uses the state and the parameters.

use physgrad::check::Failure;
use physgrad::engine::{Batch, Checkpointed, Schedule};
use physgrad::policy::{Constant, Conv, DynPolicy, Gru, Linear, Mlp, TrainedParam, WithParams};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::tasks::Quantum;
use physgrad::{
    Cotangent, Cotangents, DynTask, Flow, Gradient, Inputs, Policy, Real, Rollout, Scalar, Start,
    System, Task, Weights, check, initial_states,
};
use rand::RngExt;

/// Two coupled state components with a drawn stiffness and goal, a table of pushes, and `CONTROLS`
/// controls.
pub struct Tracking<const CONTROLS: usize> {
    fault: Fault,
}

#[derive(Clone, Copy, PartialEq)]
enum Fault {
    None,
    /// `observe_vjp` has the wrong sign in the derivative of component 0 of the observation.
    Observation,
    /// `running_cost_gradient` omits the state before the step.
    CostOfState,
    /// `observe_vjp` omits the parameters.
    ObservationOfParams,
    /// `running_cost_gradient` omits the parameters.
    CostOfParams,
    /// `running_cost_gradient` omits the control unless the state is requested too.
    CostOfControlAlone,
    /// `observe` does not write the last component.
    Unwritten,
    /// `terminal_cost_gradient` overwrites `x_bar` instead of adding to it.
    Overwrites,
    /// `running_cost_gradient` omits the next state in the second half of 900 steps.
    LateCost,
}

/// Forces added to the control, one per step in turn.
const PUSHES: [f64; 6] = [0.3, -0.2, 0.5, 0.1, -0.4, 0.2];

impl<const CONTROLS: usize> System for Tracking<CONTROLS> {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        CONTROLS
    }
    fn param_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, p, t }: Inputs<'_, T>, next: &mut [T]) {
        let push = T::from(PUSHES[t % PUSHES.len()]);
        next[1] = x[1] + (u[CONTROLS - 1] + push - p[0] * x[0].sin()) * 0.2;
        next[0] = x[0] + next[1] * 0.2 + u[0] * x[1] * 0.1;
    }
}

impl<const CONTROLS: usize> Task for Tracking<CONTROLS> {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        if self.fault == Fault::LateCost { 900 } else { 9 }
    }
    fn param_dim(&self) -> usize {
        2
    }
    fn start(&self, rng: &mut Rng, Start { x, p }: Start<'_>) {
        x.fill_with(|| rng.random_range(-1.0..1.0));
        p[0] = rng.random_range(0.5..1.5);
        p[1] = rng.random_range(-1.0..1.0);
    }
    fn observation_dim(&self) -> Option<usize> {
        Some(3)
    }
    fn observe<T: Scalar>(&self, Inputs { x, p, t, .. }: Inputs<'_, T>, y: &mut [T]) {
        (y[0], y[1]) = x[0].sin_cos();
        if self.fault != Fault::Unwritten {
            y[2] = (p[1] - x[1]) * x[0] + (0.1 * t as f64);
        }
    }
    fn observe_vjp<R: Real, C: Cotangent<R>>(
        &self,
        Inputs { x, p, .. }: Inputs<'_, R>,
        y_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let (sin, cos) = x[0].sin_cos();
        let sign = if self.fault == Fault::Observation { -R::one() } else { R::one() };
        if let Some(x_bar) = cotangents.x {
            x_bar[0] += y_bar[0] * (cos * sign) - y_bar[1] * sin + y_bar[2] * (p[1] - x[1]);
            x_bar[1] -= y_bar[2] * x[0];
        }
        if let (Some(p_bar), true) = (cotangents.p, self.fault != Fault::ObservationOfParams) {
            p_bar[1] += y_bar[2] * x[0];
        }
    }
    fn running_cost<T: Scalar>(&self, Inputs { x, u, p, t }: Inputs<'_, T>, next: &[T]) -> T {
        let miss = next[0] - p[1];
        miss * miss * (1.0 + t as f64) + (next[1] - x[1]) * x[0] + u[0] * u[0] * p[0]
    }
    fn running_cost_gradient<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        next: &[R],
        cotangents: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        let Inputs { x, u, p, t } = inputs;
        if self.fault != Fault::LateCost || t < 450 {
            next_bar[0] += (next[0] - p[1]) * R::from(2.0 * (1.0 + t as f64));
        }
        next_bar[1] += x[0];
        let with_control = self.fault != Fault::CostOfControlAlone || cotangents.x.is_some();
        if let (Some(x_bar), true) = (cotangents.x, self.fault != Fault::CostOfState) {
            x_bar[0] += next[1] - x[1];
            x_bar[1] -= x[0];
        }
        if let (Some(u_bar), true) = (cotangents.u, with_control) {
            u_bar[0] += u[0] * p[0] * R::from(2.0);
        }
        if let (Some(p_bar), true) = (cotangents.p, self.fault != Fault::CostOfParams) {
            p_bar[0] += u[0] * u[0];
            p_bar[1] -= (next[0] - p[1]) * R::from(2.0 * (1.0 + t as f64));
        }
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], p: &[T]) -> T {
        (x[0] - p[1]) * (x[1] + p[0])
    }
    fn terminal_cost_gradient<R: Real>(
        &self,
        x: &[R],
        p: &[R],
        x_bar: &mut [R],
        p_bar: Option<&mut [R]>,
    ) {
        if self.fault == Fault::Overwrites {
            x_bar.fill(R::zero());
        }
        x_bar[0] += x[1] + p[0];
        x_bar[1] += x[0] - p[1];
        if let Some(p_bar) = p_bar {
            p_bar[0] += x[0] - p[1];
            p_bar[1] -= x[1] + p[0];
        }
    }
}

pub fn tracking<const CONTROLS: usize>() -> Tracking<CONTROLS> {
    Tracking { fault: Fault::None }
}

/// Task with the default derivatives of all its methods, by dual numbers.
struct ByDuals<T>(T);

impl<T: Task> Task for ByDuals<T> {
    type System = T::System;
    fn system(&self) -> &T::System {
        self.0.system()
    }
    fn horizon(&self) -> usize {
        self.0.horizon()
    }
    fn param_dim(&self) -> usize {
        self.0.param_dim()
    }
    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        self.0.start(rng, start);
    }
    fn observation_dim(&self) -> Option<usize> {
        self.0.observation_dim()
    }
    fn observe<S: Scalar>(&self, inputs: Inputs<'_, S>, y: &mut [S]) {
        self.0.observe(inputs, y);
    }
    fn running_cost<S: Scalar>(&self, inputs: Inputs<'_, S>, next: &[S]) -> S {
        self.0.running_cost(inputs, next)
    }
    fn terminal_cost<S: Scalar>(&self, x: &[S], p: &[S]) -> S {
        self.0.terminal_cost(x, p)
    }
}

#[test]
fn step_derivatives_agree_with_dual_numbers_for_all_inputs() {
    check::system(&tracking::<1>()).unwrap();
    check::system(&tracking::<3>()).unwrap();
}

#[test]
fn rollout_gradients_of_every_flow_agree_with_dual_numbers() {
    check::task(&tracking::<1>(), &Mlp::new([3, 7, 1])).unwrap();
    check::task(&tracking::<2>(), &Mlp::new([3, 7, 2])).unwrap();
    check::task(&ByDuals(tracking::<1>()), &Linear::with_bias(3, 1)).unwrap();
    check::task(&ByDuals(tracking::<2>()), &Linear::with_bias(3, 2)).unwrap();
}

#[test]
fn rollout_checks_find_wrong_derivatives_of_observations_and_costs() {
    let passes = |fault: Fault| {
        let (task, policy) = (Tracking::<1> { fault }, Linear::with_bias(3, 1));
        Flow::ALL.map(|flow| check::flow(&task, &policy, flow, None).is_ok())
    };
    assert_eq!(passes(Fault::None), [true; 4]);
    // M and S detach the observation.
    assert_eq!(passes(Fault::Observation), [false, true, false, true]);
    // No flow detaches a cost.
    assert_eq!(passes(Fault::CostOfState), [false; 4]);
    // These faults affect the gradient with respect to p, not the gradient with respect to θ.
    assert_eq!(passes(Fault::ObservationOfParams), [false, true, false, true]);
    assert_eq!(passes(Fault::CostOfParams), [false; 4]);
}

#[test]
fn check_cost_names_the_wrong_method_and_output() {
    let what = |failure: Failure| failure.mismatch().expect("a finite cost").what.clone();
    let found = |fault: Fault| check::cost(&Tracking::<1> { fault }).map_err(what);
    assert!(found(Fault::None).is_ok() && check::cost(&ByDuals(tracking::<2>())).is_ok());
    let names = |fault: Fault, name: &str| assert_eq!(found(fault), Err(name.to_owned()));
    assert!(check::cost(&DynTask::new(tracking::<2>())).is_ok());
    let boxed =
        check::cost(&DynTask::new(Tracking::<1> { fault: Fault::Observation })).map_err(what);
    assert_eq!(boxed, Err("observe_vjp: x_bar".to_owned()));
    names(Fault::Observation, "observe_vjp: x_bar");
    names(Fault::ObservationOfParams, "observe_vjp: p_bar");
    names(Fault::CostOfState, "running_cost_gradient: x_bar");
    names(Fault::CostOfParams, "running_cost_gradient: p_bar");
    names(Fault::CostOfControlAlone, "running_cost_gradient with u alone requested: u_bar");
    names(Fault::Unwritten, "observe leaves a component unwritten: y");
    names(Fault::LateCost, "running_cost_gradient: next_bar");
    names(Fault::Overwrites, "terminal_cost_gradient, second call that adds: x_bar");
    let message =
        |fault: Fault| check::cost(&Tracking::<1> { fault }).expect_err("a mismatch").to_string();
    assert!(message(Fault::CostOfState).contains(": relative error "));
    let bitwise = message(Fault::Unwritten);
    assert!(
        bitwise.contains(": both must be equal, but differ by ") && !bitwise.contains("relative"),
        "{bitwise}"
    );
}

#[test]
#[should_panic(expected = "the task's derivatives are wrong: observe_vjp: p_bar[1] is")]
fn check_cost_panics_with_the_wrong_method_and_component() {
    check::cost(&Tracking::<1> { fault: Fault::ObservationOfParams }).unwrap();
}

#[test]
#[should_panic(expected = "gradient by the parameters p of sample 0, component[0] is")]
fn check_flow_panics_with_sample_and_index_of_a_wrong_gradient_of_p() {
    let task = Tracking::<1> { fault: Fault::CostOfParams };
    let policy = WithParams::new(Constant::new(3, 1), []);
    check::flow(&task, &policy, Flow::REGULAR, None).unwrap();
}

/// Declares an observation with the dimension of the state, and does not override the default
/// `observe`.
struct Copied(Tracking<1>);

/// Declares no observation: the policy observes the state.
struct Plain(Tracking<1>);

macro_rules! forwarding_task {
    ($name:ident, $($observation:tt)*) => {
        impl Task for $name {
            type System = Tracking<1>;
            fn system(&self) -> &Tracking<1> {
                &self.0
            }
            fn horizon(&self) -> usize {
                9
            }
            fn param_dim(&self) -> usize {
                2
            }
            fn start(&self, rng: &mut Rng, start: Start<'_>) {
                self.0.start(rng, start);
            }
            fn running_cost<S: Scalar>(&self, inputs: Inputs<'_, S>, next: &[S]) -> S {
                self.0.running_cost(inputs, next)
            }
            $($observation)*
        }
    };
}
forwarding_task!(Plain,);
forwarding_task!(
    Copied,
    fn observation_dim(&self) -> Option<usize> {
        Some(2)
    }
);

/// Bits of the loss and of the gradients of M and R.
pub fn gradients<T: Task, P: Policy>(task: &T, policy: &P, workers: usize) -> Vec<u64> {
    let weights = Weights::<f64>::init(policy, &mut stream(0, Purpose::Policy, 0));
    let starts: Vec<f64> = initial_states(task, 0, Purpose::Train, 21);
    let flows = [Flow::MODIFIED, Flow::REGULAR];
    let mut batch = Batch::new(task, policy, 21, &flows, workers);
    let loss = batch.run(task, policy, &weights, &starts).expect("finite");
    let gradients = batch.gradients().iter().flat_map(Gradient::to_vec);
    std::iter::once(loss).chain(gradients).map(f64::to_bits).collect()
}

#[test]
fn observing_the_whole_state_gives_the_bits_of_no_observation() {
    let policy = Mlp::new([2, 7, 1]);
    assert_eq!(
        gradients(&Copied(tracking()), &policy, 1),
        gradients(&Plain(tracking()), &policy, 1)
    );
}

#[test]
fn a_network_chosen_at_run_time_has_the_bits_of_the_network() {
    let mlp = Mlp::new([3, 7, 1]);
    let chosen = DynPolicy::new(mlp.clone());
    assert_eq!(gradients(&tracking::<1>(), &chosen, 1), gradients(&tracking::<1>(), &mlp, 1));
    let (task, conv) = (Quantum { horizon: 5, ..Quantum::new(3) }, Conv::new(32, 4));
    let chosen = DynPolicy::new(conv.clone());
    assert_eq!(gradients(&task, &chosen, 1), gradients(&task, &conv, 1));
    check::policy(&DynPolicy::new(mlp)).unwrap();
}

#[test]
fn bits_do_not_depend_on_workers_and_stored_bytes_are_exact() {
    check_bits_and_bytes(&Mlp::new([3, 7, 1]));
    check_bits_and_bytes(&WithParams::new(Mlp::new([3, 7, 1]), [TrainedParam::log(0, 0.8)]));
}

fn check_bits_and_bytes(policy: &impl Policy) {
    let one = gradients(&tracking::<1>(), policy, 1);
    for workers in [2, 3] {
        assert_eq!(gradients(&tracking::<1>(), policy, workers), one);
    }
    let (task, flows) = (tracking::<1>(), [Flow::MODIFIED, Flow::REGULAR]);
    for schedule in [Schedule::store_all(9), Schedule::new(9, 129, 1)] {
        let rollout = Checkpointed::<f32>::new(&task, policy, 21, &flows, schedule);
        assert_eq!(
            Checkpointed::<f32>::bytes_of(&task, policy, 21, &flows, &schedule),
            rollout.stored_bytes()
        );
    }
}

#[test]
fn gradients_of_trained_parameters_are_exact_for_every_scale_and_flow() {
    let trained = [TrainedParam::log(0, 0.8), TrainedParam::bounded(1, 0.2, -1.0, 0.5)];
    check::task(&tracking::<1>(), &WithParams::new(Linear::with_bias(3, 1), trained)).unwrap();
    check::task(&tracking::<2>(), &WithParams::new(Gru::new(3, 2, 2), trained)).unwrap();
    check::task(
        &ByDuals(tracking::<2>()),
        &WithParams::new(Mlp::new([3, 4, 2]), [TrainedParam::linear(1, 0.3)]),
    )
    .unwrap();
    for flow in [Flow::REGULAR.truncated(4), Flow::MODIFIED.discounted(0.8)] {
        let policy = WithParams::new(Linear::with_bias(3, 1), trained);
        check::flow(&tracking::<1>(), &policy, flow, None)
            .unwrap_or_else(|failure| panic!("{flow}: {failure}"));
    }
    // The gradients of trained parameters include the gradients with respect to p.
    let faulty = Tracking::<1> { fault: Fault::CostOfParams };
    assert!(
        check::flow(
            &faulty,
            &WithParams::new(Linear::with_bias(3, 1), trained),
            Flow::REGULAR,
            None
        )
        .is_err()
    );
}

#[test]
fn the_cost_depends_on_the_trained_value_not_on_the_drawn_one() {
    let policy =
        WithParams::new(Linear::with_bias(3, 1), [TrainedParam::bounded(0, 1.25, 1.0, 2.0)]);
    let weights = Weights::<f64>::init(&policy, &mut stream(0, Purpose::Policy, 0));
    assert!((policy.values(weights.theta())[0] - 1.25).abs() < 1e-15);
    let cost = |drawn: f64| {
        let mut rollout = Rollout::new(&tracking::<1>(), &policy, 1);
        rollout.start(&[0.5, -0.2, drawn, 0.1]);
        rollout.run(&tracking::<1>(), &policy, &weights).expect("finite");
        rollout.cost(0)
    };
    assert_eq!(cost(0.5), cost(9.0));
}

#[test]
#[should_panic(expected = "the policy trains p[2], but the task has 2 parameters")]
fn training_p_2_of_a_task_with_2_parameters_is_refused() {
    check::task(
        &tracking::<1>(),
        &WithParams::new(Linear::with_bias(3, 1), [TrainedParam::linear(2, 1.0)]),
    )
    .unwrap();
}

//! Derivative calls of a rollout: no flow evaluates derivatives of a path that the flow omits.

use physgrad::policy::{Action, Mlp, Observed, PolicyPass, PolicyRecord, Sizes};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::tasks::{CartPole, Guidance};
use physgrad::{
    Adjoint, Cotangent, Cotangents, Float, Flow, Gradient, Inputs, Policy, Real, Rollout, Scalar,
    Start, System, Task, Weights, initial_states,
};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Counter of calls.
#[derive(Default)]
struct Calls(AtomicUsize);

impl Calls {
    fn note(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
    /// Returns the count and resets it.
    fn take(&self) -> usize {
        self.0.swap(0, Ordering::Relaxed)
    }
}

/// Task and system that count calls.
struct WatchedTask<T> {
    inner: T,
    step: Calls,
    vjp: Calls,
    vjp_state: Calls,
    vjp_control: Calls,
    running_cost_gradient: Calls,
    terminal_cost_gradient: Calls,
}

/// Numbers of calls to a task.
#[derive(Debug, PartialEq, Default)]
struct OfTask {
    step: usize,
    vjp: usize,
    vjp_state: usize,
    vjp_control: usize,
    running_cost_gradient: usize,
    terminal_cost_gradient: usize,
}

impl<T> WatchedTask<T> {
    fn new(inner: T) -> Self {
        let [step, vjp, vjp_state, vjp_control, running_cost_gradient, terminal_cost_gradient] =
            Default::default();
        Self {
            inner,
            step,
            vjp,
            vjp_state,
            vjp_control,
            running_cost_gradient,
            terminal_cost_gradient,
        }
    }

    fn take(&self) -> OfTask {
        OfTask {
            step: self.step.take(),
            vjp: self.vjp.take(),
            vjp_state: self.vjp_state.take(),
            vjp_control: self.vjp_control.take(),
            running_cost_gradient: self.running_cost_gradient.take(),
            terminal_cost_gradient: self.terminal_cost_gradient.take(),
        }
    }
}

impl<T: Task> System for WatchedTask<T> {
    fn state_dim(&self) -> usize {
        self.inner.system().state_dim()
    }
    fn control_dim(&self) -> usize {
        self.inner.system().control_dim()
    }
    fn step<S: Scalar>(&self, inputs: Inputs<'_, S>, next: &mut [S]) {
        self.step.note();
        self.inner.system().step(inputs, next);
    }
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        match (&cotangents.x, &cotangents.u) {
            (Some(_), Some(_)) => &self.vjp,
            (Some(_), None) => &self.vjp_state,
            _ => &self.vjp_control,
        }
        .note();
        self.inner.system().vjp(inputs, next_bar, cotangents);
    }
}

impl<T: Task> Task for WatchedTask<T> {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        self.inner.horizon()
    }
    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        self.inner.start(rng, start);
    }
    fn running_cost<S: Scalar>(&self, inputs: Inputs<'_, S>, next: &[S]) -> S {
        self.inner.running_cost(inputs, next)
    }
    fn terminal_cost<S: Scalar>(&self, x: &[S], p: &[S]) -> S {
        self.inner.terminal_cost(x, p)
    }
    fn running_cost_gradient<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        next: &[R],
        cotangents: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        self.running_cost_gradient.note();
        self.inner.running_cost_gradient(inputs, next, cotangents, next_bar);
    }
    fn terminal_cost_gradient<R: Real>(
        &self,
        x: &[R],
        p: &[R],
        x_bar: &mut [R],
        p_bar: Option<&mut [R]>,
    ) {
        self.terminal_cost_gradient.note();
        self.inner.terminal_cost_gradient(x, p, x_bar, p_bar);
    }
}

/// Policy that counts calls.
struct WatchedPolicy {
    inner: Mlp,
    forward: Calls,
    backward_with_inputs: Calls,
    backward_without: Calls,
    param_gradient: Calls,
}

/// Numbers of calls to a policy.
#[derive(Debug, PartialEq, Default)]
struct OfPolicy {
    forward: usize,
    backward_with_inputs: usize,
    backward_without: usize,
    param_gradient: usize,
}

impl WatchedPolicy {
    fn new(inner: Mlp) -> Self {
        let [forward, backward_with_inputs, backward_without, param_gradient] = Default::default();
        Self { inner, forward, backward_with_inputs, backward_without, param_gradient }
    }

    fn take(&self) -> OfPolicy {
        OfPolicy {
            forward: self.forward.take(),
            backward_with_inputs: self.backward_with_inputs.take(),
            backward_without: self.backward_without.take(),
            param_gradient: self.param_gradient.take(),
        }
    }
}

impl Policy for WatchedPolicy {
    fn observation_dim(&self) -> usize {
        self.inner.observation_dim()
    }
    fn control_dim(&self) -> usize {
        self.inner.control_dim()
    }
    fn param_count(&self) -> usize {
        self.inner.param_count()
    }
    fn init(&self, rng: &mut Rng, theta: &mut [f64]) {
        self.inner.init(rng, theta);
    }
    fn act<T: Scalar>(&self, theta: &[T], observed: Observed<'_, T>, action: Action<'_, T>) {
        self.inner.act(theta, observed, action);
    }
    fn sizes<F: Float>(&self, columns: usize) -> Sizes {
        self.inner.sizes::<F>(columns)
    }
    fn pack<F: Float>(&self, theta: &[F], packed: &mut [F]) {
        self.inner.pack(theta, packed);
    }
    fn forward<F: Float>(&self, pass: PolicyPass<F>, tape: &mut [F], u: &mut [F]) {
        self.forward.note();
        self.inner.forward(pass, tape, u);
    }
    fn backward<F: Float>(
        &self,
        pass: PolicyPass<F>,
        tape: &[F],
        u_bar: &[F],
        tape_bar: &mut [F],
        x_bar: Option<&mut [F]>,
    ) {
        if x_bar.is_some() { &self.backward_with_inputs } else { &self.backward_without }.note();
        self.inner.backward(pass, tape, u_bar, tape_bar, x_bar);
    }
    fn param_gradient<F: Float>(
        &self,
        pass: PolicyPass<F>,
        record: PolicyRecord<F>,
        scratch: &mut [F],
        theta_bar: &mut [F],
    ) {
        self.param_gradient.note();
        self.inner.param_gradient(pass, record, scratch, theta_bar);
    }
}

/// Number of steps.
const T: usize = 5;
/// Number of blocks of eight samples.
const B: usize = 3;
/// Number of samples. The last block has one sample.
const SAMPLES: usize = 17;

/// Returns the calls of the forward pass, then the calls of the reverse pass with the gradients of
/// `flows`. Without flows, the rollout is an evaluation.
fn calls_of<S: Task>(task: S, flows: &[Flow]) -> [(OfTask, OfPolicy); 2] {
    let task = WatchedTask::new(task);
    let (n, m) = (task.state_dim(), task.control_dim());
    let policy = WatchedPolicy::new(Mlp::new([n, 8, m]));
    let weights = Weights::<f64>::init(&policy, &mut stream(0, Purpose::Policy, 0));
    let starts: Vec<f64> = initial_states(&task, 0, Purpose::Train, SAMPLES);

    let with_tape = !flows.is_empty();
    let make = if with_tape { Rollout::new } else { Rollout::for_evaluation };
    let mut rollout = make(&task, &policy, SAMPLES);
    rollout.start(&starts);
    rollout.run(&task, &policy, &weights).expect("finite");
    let forward = (task.take(), policy.take());
    if with_tape {
        let mut adjoint = Adjoint::new(&task, &policy, &rollout, flows);
        adjoint.run(&task, &policy, &weights, &rollout, 1.0).expect("finite");
        let mut theta_bar = Gradient::zeros(weights.theta().len());
        for k in 0..flows.len() {
            adjoint.param_gradient(k, &policy, &weights, &rollout, 0..SAMPLES, &mut theta_bar);
            assert!(theta_bar.values().iter().any(|&g| g != 0.0), "the gradient is 0");
        }
    }
    [forward, (task.take(), policy.take())]
}

/// Calls of a forward pass: one step of the physics per block and time step, one policy call per
/// time step.
fn one_forward_pass() -> (OfTask, OfPolicy) {
    (OfTask { step: T * B, ..OfTask::default() }, OfPolicy { forward: T, ..OfPolicy::default() })
}

fn one_control() -> CartPole {
    CartPole { horizon: T, ..CartPole::new(1) }
}

fn two_controls() -> Guidance {
    Guidance { horizon: T, ..Guidance::new(1, 1) }
}

/// Calls of the cost gradients for any number of flows: the running cost once per block and step,
/// the terminal cost once per block.
fn costs() -> OfTask {
    OfTask { running_cost_gradient: T * B, terminal_cost_gradient: B, ..OfTask::default() }
}

/// Calls of the physics and the costs for a flow through the state: one call per block and step
/// returns both derivatives of the physics.
fn both() -> OfTask {
    OfTask { vjp: T * B, ..costs() }
}

/// Calls of the physics and the costs for a flow that needs only the derivative of the physics with
/// respect to the control.
fn control_alone() -> OfTask {
    OfTask { vjp_control: T * B, ..costs() }
}

fn policy(backward_with_inputs: usize, backward_without: usize, param_gradient: usize) -> OfPolicy {
    OfPolicy { forward: 0, backward_with_inputs, backward_without, param_gradient }
}

#[test]
fn an_evaluation_evaluates_no_derivative() {
    for all in [calls_of(one_control(), &[]), calls_of(two_controls(), &[])] {
        assert_eq!(all, [one_forward_pass(), Default::default()]);
    }
}

#[test]
fn with_one_control_one_policy_call_covers_the_derivatives_of_all_steps() {
    // One call computes the policy's input derivatives at all steps if any flow passes through the
    // policy's input. Otherwise, each flow has one call for all steps.
    for (flows, physics, network) in [
        (&[Flow::REGULAR][..], both(), policy(1, 0, 1)),
        (&[Flow::MODIFIED], both(), policy(0, 1, 1)),
        (&[Flow::NETWORK], control_alone(), policy(1, 0, 1)),
        (&[Flow::STOPPED], control_alone(), policy(0, 1, 1)),
        (&[Flow::MODIFIED, Flow::REGULAR], both(), policy(1, 0, 2)),
        (&[Flow::MODIFIED, Flow::STOPPED], both(), policy(0, 2, 2)),
    ] {
        assert_eq!(
            calls_of(one_control(), flows),
            [one_forward_pass(), (physics, network)],
            "{flows:?}"
        );
    }
}

#[test]
fn with_two_controls_each_step_has_one_policy_call_for_input_derivatives() {
    // A flow through the policy's input needs one call at each step. Each other flow needs one call
    // for all steps.
    for (flows, physics, network) in [
        (&[Flow::REGULAR][..], both(), policy(T, 0, 1)),
        (&[Flow::MODIFIED], both(), policy(0, 1, 1)),
        (&[Flow::NETWORK], control_alone(), policy(T, 0, 1)),
        (&[Flow::STOPPED], control_alone(), policy(0, 1, 1)),
        (&[Flow::MODIFIED, Flow::REGULAR], both(), policy(T, 1, 2)),
        (&[Flow::NETWORK, Flow::REGULAR], both(), policy(2 * T, 0, 2)),
    ] {
        assert_eq!(
            calls_of(two_controls(), flows),
            [one_forward_pass(), (physics, network)],
            "{flows:?}"
        );
    }
}

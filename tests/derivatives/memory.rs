//! Policies with a memory or a dependence on time: recurrent policies, control sequences, the
//! memory path of flows.

use physgrad::engine::{Checkpointed, Schedule};
use physgrad::policy::{Action, Elman, Gru, Observed, OpenLoop, PolicyPass, PolicyRecord, Sizes};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::{
    Divergence, Float, Flow, Gradient, Inputs, Policy, Scalar, Start, System, Task, Weights, check,
    initial_states,
};
use rand::RngExt;

/// A pendulum whose observation is the angle only.
pub struct AngleOnly;

impl System for AngleOnly {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[1] = x[1] + (u[0] - x[0].sin() * 4.0) * 0.1;
        next[0] = x[0] + next[1] * 0.1;
    }
}

impl Task for AngleOnly {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        12
    }
    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x.fill_with(|| rng.random_range(-1.0..1.0));
    }
    fn observation_dim(&self) -> Option<usize> {
        Some(1)
    }
    fn observe<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, y: &mut [T]) {
        y[0] = x[0];
    }
    fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, next: &[T]) -> T {
        next[0] * next[0] + u[0] * u[0] * 0.1
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        x[1] * x[1]
    }
}

/// Pendulum of [`AngleOnly`] with the whole state observed and two controls.
pub struct Whole;

impl System for Whole {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        2
    }
    fn step<T: Scalar>(&self, Inputs { x, u, t, .. }: Inputs<'_, T>, next: &mut [T]) {
        AngleOnly.step(Inputs { x, u: &[u[0] + u[1] * x[1]], p: &[], t }, next);
    }
}

impl Task for Whole {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        11
    }
    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x.fill_with(|| rng.random_range(-1.0..1.0));
    }
    fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, next: &[T]) -> T {
        next[0] * next[0] + u[1] * u[1]
    }
}

/// Feedback that depends on a memory and on time, with default batched passes.
struct Integral;

impl Policy for Integral {
    fn observation_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn memory_dim(&self) -> usize {
        2
    }
    fn param_count(&self) -> usize {
        3
    }
    fn init(&self, rng: &mut Rng, theta: &mut [f64]) {
        theta.fill_with(|| rng.random_range(-0.5..0.5));
    }
    fn act<T: Scalar>(
        &self,
        theta: &[T],
        Observed { y, memory, t }: Observed<'_, T>,
        action: Action<'_, T>,
    ) {
        action.memory[0] = memory[0] * 0.9 + y[0];
        action.memory[1] = y[0];
        action.u[0] = theta[0] * y[0]
            + theta[1] * action.memory[0].tanh()
            + theta[2] * (y[0] - memory[1]) * (t as f64 * 0.1);
    }
}

/// A policy whose backward pass omits the cotangent of the memory.
struct Forgetting<P>(P);

impl<P: Policy> Policy for Forgetting<P> {
    fn observation_dim(&self) -> usize {
        self.0.observation_dim()
    }
    fn control_dim(&self) -> usize {
        self.0.control_dim()
    }
    fn memory_dim(&self) -> usize {
        self.0.memory_dim()
    }
    fn param_count(&self) -> usize {
        self.0.param_count()
    }
    fn init(&self, rng: &mut Rng, theta: &mut [f64]) {
        self.0.init(rng, theta);
    }
    fn act<T: Scalar>(&self, theta: &[T], observed: Observed<'_, T>, action: Action<'_, T>) {
        self.0.act(theta, observed, action);
    }
    fn sizes<F: Float>(&self, columns: usize) -> Sizes {
        self.0.sizes::<F>(columns)
    }
    fn forward<F: Float>(&self, pass: PolicyPass<F>, tape: &mut [F], u: &mut [F]) {
        self.0.forward(pass, tape, u);
    }
    fn backward<F: Float>(
        &self,
        pass: PolicyPass<F>,
        tape: &[F],
        u_bar: &[F],
        tape_bar: &mut [F],
        mut x_bar: Option<&mut [F]>,
    ) {
        self.0.backward(pass, tape, u_bar, tape_bar, x_bar.as_deref_mut());
        let (y, inputs) = (self.observation_dim(), self.observation_dim() + self.memory_dim());
        if let Some(x_bar) = x_bar {
            pass.at.iter().for_each(|c| x_bar[c * inputs + y..][..inputs - y].fill(F::zero()));
        }
    }
    fn param_gradient<F: Float>(
        &self,
        pass: PolicyPass<F>,
        record: PolicyRecord<F>,
        scratch: &mut [F],
        theta_bar: &mut [F],
    ) {
        self.0.param_gradient(pass, record, scratch, theta_bar);
    }
}

#[test]
fn batched_passes_of_policies_with_memory_agree_with_act() {
    for (observations, units, controls) in [(1, 1, 1), (2, 8, 1), (3, 5, 2), (4, 40, 3)] {
        check::policy(&Gru::new(observations, units, controls)).unwrap();
        check::policy(&Elman::new(observations, units, controls)).unwrap();
    }
    check::policy(&Integral).unwrap();
    check::policy(&OpenLoop::new(3, 2, 20)).unwrap();
}

#[test]
fn rollout_gradients_of_every_flow_agree_with_dual_numbers() {
    check::task(&AngleOnly, &Gru::new(1, 6, 1)).unwrap();
    check::task(&AngleOnly, &Elman::new(1, 3, 1)).unwrap();
    check::task(&AngleOnly, &Integral).unwrap();
    check::task(&AngleOnly, &OpenLoop::new(1, 1, 12)).unwrap();
    check::task(&Whole, &Gru::new(2, 3, 2)).unwrap();
    check::task(&Whole, &Elman::new(2, 9, 2)).unwrap();
    check::task(&Whole, &OpenLoop::new(2, 2, 11)).unwrap();
}

#[test]
#[should_panic(expected = "backward: x_bar")]
fn check_policy_finds_an_omitted_cotangent_of_the_memory() {
    check::policy(&Forgetting(Gru::new(1, 3, 1))).unwrap();
}

#[test]
#[should_panic(expected = "flow")]
fn check_task_finds_an_omitted_cotangent_of_the_memory() {
    check::task(&AngleOnly, &Forgetting(Gru::new(1, 3, 1))).unwrap();
}

#[test]
#[should_panic(expected = "controls for 11 steps, but the rollout has more")]
fn a_sequence_of_11_controls_is_refused_for_12_steps() {
    check::task(&AngleOnly, &OpenLoop::new(1, 1, 11)).unwrap();
}

/// Gradient of `flow` over eleven samples. The schedule stores all steps, because the horizon is
/// shorter than one unit.
fn gradient(policy: &impl Policy, flow: Flow) -> Vec<f64> {
    let mut rng = stream(1, Purpose::Policy, 0);
    let weights = Weights::<f64>::init(policy, &mut rng);
    let mut gradients = [vec![Gradient::zeros(policy.param_count())]];
    let mut rollout = Checkpointed::new(
        &AngleOnly,
        policy,
        11,
        &[flow],
        Schedule::binomial(AngleOnly.horizon(), 2),
    );
    let starts = initial_states(&AngleOnly, 0, Purpose::Train, 11);
    rollout.run(&AngleOnly, policy, &weights, &starts, 1.0, 11, &mut gradients).expect("finite");
    gradients[0][0].to_vec()
}

/// Recurrent weights multiply the memory, so they have a gradient in every flow. The memory path
/// adds their effects on later steps.
#[test]
fn recurrent_weights_have_a_gradient_in_every_flow_and_memory_changes_m() {
    let (units, policy) = (4, Elman::new(1, 4, 1));
    let recurrent = units..units + units * units;
    let norm =
        |flow| gradient(&policy, flow)[recurrent.clone()].iter().map(|g| g * g).sum::<f64>().sqrt();
    let without = Flow { memory: 0.0, ..Flow::MODIFIED };
    // S and `without` treat the memory of the step before as a constant. They omit the effects of a
    // weight on later steps through the memory, but not its effect on the present step.
    for (flow, name) in
        [(Flow::REGULAR, "R"), (Flow::MODIFIED, "M"), (Flow::NETWORK, "N"), (Flow::STOPPED, "S")]
    {
        assert!(norm(flow) > 0.0, "{name}");
    }
    assert_ne!(gradient(&policy, Flow::MODIFIED), gradient(&policy, without));
    assert_eq!(
        gradient(&policy, Flow::STOPPED),
        gradient(&policy, Flow { memory: 0.0, ..Flow::STOPPED })
    );
}

/// Policy whose memory grows by a factor of 1e200 per step. The control does not use the memory.
struct Exploding;

impl Policy for Exploding {
    fn observation_dim(&self) -> usize {
        1
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
        theta[0] = 1.0;
    }
    fn act<T: Scalar>(
        &self,
        theta: &[T],
        Observed { y, memory, .. }: Observed<'_, T>,
        action: Action<'_, T>,
    ) {
        action.u[0] = y[0] * theta[0];
        action.memory[0] = (memory[0] + 1.0) * 1e200;
    }
}

#[test]
fn a_diverging_memory_is_named() {
    let weights = Weights::<f64>::new(&Exploding, vec![1.0]);
    let mut gradients = [vec![Gradient::zeros(1)]];
    let mut rollout =
        Checkpointed::new(&AngleOnly, &Exploding, 3, &[Flow::MODIFIED], Schedule::store_all(12));
    let starts = initial_states(&AngleOnly, 0, Purpose::Train, 3);
    let divergence: Divergence = rollout
        .run(&AngleOnly, &Exploding, &weights, &starts, 1.0, 3, &mut gradients)
        .expect_err("the memory overflows");
    assert!(divergence.to_string().contains("memory"), "{divergence}");
}

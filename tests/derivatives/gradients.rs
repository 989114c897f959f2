//! Gradients of systems, tasks and policies agree with dual numbers. Checks find planted faults.

use num_traits::AsPrimitive;
use physgrad::policy::{
    Action, Activation, Bounded, Conv, Gru, Linear, Mlp, Observed, OpenLoop, PolicyPass,
    PolicyRecord, Sizes, Sum, Tensor,
};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::scalar::CotangentPack;
use physgrad::tasks::{CartPole, CartPoleSystem, LossMode, Quantum};
use physgrad::{
    Cotangent, Cotangents, Float, Flow, Inputs, Policy, Real, Scalar, Start, System, Tangents,
    Task, check,
};
use rand::RngExt;

#[test]
fn cart_pole_derivatives_are_exact_for_1_2_3_and_7_poles() {
    for poles in [1, 2, 3, 7] {
        check::system(&CartPole::new(poles).system).unwrap();
    }
}

#[test]
fn cart_pole_derivatives_are_exact_up_to_30_in_state_and_100_n_in_force() {
    let draw = |rng: &mut Rng, x: &mut [f64], u: &mut [f64], _: &mut [f64]| {
        x.fill_with(|| rng.random_range(-30.0..30.0));
        u.fill_with(|| rng.random_range(-100.0..100.0));
    };
    let passed = check::system_at(&CartPole::new(2).system, draw)
        .unwrap_or_else(|mismatch| panic!("{mismatch}"));
    assert!(passed.compared > 0 && passed.worst <= passed.allowed);
}

#[test]
fn policy_derivatives_are_exact_for_many_shapes_and_activations() {
    for widths in [
        &[1, 1][..],
        &[3, 2],
        &[2, 5, 1],
        &[10, 100, 100, 1],
        &[4, 31, 33, 17, 3],
        &[5, 16, 15, 64, 2],
    ] {
        for bias in [false, true] {
            check::policy(&Mlp::new(widths).bias(bias)).unwrap();
        }
    }
    check::policy(&Linear::new(3, 2)).unwrap();
    check::policy(&Linear::with_bias(4, 1)).unwrap();
    for activation in [Activation::Relu, Activation::Silu, Activation::Gelu] {
        for bias in [true, false] {
            check::policy(&Mlp::new([3, 40, 7, 2]).activation(activation).bias(bias)).unwrap();
            check::policy(&Mlp::new([2, 100, 1]).activation(activation).bias(bias)).unwrap();
        }
    }
    let inner = Mlp::new([3, 9, 2]).activation(Activation::Silu);
    check::policy(&Bounded::new(inner.clone(), [0.5, 2.0])).unwrap();
    check::policy(&Bounded::new(Gru::new(3, 4, 2), [0.5, 2.0])).unwrap();
    check::policy(&Sum::new(Linear::new(3, 2), OpenLoop::new(3, 2, 5))).unwrap();
    check::policy(&Sum::new(Bounded::new(inner, [1.0, 0.1]), Mlp::new([3, 5, 4, 2]))).unwrap();
}

#[test]
fn rollout_gradients_of_every_flow_agree_with_dual_numbers() {
    for loss in [LossMode::Terminal, LossMode::Running] {
        let task = CartPole { loss, ..CartPole::new(2) };
        check::task(&task, &Mlp::new([6, 24, 24, 1])).unwrap();
        check::task(&task, &Linear::with_bias(6, 1)).unwrap();
    }
}

/// Nonlinear system with three states, two controls and no analytic derivatives. The costs depend
/// on state and control.
struct TwoControls;

impl System for TwoControls {
    fn state_dim(&self) -> usize {
        3
    }
    fn control_dim(&self) -> usize {
        2
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        let dt = T::from(0.1);
        next[0] = x[0] + x[1] * dt;
        next[1] = x[1] + (u[0] * x[2].cos() - x[0].max(T::zero()) * 2.0) * dt;
        next[2] = x[2] + (u[1].tanh() - x[2] * x[1]) * dt;
    }
}

impl Task for TwoControls {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        25
    }
    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x.fill_with(|| rng.random_range(-1.0..1.0));
    }
    fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, x: &[T]) -> T {
        x[0] * x[0] + (u[0] * u[1]).exp() * 0.01 + u[0] * x[2]
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        (x[1] * x[1] + T::one()).sqrt() + x[2].atan2(T::from(2.0))
    }
}

#[test]
fn default_derivatives_of_a_system_with_two_controls_are_exact() {
    check::system(&TwoControls).unwrap();
    check::task(&TwoControls, &Mlp::new([3, 9, 7, 2])).unwrap();
    check::task(&TwoControls, &Linear::with_bias(3, 2)).unwrap();
}

/// Cart-pole with one planted fault.
struct Faulty {
    system: CartPoleSystem,
    fault: Fault,
}

#[derive(Clone, Copy, PartialEq)]
enum Fault {
    /// Component 3 of `x_bar` has a relative error of a millionth.
    State,
    /// `u_bar` has the wrong sign.
    Control,
    /// `u_bar` is wrong if requested alone.
    ControlAlone,
    /// `vjp` overwrites `x_bar` instead of adding to it.
    Overwrite,
    /// The step does not write component 1.
    Unwritten,
    /// Component 2 of `x_bar` is NaN.
    NaN,
    /// `x_bar` is correct for scalars, but wrong in lanes.
    Lanes,
    /// `jvp` adds to its output.
    JvpAdds,
    /// `jvp` ignores the control if there is a tangent of the state.
    JvpOfOne,
    /// The step takes the square root of a negative number.
    Root,
}

impl System for Faulty {
    fn state_dim(&self) -> usize {
        self.system.state_dim()
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        let before = next[1];
        self.system.step(inputs, next);
        if self.fault == Fault::Unwritten {
            next[1] = before;
        }
        if self.fault == Fault::Root {
            next[1] += (-next[1] * next[1] - 1.0).sqrt();
        }
    }
    fn jvp<R: Real>(&self, inputs: Inputs<'_, R>, tangents: Tangents<'_, R>, next_tan: &mut [R]) {
        let before = next_tan.to_vec();
        let u =
            if self.fault == Fault::JvpOfOne && tangents.x.is_some() { None } else { tangents.u };
        self.system.jvp(inputs, Tangents { u, ..tangents }, next_tan);
        if self.fault == Fault::JvpAdds {
            next_tan.iter_mut().zip(before).for_each(|(tangent, before)| *tangent += before);
        }
    }
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let (mut x_part, mut u_part) = ([C::null(); 4], [C::null()]);
        self.system.vjp(inputs, next_bar, Cotangents::of(&mut x_part, &mut u_part));
        match self.fault {
            Fault::State => x_part[3] += x_part[3] * R::from(1e-6),
            Fault::Control => u_part[0] = -u_part[0],
            Fault::ControlAlone if cotangents.x.is_none() => u_part[0] += u_part[0],
            Fault::NaN => x_part[2] = x_part[2] * R::from(f64::NAN),
            Fault::Lanes if R::LANES > 1 => x_part[0] += x_part[1] * R::from(1e-15),
            _ => {}
        }
        let sides = [
            (cotangents.x, &x_part[..], self.fault == Fault::Overwrite),
            (cotangents.u, &u_part, false),
        ];
        for (bar, part, overwrite) in sides {
            for (bar, &part) in bar.into_iter().flatten().zip(part) {
                *bar = if overwrite { part } else { *bar + part };
            }
        }
    }
}

#[test]
fn check_system_names_the_wrong_output_for_nine_planted_faults() {
    for (fault, what, index) in [
        (Fault::State, "vjp: x_bar", 3),
        (Fault::Control, "vjp: u_bar", 0),
        (Fault::ControlAlone, "vjp with only some cotangents requested: u_bar", 0),
        (Fault::Overwrite, "vjp, second call that adds: x_bar", 0),
        (Fault::Unwritten, "step leaves a component unwritten: next", 1),
        (Fault::NaN, "vjp: x_bar", 2),
        (Fault::Lanes, "vjp in lanes: x_bar", 0),
        (Fault::JvpAdds, "jvp of x", 0),
        (Fault::JvpOfOne, "jvp of x, u and p: next", 0),
    ] {
        let diagnose = Faulty { system: CartPole::new(1).system, fault };
        let failure = check::system(&diagnose).expect_err(what);
        let mismatch = failure.mismatch().expect("a finite step");
        assert_eq!((mismatch.what.as_str(), mismatch.index), (what, index));
        let text = mismatch.to_string();
        assert!(
            text.contains(&format!("{what}[{index}]"))
                && text.contains("expected")
                && text.contains("case"),
            "{text}"
        );
    }
}

#[test]
#[should_panic(expected = "vjp: x_bar[3]")]
fn check_system_panics_and_names_the_wrong_component() {
    check::system(&Faulty { system: CartPole::new(1).system, fault: Fault::State }).unwrap();
}

#[test]
#[should_panic(
    expected = "the system cannot be checked: step is not finite here; draw other states with `system_at`: next[1] is NaN"
)]
fn check_system_names_a_step_that_is_not_finite() {
    check::system(&Faulty { system: CartPole::new(1).system, fault: Fault::Root }).unwrap();
}

#[test]
#[should_panic(expected = "`starts` has 1 numbers; expected one or more samples of")]
fn check_slope_refuses_initial_states_without_parameters() {
    let (task, policy) = (super::inputs::tracking::<1>(), Linear::with_bias(3, 1));
    check::slope_by_duals(&task, &policy, &[0.0; 4], &[0.0], Flow::REGULAR, &|_| 1.0);
}

/// Task whose cost gradient is wrong.
struct WrongCost(CartPole);

impl Task for WrongCost {
    type System = CartPoleSystem;
    fn system(&self) -> &CartPoleSystem {
        &self.0.system
    }
    fn horizon(&self) -> usize {
        self.0.horizon
    }
    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        self.0.start(rng, start);
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        self.0.terminal_cost(x, &[])
    }
    fn terminal_cost_gradient<R: Real>(
        &self,
        x: &[R],
        p: &[R],
        x_bar: &mut [R],
        p_bar: Option<&mut [R]>,
    ) {
        self.0.terminal_cost_gradient(x, p, x_bar, p_bar);
        x_bar[2] *= R::from(1.0 + 1e-6);
    }
}

#[test]
#[should_panic(expected = "in a state of a rollout: terminal_cost_gradient: x_bar[2] is ")]
fn check_task_names_the_method_with_a_relative_error_of_1e_6() {
    check::task(&WrongCost(CartPole::new(1)), &Mlp::new([4, 5, 1])).unwrap();
}

#[test]
#[should_panic(expected = "the gradient of flow R (full backpropagation) is wrong: gradient by ")]
fn check_flow_finds_a_relative_error_of_1e_6_in_a_cost_gradient() {
    let (task, policy) = (WrongCost(CartPole::new(1)), Mlp::new([4, 5, 1]));
    check::flow(&task, &policy, Flow::REGULAR, None).unwrap();
}

/// Linear policy whose reverse pass overwrites `x_bar[1]` with 0. This component is the derivative
/// with respect to the second input of the first column.
struct Forgetting(Linear);

impl Policy for Forgetting {
    fn observation_dim(&self) -> usize {
        self.0.observation_dim()
    }
    fn control_dim(&self) -> usize {
        self.0.control_dim()
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
    fn backward<F: physgrad::Float>(
        &self,
        pass: PolicyPass<F>,
        tape: &[F],
        u_bar: &[F],
        tape_bar: &mut [F],
        mut x_bar: Option<&mut [F]>,
    ) {
        self.0.backward(pass, tape, u_bar, tape_bar, x_bar.as_deref_mut());
        if let Some(x_bar) = x_bar {
            x_bar[1] = F::zero();
        }
    }
}

#[test]
#[should_panic(expected = "backward: x_bar[1]")]
fn check_policy_finds_a_batched_input_derivative_set_to_0() {
    check::policy(&Forgetting(Linear::new(3, 1))).unwrap();
}

/// Convolution with an error in one component of its parameter gradient. The error is a thousandth
/// of the largest magnitude in this gradient.
struct OneOff {
    conv: Conv,
    index: usize,
    /// Overwrites the gradient instead of adding to it, without the error in one component.
    overwrites: bool,
}

impl Policy for OneOff {
    fn observation_dim(&self) -> usize {
        self.conv.observation_dim()
    }
    fn control_dim(&self) -> usize {
        self.conv.control_dim()
    }
    fn param_count(&self) -> usize {
        self.conv.param_count()
    }
    fn init(&self, rng: &mut Rng, theta: &mut [f64]) {
        self.conv.init(rng, theta);
    }
    fn act<T: Scalar>(&self, theta: &[T], observed: Observed<'_, T>, action: Action<'_, T>) {
        self.conv.act(theta, observed, action);
    }
    fn tensors(&self) -> Vec<Tensor> {
        self.conv.tensors()
    }
    fn sizes<F: Float>(&self, columns: usize) -> Sizes {
        self.conv.sizes::<F>(columns)
    }
    fn pack<F: Float>(&self, theta: &[F], packed: &mut [F]) {
        self.conv.pack(theta, packed);
    }
    fn forward<F: Float>(&self, pass: PolicyPass<F>, tape: &mut [F], u: &mut [F]) {
        self.conv.forward(pass, tape, u);
    }
    fn backward<F: Float>(
        &self,
        pass: PolicyPass<F>,
        tape: &[F],
        u_bar: &[F],
        tape_bar: &mut [F],
        x_bar: Option<&mut [F]>,
    ) {
        self.conv.backward(pass, tape, u_bar, tape_bar, x_bar);
    }
    fn param_gradient<F: Float>(
        &self,
        pass: PolicyPass<F>,
        record: PolicyRecord<F>,
        scratch: &mut [F],
        theta_bar: &mut [F],
    ) {
        self.conv.param_gradient(pass, record, scratch, theta_bar);
        if self.overwrites {
            theta_bar.fill(F::zero());
            return self.conv.param_gradient(pass, record, scratch, theta_bar);
        }
        let largest = theta_bar
            .iter()
            .fold(0.0, |largest: f64, &bar| largest.max(AsPrimitive::<f64>::as_(bar).abs()));
        theta_bar[self.index] += F::from_f64(1e-3 * largest);
    }
}

/// Returns a policy with more than 1000 parameters. The check therefore compares only 64 of the 120
/// weights in the first kernel one by one. Directional derivatives detect errors of the others.
fn one_off(index: usize) -> OneOff {
    let conv = Conv::new(32, 20);
    assert!(conv.param_count() > 1000 && conv.tensors()[0].range == (0..120));
    OneOff { conv, index, overwrites: false }
}

#[test]
fn check_policy_finds_a_gradient_that_is_overwritten() {
    let failure =
        check::policy(&OneOff { overwrites: true, ..one_off(0) }).expect_err("a wrong gradient");
    let mismatch = failure.mismatch().expect("a finite gradient");
    assert_eq!(mismatch.what, "param_gradient, second call that adds: theta_bar");
}

#[test]
fn check_policy_names_one_wrong_weight_among_more_than_1000() {
    for index in (0..120).step_by(11) {
        let failure = check::policy(&one_off(index)).expect_err("a wrong gradient");
        let mismatch = failure.mismatch().expect("a finite gradient");
        assert_eq!((mismatch.what.as_str(), mismatch.index), ("param_gradient: theta_bar", index));
        assert!(mismatch.error > 1e-4 && mismatch.error < 2e-3, "{mismatch}");
    }
}

#[test]
fn rollout_checks_find_one_wrong_weight_among_more_than_1000() {
    let task = Quantum { horizon: 5, ..Quantum::new(3) };
    for flow in Flow::ALL {
        let failure = check::flow(&task, &one_off(37), flow, None).expect_err("a wrong gradient");
        assert!(failure.to_string().starts_with("gradient"), "{failure}");
    }
}

#[test]
fn rollout_checks_are_at_the_given_parameters() {
    let (task, conv) = (Quantum { horizon: 5, ..Quantum::new(3) }, Conv::new(32, 20));
    let mut theta = vec![0.0; conv.param_count()];
    conv.init(&mut stream(1, Purpose::Policy, 0), &mut theta);
    let huge = vec![f64::MAX; theta.len()];
    for flow in Flow::ALL {
        let passed = check::flow(&task, &conv, flow, Some(&theta)).expect("correct gradients");
        let others: Vec<f64> = theta.iter().map(|theta| theta * 0.5).collect();
        assert_ne!(
            check::flow(&task, &conv, flow, Some(&others)).expect("correct gradients").worst,
            passed.worst
        );
        let wrong =
            check::flow(&task, &one_off(37), flow, Some(&theta)).expect_err("a wrong gradient");
        assert!(wrong.to_string().starts_with("gradient"), "{wrong}");
        let diverged = check::flow(&task, &conv, flow, Some(&huge));
        assert!(
            diverged.as_ref().is_err_and(|failure| failure.mismatch().is_none()),
            "{diverged:?}"
        );
    }
}

#[test]
fn two_cotangent_columns_have_the_bits_of_each_column_alone() {
    let system = CartPole::new(1).system;
    let (x, u) = ([0.1, -0.2, 3.0, 0.5], [2.0]);
    let cotangents = [[1.0, -0.5, 0.25, 2.0], [0.0, 3.0, -1.0, 0.5]];
    let both: Vec<_> =
        (0..4).map(|i| CotangentPack([cotangents[0][i], cotangents[1][i]])).collect();
    let (mut x_bar, mut u_bar) = ([CotangentPack([0.0; 2]); 4], [CotangentPack([0.0; 2])]);
    system.vjp(Inputs::new(&x, &u), &both, Cotangents::of(&mut x_bar, &mut u_bar));
    for (k, bar) in cotangents.iter().enumerate() {
        let (mut x_alone, mut u_alone) = ([0.0; 4], [0.0]);
        system.vjp(Inputs::new(&x, &u), bar, Cotangents::of(&mut x_alone, &mut u_alone));
        assert_eq!(x_bar.map(|c| c.0[k]), x_alone);
        assert_eq!(u_bar.map(|c| c.0[k]), u_alone);
    }
}

//! Checks of tasks in states of rollouts: in the units of the task, and kinks on the way.

use physgrad::check::{self, KinkInput};
use physgrad::integrator::{AnyIntegrator, ImplicitMidpoint, Sdirk2};
use physgrad::policy::{Constant, Linear, Mlp};
use physgrad::rng::Rng;
use physgrad::{
    Cotangent, Cotangents, DynTask, Flow, Inputs, Integrated, Ode, OdeInputs, Real, Scalar, Start,
    System, Task, Trainer, Training, Weights,
};
use rand::RngExt;

/// Stirred reactor with an exothermic reaction. Equations and numbers: Seborg, Edgar, Mellichamp and
/// Doyle, Process Dynamics and Control, example 2.5. State [c mol/l, T K], control: temperature of
/// the coolant minus 300 K, in 0.01 K. Euler steps of 0.005 min.
#[derive(Clone, Copy)]
struct Reactor {
    /// Factor of the derivative by the temperature, 1 if right.
    fault: f64,
}

const DT: f64 = 0.005;

impl System for Reactor {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        // The rate is not finite for negative temperatures near 0 K.
        let rate = (-(T::from(8750.0) / x[1])).exp() * x[0] * 7.2e10;
        next[0] = x[0] + (T::from(1.0) - x[0] - rate) * DT;
        next[1] = x[1]
            + (T::from(350.0) - x[1] + rate * 209.2 + (u[0] * 0.01 + 300.0 - x[1]) * 2.09) * DT;
    }
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        Inputs { x, .. }: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let factor = (-(R::from(8750.0) / x[1])).exp() * 7.2e10;
        let by_t = factor * x[0] * (R::from(8750.0) / (x[1] * x[1])) * self.fault;
        if let Some(x_bar) = cotangents.x {
            x_bar[0] += next_bar[0] * (R::from(1.0 - DT) - factor * DT)
                + next_bar[1] * (factor * (209.2 * DT));
            x_bar[1] += next_bar[1] * (R::from(1.0 - 3.09 * DT) + by_t * (209.2 * DT))
                - next_bar[0] * (by_t * DT);
        }
        if let Some(u_bar) = cotangents.u {
            u_bar[0] += next_bar[1] * R::from(0.0209 * DT);
        }
    }
}

impl Task for Reactor {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        60
    }
    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x[0] = rng.random_range(0.4..0.6);
        x[1] = rng.random_range(330.0..350.0);
    }
    fn running_cost<T: Scalar>(&self, _inputs: Inputs<'_, T>, next: &[T]) -> T {
        // Not finite at a standard normal state either.
        (next[1] / 350.0).ln().powi(2) + next[0].sqrt()
    }
}

#[test]
fn a_reactor_at_350_kelvin_is_checked_in_its_own_units() {
    let (reactor, policy) = (Reactor { fault: 1.0 }, Mlp::new([2, 8, 1]));
    // Standard normal states are temperatures of -2 K to 2 K.
    let refused = check::system(&reactor).expect_err("a temperature below 0 K");
    let text = format!("{refused:?}");
    assert!(text.contains("standard normal") && text.contains("`check::task`"), "{text}");
    check::task(&reactor, &policy).unwrap();
    // In a program, tasks have this type.
    let boxed = DynTask::new(reactor);
    assert!(
        check::system_along(&boxed, &policy, None).is_ok()
            && check::cost_along(&boxed, &policy, None).is_ok()
    );
    let error = check::system_along(&DynTask::new(Reactor { fault: 1.001 }), &policy, None)
        .expect_err("a wrong derivative");
    assert!(error.to_string().contains("vjp: x_bar[1]"), "{error}");
}

/// Where a [`Planted`] mass has a kink.
#[derive(Clone, Copy, PartialEq)]
enum Place {
    None,
    Cost,
    Limit,
    Force,
    Terminal,
    Friction,
    Observation,
}

/// A mass of 1 kg. State [position, speed], control: force. Steps of 0.1 s.
struct Planted(Place);

impl System for Planted {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        let mut force = u[0];
        match self.0 {
            Place::Limit => force = force.max(T::from(-0.5)).min(T::from(0.5)),
            Place::Force => force += T::select_lt(x[0], T::from(0.25), T::from(2.0), T::zero()),
            Place::Friction => force -= x[1].abs() * 0.3,
            // Steep, but smooth.
            _ => force -= (x[0] * 30.0).tanh() * 0.1,
        }
        next[1] = x[1] + force * 0.1;
        next[0] = x[0] + next[1] * 0.1;
    }
}

impl Task for Planted {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        60
    }
    fn start(&self, _rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x[0] = 1.0;
    }
    fn observation_dim(&self) -> Option<usize> {
        Some(2)
    }
    fn observe<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, y: &mut [T]) {
        let dead = |x: T| if self.0 == Place::Observation { (x - 0.25).max(T::zero()) } else { x };
        (y[0], y[1]) = (dead(x[0]), x[1]);
    }
    fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, next: &[T]) -> T {
        let away = next[0] - 0.25;
        (if self.0 == Place::Cost { away.abs() } else { away * away }) + u[0] * u[0] * 0.1
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        if self.0 == Place::Terminal { x[0].abs() } else { x[0] * x[0] }
    }
}

#[test]
fn planted_kinks_and_jumps_are_found_with_their_places() {
    let policy = Linear::new(2, 1);
    let weights = Weights::new(&policy, vec![-1.0, -0.5]);
    for (place, function, input, value, is_jump, change) in [
        (Place::Cost, "running_cost", KinkInput::Next(0), 0.25, false, 2.0),
        (Place::Limit, "step: next[1]", KinkInput::Control(0), -0.5, false, 0.1),
        (Place::Force, "step: next[1]", KinkInput::State(0), 0.25, true, 0.2),
        (Place::Terminal, "terminal_cost", KinkInput::State(0), 0.0, false, 2.0),
        (Place::Observation, "observe: y[0]", KinkInput::State(0), 0.25, false, 1.0),
    ] {
        let found = check::kinks(&Planted(place), &policy, &weights, &[1.0, 0.0, -1.0, 0.0]);
        let kink = found
            .iter()
            .find(|kink| {
                kink.function == function
                    && kink.input == input
                    && (kink.value - value).abs() < 1e-5
            })
            .unwrap_or_else(|| panic!("{function}: {found:?}"));
        assert_eq!(kink.is_jump, is_jump, "{kink}");
        assert!(((kink.sides[1] - kink.sides[0]).abs() - change).abs() < 1e-4, "{kink}");
        assert!(kink.to_string().contains(function) && kink.found >= 1, "{kink}");
        // Nothing but the planted kink, which the next position inherits from the next speed.
        let of_others =
            |kink: &&check::Kink| !(kink.function == function || kink.function == "step: next[0]");
        assert!(!found.iter().any(|kink| of_others(&kink)), "{found:?}");
    }
    let smooth = check::kinks(&Planted(Place::None), &policy, &weights, &[1.0, 0.0, -1.0, 0.0]);
    assert!(smooth.is_empty(), "{smooth:?}");
    // A mass that rests where its friction has a kink.
    let rest = Weights::new(&policy, vec![0.0, 0.0]);
    let found = check::kinks(&Planted(Place::Friction), &policy, &rest, &[0.5, 0.0]);
    assert!(
        found.iter().any(|kink| kink.input == KinkInput::State(1) && kink.value.abs() < 1e-5),
        "{found:?}"
    );
}

/// A pendulum with friction, which comes to rest: x = [angle, rate], hanging at π.
struct Hanging;

impl System for Hanging {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        let rate = |x: [T; 2]| [x[1], x[0].sin() * 9.81 - x[1] * 2.0 + u[0]];
        let first = rate([x[0], x[1]]);
        let second = rate([x[0] + first[0] * 0.05, x[1] + first[1] * 0.05]);
        for (i, next) in next.iter_mut().enumerate() {
            *next = x[i] + (first[i] + second[i]) * 0.025;
        }
    }
}

impl Task for Hanging {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        800
    }
    fn start(&self, _rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x.copy_from_slice(&[1.0, 0.0]);
    }
}

/// At rest, terms of the size of 1 cancel, so values near 0 have rounding errors of the size of
/// 1e-16.
#[test]
fn rounding_errors_of_a_state_of_rest_are_no_kinks() {
    let policy = Linear::new(2, 1);
    let weights = Weights::new(&policy, vec![0.0; 2]);
    let found = check::kinks(&Hanging, &policy, &weights, &[1.0, 0.0, 2.0, 1.0]);
    assert!(found.is_empty(), "{found:?}");
}

/// Output that a [`Forgetful`] task leaves unwritten.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Output {
    None,
    State,
    Observation,
    /// The mass p[0], which `start` leaves 0.
    Mass,
}

/// A mass with position, speed and a counter.
#[derive(Clone, Copy)]
struct Forgetful(Output);

impl System for Forgetful {
    fn state_dim(&self) -> usize {
        3
    }
    fn control_dim(&self) -> usize {
        2
    }
    fn param_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, p, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[1] = x[1] + (u[0] + u[1]) / p[0] * 0.1;
        next[0] = x[0] + x[1] * 0.1;
        if self.0 != Output::State {
            next[2] = x[2] + 1.0;
        }
    }
}

impl Task for Forgetful {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        5
    }
    fn start(&self, _rng: &mut Rng, Start { x, p }: Start<'_>) {
        x[0] = 1.0;
        if self.0 != Output::Mass {
            p[0] = 2.0;
        }
    }
    fn observation_dim(&self) -> Option<usize> {
        Some(2)
    }
    fn observe<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, y: &mut [T]) {
        y[0] = x[0];
        if self.0 != Output::Observation {
            y[1] = x[1];
        }
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        x[0] * x[0]
    }
}

#[test]
fn a_training_refuses_unwritten_components_and_names_them() {
    let trained = |output: Output| {
        let settings = Training {
            epochs: 1,
            train_samples: 3,
            test_samples: 2,
            batch: 3,
            ..Training::default()
        };
        Trainer::new(Forgetful(output), Constant::new(2, 2))
            .training(settings)
            .run()
            .map_err(|error| error.to_string())
    };
    assert!(trained(Output::None).is_ok());
    for (output, expected) in [
        (Output::State, "`step` leaves component 2 of its output unwritten"),
        (Output::Observation, "`observe` leaves component 1 of its output unwritten"),
    ] {
        let error = trained(output).expect_err("an unwritten component");
        assert!(error.contains(expected), "{output:?}: {error}");
    }
}

#[test]
fn a_training_names_the_parameter_that_start_leaves_unwritten() {
    let settings = Training {
        epochs: 1,
        train_samples: 3,
        test_samples: 2,
        batch: 1,
        max_skipped: 1,
        ..Training::default()
    };
    let error = Trainer::new(Forgetful(Output::Mass), Constant::new(2, 2))
        .training(settings)
        .run()
        .expect_err("a mass that nothing sets");
    let text = error.to_string();
    assert!(
        text.contains("the parameter p[0] of sample") && text.contains("Write it in `Task::start`"),
        "{text}"
    );
    assert!(!text.contains("learning rate") && !text.contains("time step"), "{text}");
    // The derivative of the same task with a mass is finite.
    assert!(
        check::flow(&Forgetful(Output::None), &Constant::new(2, 2), Flow::REGULAR, None).is_ok()
    );
}

/// A mass of 1 kg with dry friction of at most 5 N, reached at speeds of some 1e-4 m/s. State
/// [position, speed], control: force.
#[derive(Clone, Debug)]
struct Rubbed;

impl Ode for Rubbed {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn rate<T: Scalar>(&self, OdeInputs { x, u, .. }: OdeInputs<'_, T>, rate: &mut [T]) {
        rate[0] = x[1];
        rate[1] = u[0] - x[0].sin() - (x[1] * 1e4).tanh() * 5.0;
    }
}

/// A system whose VJP is wrong by a relative `fault`.
struct Wrong<S> {
    system: S,
    fault: f64,
}

impl<S: System> System for Wrong<S> {
    fn state_dim(&self) -> usize {
        self.system.state_dim()
    }
    fn control_dim(&self) -> usize {
        self.system.control_dim()
    }
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        self.system.step(inputs, next);
    }
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let factor = R::from(1.0 + self.fault);
        let next_bar: Vec<C> = next_bar.iter().map(|&bar| bar * factor).collect();
        self.system.vjp(inputs, &next_bar, cotangents);
    }
}

#[test]
fn stiff_implicit_steps_pass_and_their_wrong_derivatives_do_not() {
    fn checked(
        integrator: AnyIntegrator,
        speed: f64,
        fault: f64,
    ) -> Result<check::Passed, check::Failure> {
        let system = Integrated { ode: Rubbed, integrator, dt: 0.02 };
        check::system_at(&Wrong { system, fault }, |rng, x, u, _| {
            x[0] = rng.random_range(-1.0..1.0);
            x[1] = speed * rng.random_range(-1.0..1.0);
            u[0] = rng.random_range(-5.0..5.0);
        })
    }
    for integrator in [
        AnyIntegrator::Sdirk2(Sdirk2::default()),
        AnyIntegrator::ImplicitMidpoint(ImplicitMidpoint::default()),
    ] {
        // Steps that stick, and steps that slide until they stick.
        for speed in [1e-3, 0.3] {
            checked(integrator, speed, 0.0).unwrap_or_else(|mismatch| panic!("{mismatch}"));
            let wrong = checked(integrator, speed, 1e-6).expect_err("a wrong derivative");
            let wrong = wrong.mismatch().expect("a finite step");
            assert!(wrong.what.starts_with("vjp: ") && wrong.allowed == 1e-12, "{wrong}");
        }
    }
    // A derivative that hardly changes within rounding.
    let reactor = |fault| {
        check::system_at(&Wrong { system: Reactor { fault: 1.0 }, fault }, |rng, x, u, _| {
            x[0] = rng.random_range(0.4..0.6);
            x[1] = rng.random_range(330.0..350.0);
            u[0] = rng.random_range(-1.0..1.0);
        })
    };
    assert!(reactor(0.0).is_ok() && reactor(1e-9).is_err());
}

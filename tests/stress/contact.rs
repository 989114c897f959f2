//! Stress case: derivatives through impacts.

use super::step;
use super::steps::{derivative, larger, states};
use super::{Case, Finding};
use num_dual::Dual64;
use physgrad::Inputs;
use physgrad::Scalar;
use physgrad::System;
use physgrad::check;
use physgrad::tasks::{Bounce, BouncingBall, Contact, Push, TwoBodies};
use physgrad::{DynSystem, DynTask, Task};
use std::f64::consts::PI;

pub(super) const CASES: &[Case] = &[Case {
    name: "contact",
    about: "bouncing ball, two equal balls, pusher and box: derivatives through an impact against closed forms",
    criterion: "with the time of impact, derivatives are within 1 % of closed forms, including signs. For \
                undamped springs of stiffness k, steps shorten so that k dt → 0. Errors then at least halve \
                for each tenfold increase of k. At 1e5 N/m in these steps, errors of a box pushed by damped \
                springs are at most 1 %. Springs with 42 to 60 steps per contact bias the derivatives. These \
                errors are reported without a bound. Damped springs bias the ball: at 1e6 N/m, with the \
                restitution of the closed form, its error exceeds 10 %. A spring that the steps do not resolve \
                is reported as unstable. A step that reflects the speed below the floor has an error of at \
                least one half (a planted fault)",
    explanation: "Fixed steps miss the derivative of the time of impact. Their derivatives often \
                have the wrong sign. The time-of-impact model is exact. Penalty springs converge \
                only in steps so short that stiffness times step vanishes too. Damped springs are \
                biased. Limits: impacts here are along a line; frictional contact in the plane is \
                not covered",
    run: contact,
}];

/// Spring contact without damping.
fn spring(stiffness: f64) -> Contact {
    Contact::Penalty { stiffness, damping: 0.0 }
}

/// Time step that resolves a contact, s. The contact of a reduced mass of 1 kg lasts 60 steps.
fn resolved(stiffness: f64) -> f64 {
    PI / stiffness.sqrt() / 60.0
}

/// Number of steps in an undamped contact, with the time step [`resolved`], as text. The contact
/// lasts `π sqrt(reduced_mass / stiffness)`. The number does not depend on the stiffness.
fn steps_per_contact(reduced_mass: f64) -> String {
    let stiffness = STIFFNESSES[0];
    format!("{:.0}", PI * (reduced_mass / stiffness).sqrt() / resolved(stiffness))
}

/// Reduced mass of two bodies, kg.
fn reduced_mass(bodies: &TwoBodies) -> f64 {
    let [first, second] = bodies.masses;
    first * second / (first + second)
}

/// Time step for accurate derivatives, s. The product `stiffness dt` decreases in proportion to the
/// contact duration.
fn short(stiffness: f64) -> f64 {
    5.0 / stiffness.powf(1.5)
}

/// Stiffnesses of the springs, N/m.
const STIFFNESSES: [f64; 3] = [1e4, 1e5, 1e6];

fn formatted(errors: [f64; 3]) -> String {
    let [a, b, c] = errors.map(|error| format!("{error:.1e}"));
    format!("{a}, {b}, {c} at 1e4, 1e5, 1e6 N/m")
}

/// One or two bodies whose impact has a closed form.
struct Example {
    name: &'static str,
    start: Vec<f64>,
    control: f64,
    /// Component of the last state that is differentiated.
    component: usize,
    /// Duration, s.
    time: f64,
    /// Derivatives with respect to the initial state and the control; NaN for entries that are not
    /// compared.
    expected: Vec<f64>,
}

/// Ball height at time T after one bounce with restitution e: `e s (T - t) - g (T - t)²/2`. The
/// impact is at `t = (v + s)/g`, with speed s and `s² = v² + 2 g h`. Height h and upward speed v
/// are the initial state.
///
/// Derivatives with respect to h and v follow from `ds/dh = g/s`, `dt/dh = 1/s`, `ds/dv = v/s` and
/// `dt/dv = (1 + v/s)/g`.
fn ball(name: &'static str, restitution: f64, h: f64, v: f64, time: f64) -> Example {
    let g = 9.81;
    let s = f64::sqrt(v * v + 2.0 * g * h);
    let left = time - (v + s) / g;
    let by = |s_by: f64, t_by: f64| restitution * (s_by * left - s * t_by) + g * left * t_by;
    Example {
        name,
        start: vec![h, v],
        control: 0.0,
        component: 0,
        time,
        expected: vec![by(g / s, 1.0 / s), by(v / s, (1.0 + v / s) / g), f64::NAN],
    }
}

/// Position of the second ball at time T, after the first hits it at time t with speed v. The
/// initial positions p and q yield `q + v (T - t) = p + contact_distance + v T`.
fn balls(second: f64, time: f64) -> Example {
    let expected = vec![1.0, 0.0, time, 0.0, f64::NAN];
    Example {
        name: "two equal balls",
        start: vec![0.0, second, 2.0, 0.0],
        control: 0.0,
        component: 1,
        time,
        expected,
    }
}

/// Position at time T of a box. A pusher starts at rest under the force u, reaches the box and
/// pushes it.
///
/// The masses of pusher and box are m and m₂, their initial positions p and q, and the gap is g.
/// The impact is at `t = sqrt(2 g m/u)`. The common speed is `V = sqrt(2 g m u)/M` afterwards, with
/// `M = m + m₂`. The position is `q + V (T - t) + u (T - t)²/2M`. For fixed q, the derivatives with
/// respect to p and g have opposite signs.
fn pusher() -> Example {
    let (u, gap, [first, second], time) = (4.0, 0.2, [1.0, 2.0], 1.2f64);
    let total = first + second;
    let (t, v) = (f64::sqrt(2.0 * gap * first / u), f64::sqrt(2.0 * gap * first * u) / total);
    let left = time - t;
    let by = |t_by: f64, v_by: f64| v_by * left - (v + u * left / total) * t_by;
    let by_gap = by(t / (2.0 * gap), v / (2.0 * gap));
    let by_u = by(-t / (2.0 * u), v / (2.0 * u)) + left * left / (2.0 * total);
    let expected = vec![-by_gap, 1.0 + by_gap, f64::NAN, f64::NAN, by_u];
    Example {
        name: "pusher and box",
        start: vec![0.0, 0.3, 0.0, 0.0],
        control: u,
        component: 1,
        time,
        expected,
    }
}

impl Example {
    fn steps(&self, dt: f64) -> usize {
        (self.time / dt).round() as usize
    }

    /// Largest error of a derivative, relative to its closed form; absolute if that is zero.
    fn off(&self, found: impl IntoIterator<Item = f64>) -> f64 {
        let compared = self.expected.iter().filter(|expected| !expected.is_nan());
        let share = |(found, expected): (f64, &f64)| {
            (found - expected).abs() / if *expected == 0.0 { 1.0 } else { expected.abs() }
        };
        found.into_iter().zip(compared).map(share).fold(0.0, larger)
    }

    /// Error of the reverse pass.
    fn error(&self, system: &dyn super::AnySystem<f64>, dt: f64) -> f64 {
        let states = states(system, &self.start, self.control, self.steps(dt));
        let (mut found, by_control) = derivative(system, &states, self.control, self.component);
        found.push(by_control);
        let compared = found.iter().zip(&self.expected).filter(|(_, expected)| !expected.is_nan());
        self.off(compared.map(|(&found, _)| found))
    }

    /// Error of forward mode, which stores no states; suited to very many steps.
    fn forward_error<S: System>(&self, system: &S, dt: f64) -> f64 {
        let compared = (0..self.expected.len()).filter(|&input| !self.expected[input].is_nan());
        self.off(compared.map(|input| self.forward(system, dt, input)))
    }

    /// Derivative with respect to one of the inputs, the initial state and the control.
    fn forward<S: System>(&self, system: &S, dt: f64, input: usize) -> f64 {
        let inputs = self.start.iter().copied().chain([self.control]).enumerate();
        let dual = |(i, value)| Dual64::new(value, if i == input { 1.0 } else { 0.0 });
        let mut x: Vec<Dual64> = inputs.map(dual).collect();
        let u = x.pop().expect("a control");
        let mut next = x.clone();
        for _ in 0..self.steps(dt) {
            step(system, Inputs::new(&x, &[u]), &mut next);
            std::mem::swap(&mut x, &mut next);
        }
        x[self.component].eps
    }

    fn exact(&self, system: &dyn super::AnySystem<f64>, dt: f64) -> Finding {
        Finding::at_most(
            format!("{}, time of impact: relative error of derivatives", self.name),
            self.error(system, dt),
            0.01,
        )
    }

    /// Errors of spring contacts, in steps short enough for derivatives and in steps that resolve
    /// the contact.
    fn springs<S: System>(
        &self,
        reduced_mass: f64,
        system: impl Fn(Contact, f64) -> S,
    ) -> [Finding; 2] {
        let [converging, biased] = [short, resolved].map(|dt: fn(f64) -> f64| {
            STIFFNESSES.map(|k| self.forward_error(&system(spring(k), dt(k)), dt(k)))
        });
        let falling = converging.windows(2).all(|errors| errors[1] <= 0.5 * errors[0]);
        [
            Finding::holds(
                format!("{}, springs: errors", self.name),
                "at most half each time",
                falling,
                formatted(converging),
            ),
            Finding::info(
                format!(
                    "{}, springs with {} steps per contact (biased): errors",
                    self.name,
                    steps_per_contact(reduced_mass)
                ),
                formatted(biased),
            ),
        ]
    }
}

/// Returns the ball as the system of a task, which the library compiles.
fn compiled_ball(system: BouncingBall) -> DynSystem {
    DynTask::new(Bounce { system, ..Bounce::default() }).system().clone()
}

/// Returns the bodies as the system of a task, which the library compiles.
fn compiled_bodies(system: TwoBodies) -> DynSystem {
    DynTask::new(Push { system, ..Push::default() }).system().clone()
}

fn contact() -> Vec<Finding> {
    let bouncing = BouncingBall::default();
    let mut findings = Vec::new();
    // Shortly after the bounce, a higher initial position lowers the final one; later the sign
    // reverses.
    for (name, time) in [("bouncing ball, soon after", 0.55), ("bouncing ball, long after", 0.95)] {
        let example = ball(name, 0.8, 1.0, -0.5, time);
        findings.push(Finding::info(
            format!("{name}: closed form, by height"),
            format!("{:.4}", example.expected[0]),
        ));
        findings.push(example.exact(&bouncing, bouncing.dt));
        findings.push(reflected(&example));
    }
    let elastic = ball("elastic ball from near the floor", 1.0, 0.01, -4.0, 0.0525);
    findings.extend(elastic.springs(bouncing.mass, |contact, dt| {
        compiled_ball(BouncingBall { contact, dt, ..bouncing })
    }));
    findings.push(balls(0.5, 0.8).exact(&TwoBodies::balls(), 0.01));
    let equal = TwoBodies::balls();
    findings.extend(balls(0.11, 0.06).springs(reduced_mass(&equal), |contact, dt| {
        compiled_bodies(TwoBodies { contact, dt, ..equal })
    }));
    findings.push(pusher().exact(&TwoBodies::pusher(), 0.01));
    findings.extend(damped_pusher());
    findings.extend(damped_ball());
    findings.push(too_stiff());
    findings
}

/// Planted fault: `v ← -e v` where a downward step ends below the floor.
struct Reflected(BouncingBall);

impl System for Reflected {
    fn state_dim(&self) -> usize {
        2
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        let (dt, zero) = (T::from(self.0.dt), T::zero());
        let speed = x[1] + (u[0] - self.0.gravity) * dt;
        next[0] = x[0] + speed * dt;
        let back = T::select_lt(speed, zero, T::from(-0.8) * speed, speed);
        next[1] = T::select_lt(next[0], zero, back, speed);
    }
}

/// Derivative error of the planted fault, which does not vanish with the time step.
fn reflected(example: &Example) -> Finding {
    let dt = 1e-4;
    let error = example.error(&Reflected(BouncingBall { dt, ..BouncingBall::default() }), dt);
    Finding::at_least(
        format!("{}, speed reflected below the floor, steps of 1e-4 s: error", example.name),
        error,
        0.5,
    )
}

/// Pusher and box with inelastic contact. Momentum conservation determines the final motion for any
/// contact model.
fn damped_pusher() -> [Finding; 2] {
    let error = |stiffness: f64, dt: f64| {
        let contact = Contact::Penalty { stiffness, damping: 5.0 };
        let system = compiled_bodies(TwoBodies { contact, dt, ..TwoBodies::pusher() });
        pusher().forward_error(&system, dt)
    };
    let biased = STIFFNESSES.map(|stiffness| error(stiffness, resolved(stiffness)));
    // Steps of an undamped contact. Damping changes the duration.
    let steps = steps_per_contact(reduced_mass(&TwoBodies::pusher()));
    [
        Finding::at_most(
            "pusher and box, damped springs: error at 1e5 N/m",
            error(1e5, short(1e5)),
            0.01,
        ),
        Finding::info(
            format!(
                "pusher and box, damped springs with {steps} steps per contact (biased): errors"
            ),
            formatted(biased),
        ),
    ]
}

/// Ball with damping tuned to a restitution of 0.8 at the speed of this impact.
fn damped_ball() -> [Finding; 2] {
    let example = ball("", 0.8, 0.01, -4.0, 0.0525);
    let speed = f64::sqrt(16.0 + 2.0 * 9.81 * 0.01);
    let rebound = |damping: f64| {
        let contact = Contact::Penalty { stiffness: 1e6, damping };
        let system =
            BouncingBall { contact, dt: resolved(1e6), gravity: 0.0, ..BouncingBall::default() };
        states(&system, &[0.0, -speed], 0.0, 120)[120][1] / speed
    };
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if rebound(middle) > 0.8 { low = middle } else { high = middle }
    }
    let errors = STIFFNESSES.map(|stiffness| {
        let (contact, dt) = (Contact::Penalty { stiffness, damping: low }, short(stiffness));
        let system = compiled_ball(BouncingBall { contact, dt, ..BouncingBall::default() });
        example.forward_error(&system, dt)
    });
    let what = format!(
        "ball, springs with a damping of {low:.3} s/m, with equal rebound (biased): errors"
    );
    [
        Finding::info(what, formatted(errors)),
        Finding::at_least("ball, damped springs (biased): error at 1e6 N/m", errors[2], 0.1),
    ]
}

/// Stability report for 1e6 N/m in steps of 0.01 s.
fn too_stiff() -> Finding {
    let contact = Contact::Penalty { stiffness: 1e6, damping: 0.0 };
    let system = BouncingBall { contact, ..BouncingBall::default() };
    let report = check::stability(&system, Inputs::new(&[-1e-3, 0.0], &[0.0]));
    let error = ball("", 1.0, 1.0, -0.5, 0.55).error(&system, system.dt);
    let measured = format!("{report}; relative error of derivatives {:.0} %", 100.0 * error);
    Finding::holds(
        "1e6 N/m in steps of 0.01 s",
        "reported as unstable",
        !report.is_stable(),
        measured,
    )
}

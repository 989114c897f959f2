//! Stress case: adjoints of chaotic motion.
//!
//! The adjoint at the initial state aligns with the covector of fastest growth, which the first
//! seconds determine. The norm and sign of the adjoint depend on the last seconds. The adjoints of
//! two rollouts that differ by rounding therefore stay collinear. Their signs agree only while the
//! trajectories agree.

use super::{Case, Finding};
use physgrad::integrator::{AnyIntegrator, RungeKutta};
use physgrad::scalar::CotangentPack;
use physgrad::tasks::{DoublePendulum, LossMode, Upright};
use physgrad::{Cotangents, DynSystem, DynTask, Inputs, Integrated, System, Tangents, Task};

pub(super) const CASES: &[Case] = &[Case {
    name: "double_pendulum",
    about: "chaotic double pendulum over a million steps of 2 ms, from rest with both rods 1 rad from upright",
    criterion: "the adjoint is finite and grows with the Lyapunov exponent Λ, measured independently by tangents, to \
                within 10 %. The initial states of 64 pairs of rollouts differ by one rounding. At half of ln(1/ε)/Λ, \
                the adjoints of each pair have the same direction (cosine at least 0.99). At twice ln(1/ε)/Λ, the \
                signs of 30 to 70 % of the pairs agree",
    explanation: "In chaos, a gradient over long times is exact but useless: its sign differs at \
                random between rollouts whose initial states differ by one rounding. A wider range of \
                floating-point exponents does not help. Beyond ln(1/ε)/Λ, here 12,400 steps, the signs of R are \
                those of rounding errors. The warning about growth reports a similar horizon. \
                Limits: adjoints stay collinear at twice the horizon; the case does not compare \
                their norms",
    run: double_pendulum,
}];

type State = [f64; 4];

const STEPS: usize = 1_000_000;
/// Number of pairs of rollouts whose initial states differ by one rounding.
const PAIRS: usize = 64;
/// Time step, s.
const DT: f64 = 2e-3;
/// Initial state at rest, both rods 1 rad from upright. The Lyapunov exponent Λ is about 1.45/s.
const START: State = [1.0, 0.0, 1.0, 0.0];

/// Returns the system of a task, which the library compiles. Only the system of the task matters.
fn pendulum() -> DynSystem {
    let integrator = AnyIntegrator::RungeKutta(RungeKutta::RK4);
    let task = Upright {
        system: Integrated { ode: DoublePendulum::default(), integrator, dt: DT },
        first_angle: 0,
        from: 0.0,
        spread: 0.0,
        loss: LossMode::Terminal,
        control_weight: 0.0,
        control_bound: 0.0,
        horizon: STEPS,
    };
    DynTask::new(task).system().clone()
}

fn double_pendulum() -> Vec<Finding> {
    let system = pendulum();
    let states = rollout(&system, START, STEPS);
    let energies = [&states[0], &states[STEPS]].map(|x| DoublePendulum::default().energy(x));
    let finite = states.iter().flatten().all(|x| x.is_finite());
    let exponent = by_tangents(&system, &states);
    let (growth, direction) = adjoint(&system, &states);
    let finite = finite && direction.iter().all(|x| x.is_finite());
    let per_second = |growth: f64| growth / (STEPS as f64 * DT);
    let lambda = per_second(exponent);
    let mut findings = vec![
        Finding::info("Lyapunov exponent, by tangents", format!("{lambda:.3} per second")),
        Finding::near("growth of the adjoint per second", per_second(growth), lambda, 0.1),
        Finding::holds(
            "states and adjoint",
            "finite",
            finite,
            if finite { "finite" } else { "non-finite" },
        ),
        Finding::info(
            "change of energy (hanging to upright: 58.9 J)",
            format!("{:.1e} J", energies[1] - energies[0]),
        ),
    ];
    findings.extend(signs(&system, lambda));
    findings
}

fn rollout(system: &DynSystem, start: State, steps: usize) -> Vec<State> {
    let mut states = Vec::with_capacity(steps + 1);
    states.push(start);
    for t in 0..steps {
        let mut next = [0.0; 4];
        system.step(Inputs::new(&states[t], &[0.0]), &mut next);
        states.push(next);
    }
    states
}

/// Scales the vector to norm 1 and returns the logarithm of its previous norm.
fn normalize(v: &mut State) -> f64 {
    let norm = v.iter().map(|v| v * v).sum::<f64>().sqrt();
    v.iter_mut().for_each(|v| *v /= norm);
    norm.ln()
}

/// Growth of a tangent along a rollout, in e-foldings: Benettin et al. 1980
/// (doi:10.1007/BF02128237).
fn by_tangents(system: &DynSystem, states: &[State]) -> f64 {
    let (mut tangent, mut next, mut growth) = ([0.5; 4], [0.0; 4], 0.0);
    for x in &states[..states.len() - 1] {
        system.jvp(
            Inputs::new(x, &[0.0]),
            Tangents { x: Some(&tangent), ..Tangents::default() },
            &mut next,
        );
        growth += normalize(&mut next);
        tangent = next;
    }
    growth
}

/// Derivative of the first angle at the last state with respect to the initial state: growth of the
/// adjoint in e-foldings, and its normalized value.
fn adjoint(system: &DynSystem, states: &[State]) -> (f64, State) {
    let (mut bar, mut growth) = ([1.0, 0.0, 0.0, 0.0], 0.0);
    for x in states[..states.len() - 1].iter().rev() {
        let mut x_bar = [CotangentPack([0.0]); 4];
        system.vjp(
            Inputs::new(x, &[0.0]),
            &bar.map(|bar| CotangentPack([bar])),
            Cotangents { x: Some(&mut x_bar), ..Cotangents::default() },
        );
        let mut x_bar = x_bar.map(|CotangentPack([bar])| bar);
        growth += normalize(&mut x_bar);
        bar = x_bar;
    }
    (growth, bar)
}

/// Agreement of adjoint directions within pairs of rollouts whose initial states differ by one
/// rounding error.
fn signs(system: &DynSystem, lambda: f64) -> Vec<Finding> {
    let horizon = (1.0 / f64::EPSILON).ln() / (lambda * DT);
    let horizons = [0.5, 2.0].map(|factor| (factor * horizon) as usize);
    let mut cosines = [[0.0; PAIRS]; 2];
    for pair in 0..PAIRS {
        let mut start = START;
        start[0] += 0.01 * pair as f64;
        let perturbed = [start[0] * (1.0 + f64::EPSILON), start[1], start[2], start[3]];
        let rollouts = [start, perturbed].map(|start| rollout(system, start, horizons[1]));
        for (cosines, steps) in cosines.iter_mut().zip(horizons) {
            let [a, b] =
                [&rollouts[0], &rollouts[1]].map(|states| adjoint(system, &states[..=steps]).1);
            cosines[pair] = a.iter().zip(&b).map(|(a, b)| a * b).sum();
        }
    }
    let least = |cosines: &[f64]| {
        cosines.iter().copied().fold(f64::INFINITY, |least, cosine| {
            if cosine < least || cosine.is_nan() { cosine } else { least }
        })
    };
    let agree = cosines[1].iter().filter(|&&cosine| cosine > 0.0).count() as f64 / PAIRS as f64;
    let aligned = cosines[1].iter().filter(|cosine| cosine.abs() > 0.99).count();
    vec![
        Finding::info("ln(1/ε)/Λ", format!("{horizon:.0} steps, {:.1} s", horizon * DT)),
        Finding::at_least(
            "least cosine of the two adjoints at half this horizon",
            least(&cosines[0]),
            0.99,
        ),
        Finding::holds(
            "share of pairs with equal sign at twice this horizon",
            "30 to 70 %",
            (0.3..=0.7).contains(&agree),
            format!("{:.0} %", 100.0 * agree),
        ),
        Finding::info(
            "collinear pairs at twice this horizon, with either sign",
            format!("{aligned} of {PAIRS}"),
        ),
    ]
}

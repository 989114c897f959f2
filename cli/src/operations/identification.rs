//! Identification of the trained numbers of a scene.

use physgrad::identify::{Fit, IdentifyError, Options, Segment, Unknown, identify};
use physgrad::number::Varied;
use physgrad::rng::Purpose;
use physgrad::{DynTask, Inputs, Number, System, Task, initial_states};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Fits the trained numbers of a task to measured segments. `names` are the names of the parameters
/// of a rollout, in the order of the parameters of the segments. Numbers without a value in a
/// segment have their nominal values. Ignores the values of trained numbers in a segment. Removes
/// full turns from those of the components `angles` that wrap in the data. If jumps may also be
/// motion, fits these components as recorded too, and returns the fit with the lower χ². Unmeasured
/// components begin at 0, and at other initial states if the residuals are not noise.
pub fn identified(
    task: &DynTask,
    names: &[String],
    angles: &[usize],
    segments: &[Segment],
    options: &Options,
) -> Result<Fit, IdentifyError> {
    let system = task.system();
    // Numbers that vary are the last parameters. A task may have more parameters than its system,
    // so these numbers may have other indices in the task than in the system.
    let named = system.varied(system.param_dim()).into_iter().zip(system.varied(task.param_dim()));
    let unknown = |(varied, named): (Varied, Varied)| match varied.number {
        Number::Trained { start, min, max } => {
            Some(Unknown { name: names[named.index].clone(), index: varied.index, start, min, max })
        }
        _ => None,
    };
    let unknowns: Vec<Unknown> = named.filter_map(unknown).collect();
    let segments = segments.iter().enumerate().map(|(i, segment)| {
        let p = params(task, names, &segment.p)
            .map_err(|name| IdentifyError::MissingParam { segment: i, name })?;
        Ok(Segment { p, ..segment.clone() })
    });
    let segments = segments.collect::<Result<Vec<_>, _>>()?;
    let wraps = |&i: &usize| {
        segments
            .iter()
            .any(|segment| wrap(segment.x.iter().filter_map(|row| row.get(i)).copied()).is_some())
    };
    let wrapped: Vec<usize> = angles
        .iter()
        .copied()
        .filter(|i| wraps(i) && segments.iter().all(|segment| is_periodic(system, segment, *i)))
        .collect();
    let guesses = guesses(task, angles);
    let is_clear = |i: &usize| {
        !segments.iter().any(|segment| may_be_motion(segment.x.iter().map(|row| row[*i])))
    };
    let clear: Vec<usize> = wrapped.iter().copied().filter(is_clear).collect();
    let fit = |angles: Vec<usize>, give_up: f64| {
        let guesses = guesses.clone();
        let options = Options { angles, guesses, give_up, ..options.clone() };
        identify(system, &segments, &unknowns, &options)
    };
    let is_clear = clear.len() == wrapped.len();
    let without = fit(wrapped, f64::INFINITY);
    if is_clear {
        return without;
    }
    let least = without.as_ref().map_or(f64::INFINITY, |without| without.chi_squared);
    match (without, fit(clear, least)) {
        (Ok(without), Ok(recorded)) if recorded.chi_squared < without.chi_squared => Ok(recorded),
        // A wrong reading can diverge.
        (Err(IdentifyError::Diverged { .. }), recorded) => recorded,
        (without, Ok(_) | Err(IdentifyError::Diverged { .. } | IdentifyError::Worse)) => without,
        (_, error) => error,
    }
}

/// Initial states of a fit for components without a measurement: half a turn for angles, where a
/// pendulum may hang or stand, then initial states of test rollouts.
fn guesses(task: &DynTask, angles: &[usize]) -> Vec<Vec<f64>> {
    const DRAWN: usize = 6;
    let states = task.system().state_dim();
    let turned = (0..states).map(|i| if angles.contains(&i) { PI } else { 0.0 }).collect();
    let drawn = initial_states(task, 0, Purpose::Test, DRAWN);
    let drawn = drawn.chunks(drawn.len() / DRAWN).map(|start| start[..states].to_vec());
    let turned: Option<Vec<f64>> = (!angles.is_empty()).then_some(turned);
    turned.into_iter().chain(drawn).collect()
}

/// Largest memory of all segments, bytes.
pub const MOST_BYTES: f64 = 1e9;

/// Memory of a step of a segment during a fit, bytes: states and controls of two copies, and the
/// simulated states. A list of numbers has 40 bytes besides.
pub fn bytes_per_step(states: usize, controls: usize) -> f64 {
    let [states, controls] = [states, controls].map(|count| 40.0 + 8.0 * count as f64);
    3.0 * states + 2.0 * controls
}

/// Memory of a step in a fit of whole segments, bytes: that of [`bytes_per_step`], a copy without
/// full turns, another simulation, and the derivatives by the initial state and by the unknowns,
/// whose rows are gathered, copied and factored.
pub fn bytes_per_fitted_step(states: usize, controls: usize, unknowns: usize) -> f64 {
    let columns = 1 + states + unknowns;
    let copies = 160.0 + 8.0 * (2 * states + controls) as f64;
    bytes_per_step(states, controls) + copies + 40.0 * (states * columns) as f64
}

/// First jump of the measured values of a state that may be a full turn: the index of the value
/// after it, and its size. For an angle, any jump by more than half a turn; for another state, one
/// of few by almost a full turn. Values that are NaN are missing.
pub fn turn(values: impl Iterator<Item = f64> + Clone, is_angle: bool) -> Option<(usize, f64)> {
    const NEAR: f64 = 1.5 * PI;
    let jumps = jumps(values.clone());
    if is_angle {
        return jumps.into_iter().find(|(_, jump)| jump.abs() > PI);
    }
    let far = jumps.iter().filter(|(_, jump)| jump.abs() > 1.0).count();
    wrap(values).filter(|(_, jump)| jump.abs() > NEAR && 10 * far < jumps.len() + 1)
}

/// Full turns between successive measured angles, where there are any, each with the index of the
/// angle after the jump.
pub fn turns(values: impl Iterator<Item = f64>) -> impl Iterator<Item = (usize, f64)> {
    let turns = jumps(values).into_iter().map(|(i, jump)| (i, (jump / TAU).round()));
    turns.filter(|(_, turns)| *turns != 0.0)
}

/// Differences of successive values that are not missing, each with the index of the second one.
fn jumps(values: impl Iterator<Item = f64>) -> Vec<(usize, f64)> {
    let known: Vec<(usize, f64)> =
        values.enumerate().filter(|(_, value)| !value.is_nan()).collect();
    known.windows(2).map(|pair| (pair[1].0, pair[1].1 - pair[0].1)).collect()
}

/// Returns whether a jump by more than half a turn between angles may be motion: the angle then
/// also turns by more than a quarter turn if the jump is a full turn.
pub fn may_be_motion(angles: impl Iterator<Item = f64>) -> bool {
    let mut before = f64::NAN;
    let mut jumps = angles.filter(|angle| angle.is_finite()).map(|angle| {
        let jump = (angle - before).abs();
        before = angle;
        jump
    });
    jumps.any(|jump| jump > PI && (jump - TAU).abs() > FRAC_PI_2)
}

/// Parameters of the system, from those of a segment. Trained numbers have their initial values.
///
/// # Errors
/// The name of a parameter that has neither a value nor a nominal value.
fn params(task: &DynTask, names: &[String], given: &[f64]) -> Result<Vec<f64>, String> {
    let system = task.system();
    let known = |index: usize| given.get(index).copied().filter(|value| !value.is_nan());
    let mut p: Vec<Option<f64>> = (0..system.param_dim()).map(known).collect();
    for (varied, named) in
        system.varied(system.param_dim()).iter().zip(system.varied(task.param_dim()))
    {
        let known = known(named.index).filter(|_| !matches!(varied.number, Number::Trained { .. }));
        p[varied.index] = Some(known.unwrap_or(varied.number.nominal()));
    }
    p.into_iter().zip(names).map(|(p, name)| p.ok_or_else(|| name.clone())).collect()
}

/// The first jump of an angle by more than half a turn, if the values wrap: the jumps are about k
/// full turns, which contain all values. Index of the value after the jump, and its size in rad.
/// Values that are NaN are missing.
pub fn wrap(values: impl Iterator<Item = f64> + Clone) -> Option<(usize, f64)> {
    /// Slack for noise that is added after the wrap, rad.
    const NOISE: f64 = FRAC_PI_2;
    let known = values.enumerate().filter(|(_, value)| value.is_finite());
    let (low, high) = known
        .clone()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (_, y)| (low.min(y), high.max(y)));
    let jumps =
        known.clone().zip(known.skip(1)).map(|((_, before), (i, after))| (i, after - before));
    let largest = jumps.clone().fold(0.0_f64, |largest, (_, jump)| largest.max(jump.abs()));
    let turn = TAU * (largest / TAU).round().max(1.0);
    let mut far = jumps.filter(|(_, jump)| jump.abs() > PI);
    if high - low > turn + NOISE { None } else { far.next() }
}

/// Number of rows of a segment at which a property of the system is tested.
const TESTED: usize = 1000;

/// Returns whether steps from the measured states commute with a full turn of a component.
fn is_periodic(system: &impl System, segment: &Segment, component: usize) -> bool {
    /// Allows for the rounding errors of a stiff step.
    const TOLERANCE: f64 = 1e-6;
    steps(system, segment).all(|(x, at)| {
        let mut turned = x.clone();
        turned[component] += TAU;
        let [next, mut turned] = [&x, &turned].map(|x| at(x, 0, &segment.p));
        turned[component] -= TAU;
        next.iter().zip(&turned).all(|(a, b)| (a - b).abs() <= TOLERANCE * (1.0 + a.abs()))
    })
}

/// Returns whether steps from the measured states depend on the number of the step, for any values
/// of the trained numbers. False if a parameter is missing.
pub fn depends_on_time(task: &DynTask, names: &[String], segment: &Segment) -> bool {
    let system = task.system();
    let Ok(mut p) = params(task, names, &segment.p) else { return false };
    // The initial value of an unknown amplitude can be 0.
    for Varied { index, number, .. } in system.varied(system.param_dim()) {
        if let Number::Trained { start, min, max } = number {
            let change = 0.01 * start.abs().max(1.0);
            p[index] =
                if start + change <= max { start + change } else { (start - change).max(min) };
        }
    }
    let bits = |x: Vec<f64>| x.into_iter().map(f64::to_bits).collect::<Vec<_>>();
    steps(system, segment).any(|(x, at)| bits(at(&x, 0, &p)) != bits(at(&x, 1, &p)))
}

/// Measured states of a segment, at most [`TESTED`], each with its step as a function of a state, a
/// delay in steps and the parameters. Missing components keep their last value, from 0.
#[expect(clippy::type_complexity, reason = "an iterator of closures has no shorter name")]
fn steps<'a>(
    system: &'a impl System,
    segment: &'a Segment,
) -> impl Iterator<Item = (Vec<f64>, impl Fn(&[f64], usize, &[f64]) -> Vec<f64> + 'a)> + 'a {
    let mut x = vec![0.0; system.state_dim()];
    let zeros = vec![0.0; system.control_dim()];
    let every = segment.x.len().div_ceil(TESTED).max(1);
    let states = segment.x.iter().enumerate().map(move |(i, row)| {
        x.iter_mut().zip(row).filter(|(_, y)| y.is_finite()).for_each(|(x, y)| *x = *y);
        let u = segment.u.get(i).cloned().unwrap_or_else(|| zeros.clone());
        let step = move |x: &[f64], delay: usize, p: &[f64]| {
            let mut next = vec![0.0; x.len()];
            system.step(Inputs { x, u: &u, p, t: segment.first_step + i + delay }, &mut next);
            next
        };
        (x.clone(), step)
    });
    states.step_by(every)
}

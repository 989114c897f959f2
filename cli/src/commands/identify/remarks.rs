//! Sentences about a fit: what it assumes of the data, and what limits its result.

use crate::operations::identification::{may_be_motion, turn, turns};
use crate::platform::terminal::{counted, listed};
use crate::tasks::Scene;
use physgrad::Number;
use physgrad::identify::{Fit, Segment, Status};
use physgrad::text::{digits, rough, short};
use std::f64::consts::PI;

/// Sentences about a fit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Remarks {
    /// What the fit assumes of the data.
    pub notes: Vec<String>,
    /// What limits its result.
    pub warnings: Vec<String>,
}

/// Names of the options of a fit, in advice.
pub struct Words {
    noise: &'static str,
    starts: &'static str,
    window: &'static str,
    /// Advice on times that are too far apart.
    pub far_apart: &'static str,
}

/// The options of `physgrad identify`.
pub const COMMAND: Words = Words {
    noise: "--noise",
    starts: ", use --exact-starts with complete first rows, or choose a longer --window",
    window: " or another --window",
    far_apart: "give `t` in s, not in ms; or set system.dt near the sampling time, with integrator.substeps",
};

/// The arguments of a call from another program, for example Python.
pub const CALL: Words = Words {
    noise: "`noise`",
    starts: ", use `exact_starts=True` with complete first rows, or choose a longer `window`",
    window: " or another `window`",
    far_apart: "give the time in s, or its unit, as in units={\"t\": \"ms\"}; or set system.dt near the sampling time, with \
                integrator.substeps",
};

/// Rows of the fitted segments as they were given.
pub trait Rows {
    /// Measured values of a state in a segment, by row. NaN marks a missing one.
    fn values(&self, segment: usize, component: usize) -> Vec<f64>;
    /// The place of a row, within a sentence and at its beginning.
    fn place(&self, segment: usize, row: usize) -> [String; 2];
}

impl Rows for [Segment] {
    fn values(&self, segment: usize, component: usize) -> Vec<f64> {
        self[segment].x.iter().map(|row| row[component]).collect()
    }

    fn place(&self, segment: usize, row: usize) -> [String; 2] {
        [format!("row {row} of segment {segment}"), format!("segment {segment}, row {row}")]
    }
}

/// Sentences about a fit to `segments`, which `rows` has as they were given.
pub fn remarks(
    fit: &Fit,
    scene: &Scene,
    segments: &[Segment],
    rows: &(impl Rows + ?Sized),
    noise_is_known: bool,
    words: &Words,
) -> Remarks {
    let open = open_starts(scene, segments);
    let mut warnings = of_fit(fit, scene, noise_is_known, !open.is_empty(), words);
    warnings.extend(jumps(fit, scene, rows));
    warnings.extend(astray(fit, scene, segments));
    warnings.extend(correlated(fit, scene, segments, &open, noise_is_known, words));
    if !noise_is_known {
        warnings.extend(misfit(fit, segments, scene));
    }
    let mut notes = nominal(scene, segments);
    notes.extend(removed_turns(fit, scene, rows));
    Remarks { notes, warnings }
}

/// Sentences about numbers that vary between rollouts, and that segments do not give.
fn nominal(scene: &Scene, segments: &[Segment]) -> Vec<String> {
    let names = scene.param_names();
    let mut notes = Vec::new();
    for (name, number) in scene.varied() {
        let place = names.iter().position(|known| *known == name);
        let is_given = |segment: &&Segment| {
            let value = place.and_then(|i| segment.p.get(i));
            value.is_some_and(|value| !value.is_nan())
        };
        let without = segments.len() - segments.iter().filter(is_given).count();
        if without > 0 && !matches!(number, Number::Trained { .. }) {
            notes.push(format!(
                "{} without {name}: the fit uses {}, the nominal value of its distribution",
                counted(without, "segment"),
                digits(number.nominal(), 6)
            ));
        }
    }
    notes
}

/// Sentences about the full turns that the fit removes.
fn removed_turns(fit: &Fit, scene: &Scene, rows: &(impl Rows + ?Sized)) -> Vec<String> {
    let (states, mut notes) = (scene.state_names(), Vec::new());
    for &i in &fit.angles {
        let values: Vec<Vec<f64>> =
            (0..fit.states.len()).map(|segment| rows.values(segment, i)).collect();
        let all: Vec<(usize, usize, f64)> = values
            .iter()
            .enumerate()
            .flat_map(|(segment, values)| {
                turns(values.iter().copied()).map(move |(row, turns)| (segment, row, turns))
            })
            .collect();
        let Some(&(segment, row, _)) = all.first() else { continue };
        let count = all.iter().map(|(.., turns)| turns.abs()).sum::<f64>() as usize;
        let compared = if values.iter().any(|values| may_be_motion(values.iter().copied())) {
            ". Some of these jumps may be motion, but the fit as recorded has a larger χ²"
        } else {
            ""
        };
        notes.push(format!(
            "{} wraps: the fit removes {} between rows, at {} (first {}){compared}",
            states[i],
            counted(count, "full turn"),
            counted(all.len(), "jump"),
            rows.place(segment, row)[0]
        ));
    }
    notes
}

/// Sentences about jumps of states that look like full turns, and that the fit keeps.
fn jumps(fit: &Fit, scene: &Scene, rows: &(impl Rows + ?Sized)) -> Vec<String> {
    let (angles, names) = (scene.angles(), scene.state_names());
    let kept = names.iter().enumerate().filter(|(i, _)| !fit.angles.contains(i));
    let warning = |(i, state): (usize, &String)| {
        let first = |segment: usize| {
            let values = rows.values(segment, i);
            let (row, jump) = turn(values.iter().copied(), angles.contains(&i))?;
            Some((rows.place(segment, row), jump))
        };
        let ([_, place], jump) = (0..fit.states.len()).find_map(first)?;
        let turns = jump.abs() / 360.0;
        let advice = if turns > 0.5 && (turns - turns.round()).abs() < 0.1 {
            "angles are in rad, and this may be a full turn in degrees; convert it"
        } else {
            "if it is an angle that wraps, remove the jumps, as numpy.unwrap does"
        };
        Some(format!("{place}: {state} jumps by {} from the row before; {advice}", short(jump)))
    };
    kept.filter_map(warning).collect()
}

/// Sentences about angles that are more than half a turn from the simulated ones, although the fit
/// removed their full turns: compared modulo a full turn, they would be closer.
fn astray(fit: &Fit, scene: &Scene, segments: &[Segment]) -> Vec<String> {
    let (states, mut warnings) = (scene.state_names(), Vec::new());
    for &i in &fit.angles {
        let rows = segments.iter().zip(&fit.states).map(|(segment, states)| {
            let measured = fit.measured(i, segment);
            measured.iter().zip(states).filter(|(y, x)| (*y - x[i]).abs() > PI).count()
        });
        let rows = rows.sum::<usize>();
        if rows > 0 {
            let state = &states[i];
            warnings.push(format!(
                "without its full turns, {state} is more than half a turn from the simulated one in {}: it may turn by more \
                 than half a turn between two measured rows, and the fit is then wrong; measure {state} in more rows, or \
                 give it without jumps",
                counted(rows, "row")
            ));
        }
    }
    warnings
}

/// States without a measurement in the first row of a segment.
fn open_starts(scene: &Scene, segments: &[Segment]) -> Vec<String> {
    let is_open = |i: usize| segments.iter().any(|segment| segment.x[0][i].is_nan());
    let names = scene.state_names().into_iter().enumerate();
    names.filter(|(i, _)| is_open(*i)).map(|(_, name)| name).collect()
}

/// A warning about residuals that are no independent noise, of a fit with numbers. The initial
/// values of `open` are unmeasured.
fn correlated(
    fit: &Fit,
    scene: &Scene,
    segments: &[Segment],
    open: &[String],
    noise_is_known: bool,
    words: &Words,
) -> Option<String> {
    let names = scene.state_names();
    let found: Vec<String> = { fit.correlated(segments).into_iter() }
        .map(|(i, correlation)| format!("{} ({correlation:.2})", names[i]))
        .collect();
    let starts = if open.is_empty() {
        String::new()
    } else {
        format!("wrong initial values of {}, ", listed(open))
    };
    let weights = if noise_is_known {
        String::new()
    } else {
        format!(", or states of unequal noise without {}", words.noise)
    };
    (!found.is_empty() && !fit.names.is_empty()).then(|| {
        format!(
            "successive residuals are correlated for {}: they are not noise, and the standard errors are too small; use the \
             robust errors. The cause may be the model, {starts}a local minimum, integration errors, a filter of the \
             sensor{weights}",
            listed(&found)
        )
    })
}

/// Largest jump between windows without a warning, in the units of [`Fit::jump`].
const JUMP: f64 = 1e-3;

/// Sentences about what the fit does not determine, explain or reach.
fn of_fit(
    fit: &Fit,
    scene: &Scene,
    noise_is_known: bool,
    has_open_starts: bool,
    words: &Words,
) -> Vec<String> {
    let states = scene.state_names();
    let named = |components: &[usize]| {
        listed(&components.iter().map(|&i| states[i].clone()).collect::<Vec<_>>())
    };
    let mut warnings = of_numbers(fit, scene);
    if !fit.non_finite_starts.is_empty() {
        warnings.push(format!(
            "a derivative by the initial value of {} is not finite, so the iterations ended; choose other initial values",
            named(&fit.non_finite_starts)
        ));
    }
    if !fit.undetermined_starts.is_empty() {
        warnings.push(format!(
            "the data do not determine the initial values of {}; measure them in the first row of each segment{}",
            named(&fit.undetermined_starts),
            words.starts
        ));
    }
    // Without measured initial states, a small excess may be that of a wrong minimum.
    let is_excess = has_open_starts && fit.exceeds_chance();
    if noise_is_known && (fit.is_unlikely() || is_excess) {
        let ratio = fit.chi_squared / fit.freedom() as f64;
        warnings.push(format!(
            "χ² per degree of freedom is {}, which chance does not explain: the residuals are {} times the given noise; check {}, the units \
             of the data, {}and the model",
            rough(ratio),
            rough(ratio.sqrt()),
            words.noise,
            if has_open_starts { "the initial values of unmeasured states, " } else { "" }
        ));
    }
    let is_explained =
        fit.statuses.iter().any(|status| status.is_failure()) || !fit.non_finite_starts.is_empty();
    if !fit.converged && !is_explained {
        warnings.push(format!(
            "the iterations did not end at a smooth minimum of χ²; try other initial values{}",
            words.window
        ));
    }
    if fit.jump > JUMP {
        warnings.push(format!(
            "the simulated states jump by {} times the noise between windows; try other initial values{}",
            rough(fit.jump),
            words.window
        ));
    }
    warnings
}

/// Sentences about numbers that the data do not determine, then about numbers that are at a bound or
/// have no estimate.
fn of_numbers(fit: &Fit, scene: &Scene) -> Vec<String> {
    let undetermined = fit.undetermined.iter().map(|names| match &names[..] {
        [name] => format!("the data do not determine {name}; fix it, or measure a motion that it affects"),
        names => {
            format!("the data do not determine {} separately; fix one of them, or measure a motion with forces", names.join(", "))
        }
    });
    let rows = fit.names.iter().zip(starts(fit, scene)).zip(fit.values.iter().zip(&fit.statuses));
    let of_number = rows.filter_map(|((name, start), (&value, status))| match status {
        Status::AtBound => Some(format!("{name} is at its bound")),
        Status::RanAway => Some(format!(
            "{name} ran away from {} to {}, where it has almost no influence, so χ² has no minimum; give it bounds or another \
             initial value, and check the model",
            digits(start, 6),
            digits(value, 6)
        )),
        Status::NonFinite => Some(format!(
            "a derivative of the simulated states by {name} is not finite at {}, so the iterations ended; choose another \
             initial value, or bounds without such values",
            digits(value, 6)
        )),
        Status::NoSlope => Some(format!(
            "all derivatives of the simulated states by {name} are 0 at {}, although other values change the states, as for a \
             number that is only compared; it kept its initial value; fix it, and compare χ² of several values",
            digits(value, 6)
        )),
        Status::Estimated | Status::Undetermined | Status::NotConverged => None,
    });
    undetermined.chain(of_number).collect()
}

/// State components with a measurement in or after the row `first` of a segment.
pub fn measured_components(segments: &[Segment], first: usize) -> Vec<usize> {
    let rows = || segments.iter().flat_map(|segment| segment.x.iter().skip(first));
    let count = rows().next().map_or(0, Vec::len);
    (0..count).filter(|&i| rows().any(|row| row[i].is_finite())).collect()
}

/// Initial value of each unknown.
pub fn starts(fit: &Fit, scene: &Scene) -> Vec<f64> {
    let varied = scene.varied();
    let start = |name: &String| {
        varied
            .iter()
            .find(|(known, _)| known == name)
            .map_or(f64::NAN, |(_, number)| number.nominal())
    };
    fit.names.iter().map(start).collect()
}

/// Share of the deviation of the data from their mean, above which residuals without a known noise
/// show a misfit.
const MISFIT: f64 = 0.5;

/// Size of residuals that are rounding errors, relative to the largest deviation of the data.
const ROUNDING: f64 = 1e-6;

/// A warning about components with residuals as large as their motion.
fn misfit(fit: &Fit, segments: &[Segment], scene: &Scene) -> Option<String> {
    let deviation = |i: usize| {
        let measured: Vec<f64> = segments
            .iter()
            .flat_map(|segment| fit.measured(i, segment))
            .filter(|y| y.is_finite())
            .collect();
        let mean = measured.iter().sum::<f64>() / measured.len() as f64;
        let squares = measured.iter().map(|y| (y - mean).powi(2)).sum::<f64>();
        (squares / measured.len() as f64).sqrt()
    };
    let rows: Vec<(usize, f64, f64)> = measured_components(segments, 1)
        .into_iter()
        .map(|i| (i, rms(fit, segments, i), deviation(i)))
        .collect();
    let largest = rows.iter().map(|(.., deviation)| *deviation).fold(0.0, f64::max);
    let names = scene.state_names();
    let is_misfit = |&&(_, rms, deviation): &&(usize, f64, f64)| {
        rms > MISFIT * deviation && rms > ROUNDING * largest
    };
    let bad: Vec<String> = { rows.iter().filter(is_misfit) }
        .map(|&(i, rms, deviation)| {
            format!("{} ({} of {})", names[i], short(rms), short(deviation))
        })
        .collect();
    (!bad.is_empty()).then(|| {
        format!(
            "the residuals are nearly as large as the deviation of the data from their mean for {}: the simulation does not \
             explain these data, unless they are mostly noise; check the signs and units of states and controls, the times, the \
             segments, and the model",
            listed(&bad)
        )
    })
}

/// Root mean square of the residuals of a component over all segments that measure it. Segments have
/// equal weights, also if they differ in length.
pub fn rms(fit: &Fit, segments: &[Segment], component: usize) -> f64 {
    let each = segments
        .iter()
        .enumerate()
        .map(|(index, segment)| fit.rms(index, component, segment))
        .filter(|rms| !rms.is_nan());
    let squares: Vec<f64> = each.map(|rms| rms * rms).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

//! Identifies the physical numbers of a measured pendulum of one to three arms. Chooses the
//! friction model by an information criterion, and validates it on segments that the fit does not
//! use.
//!
//! Run: `cargo run --release --example identify -- [measured.csv] [scipy.csv]`
//!
//! `examples/data/README.md` describes the data and their source. `tests/identify/scipy_compare.py`
//! writes `scipy.csv`, the numbers that SciPy finds. The example compares the errors of both fits.

use physgrad::identify::{Fit, IdentifyError, Options, Segment, Unknown, identify};
use physgrad::integrator::RungeKutta;
use physgrad::tasks::{Arm, MultiPendulum};
use physgrad::{Integrated, Number};
use std::error::Error;
use std::time::Instant;

/// Published numbers of each arm, by number of arms. Columns: mass in kg, distance of the center of
/// mass from the joint in m, length in m, moment of inertia in kg m². The length of the last arm is
/// unused, and 0 here.
const PUBLISHED: [&[[f64; 4]]; 3] = [
    &[[0.14758, 0.14775, 0.0, 1.0912e-4]],
    &[[0.093844, 0.108565, 0.172719, 4.3753e-4], [0.137596, 0.116779, 0.0, 1.26883e-3]],
    &[
        [0.258172, 0.160000, 0.172800, 1.0004e-4],
        [0.279428, 0.202939, 0.228700, 3.1416e-4],
        [0.118624, 0.183709, 0.0, 1.6874e-4],
    ],
];
/// Published viscous friction by number of arms, for each arm, N m s/rad.
const FRICTION: [&[f64]; 3] =
    [&[2.2394e-4], &[2.37143e-4, 1.0e-5], &[1.47710e-3, 2.5960e-4, 1.0e-5]];
/// Published gravity by number of arms, m/s².
const GRAVITY: [f64; 3] = [9.81, 9.80858, 9.80834];

/// Placeholder for a physical number of the pendulum that is an entry of the parameters p.
const VARIES: Number = Number::Trained { start: 1.0, min: 0.0, max: f64::INFINITY };
/// Time step of the simulation, s. Sampling times of the data are multiples of it.
const DT: f64 = 0.005;

/// Reads segments from a CSV file with the columns segment, time, angles and rates.
fn read(path: &str) -> Result<Vec<Segment>, Box<dyn Error>> {
    let text =
        std::fs::read_to_string(path).map_err(|error| format!("cannot read {path}: {error}"))?;
    let mut segments: Vec<Segment> = Vec::new();
    for line in text.lines().filter(|line| !line.starts_with('#')).skip(1) {
        let row = line.split(',').map(str::parse).collect::<Result<Vec<f64>, _>>()?;
        if row[1] == 0.0 {
            segments.push(Segment::default());
        }
        let segment = segments.last_mut().ok_or("the first sample of a segment has the time 0")?;
        // The data may have fewer samples than the simulation has steps. Missing states are NaN.
        let step = (row[1] / DT).round() as usize;
        segment.x.resize(step, vec![f64::NAN; row.len() - 2]);
        let (angles, rates) = row[2..].split_at(row.len() / 2 - 1);
        segment
            .x
            .push(angles.iter().zip(rates).flat_map(|(&angle, &rate)| [angle, rate]).collect());
    }
    Ok(segments)
}

/// Models of joint friction: name, and presence of viscous, dry and quadratic friction.
const KINDS: [(&str, [bool; 3]); 6] = [
    ("viscous", [true, false, false]),
    ("dry", [false, true, false]),
    ("viscous + dry", [true, true, false]),
    ("viscous + quadratic", [true, false, true]),
    ("dry + quadratic", [false, true, true]),
    ("all", [true, true, true]),
];

/// A pendulum with numbers p, some of them unknown.
struct Model {
    system: Integrated<MultiPendulum, RungeKutta>,
    p: Vec<f64>,
    unknowns: Vec<Unknown>,
}

impl Model {
    /// Model with the published arms and a gravity of 9.81 m/s². Initial values of unknowns are
    /// `factor` times too large or too small, in turn. For viscous and dry friction, this factor
    /// applies to the published viscous coefficient of the pendulum with one arm. For quadratic
    /// friction, it applies to a tenth of this coefficient. Friction that is not unknown is 0.
    ///
    /// Free swings do not determine a common factor of masses, inertias and frictions, nor one more
    /// combination per arm. The masses and the last inertia therefore keep their published values.
    fn new(arms: usize, kinds: [bool; 3], factor: f64) -> Self {
        let arm = Arm {
            mass: VARIES,
            center: VARIES,
            length: VARIES,
            inertia: VARIES,
            viscous: VARIES,
            dry: VARIES,
            quadratic: VARIES,
        };
        let ode = MultiPendulum { arms: vec![arm; arms], gravity: 9.81.into() };
        let (mut p, mut unknowns) = (Vec::new(), Vec::<Unknown>::new());
        for (i, [mass, center, length, inertia]) in PUBLISHED[arms - 1].iter().copied().enumerate()
        {
            let is_last = i + 1 == arms;
            let friction = FRICTION[0][0];
            let entries = [
                ("mass", mass, false),
                ("center", center, true),
                ("length", length, !is_last),
                ("inertia", inertia, !is_last),
                ("viscous", friction, kinds[0]),
                ("dry", friction, kinds[1]),
                ("quadratic", 0.1 * friction, kinds[2]),
            ];
            for (k, (name, value, is_unknown)) in entries.into_iter().enumerate() {
                let start = if unknowns.len() % 2 == 0 { value * factor } else { value / factor };
                if is_unknown {
                    // With fixed masses, only the sum inertia + mass center² has to be positive.
                    let min = if name == "inertia" { f64::NEG_INFINITY } else { 0.0 };
                    unknowns.push(Unknown {
                        name: format!("{name}_{}", i + 1),
                        index: p.len(),
                        start,
                        min,
                        max: f64::INFINITY,
                    });
                }
                let absent = if k < 4 { value } else { 0.0 };
                p.push(if is_unknown { start } else { absent });
            }
        }
        Self { system: Integrated { ode, integrator: RungeKutta::RK4, dt: DT }, p, unknowns }
    }

    /// Model with the published arms, viscous friction and gravity.
    fn published(arms: usize) -> Self {
        let mut model = Self::new(arms, [true, false, false], 1.0);
        model.system.ode.gravity = GRAVITY[arms - 1].into();
        FRICTION[arms - 1]
            .iter()
            .enumerate()
            .for_each(|(i, friction)| model.p[7 * i + 4] = *friction);
        model
    }

    /// Replaces unknown numbers by name. Ignores other names.
    fn with<'a>(mut self, values: impl Iterator<Item = (&'a str, f64)>) -> Self {
        for (name, value) in values {
            if let Some(unknown) = self.unknowns.iter().find(|unknown| unknown.name == name) {
                self.p[unknown.index] = value;
            }
        }
        self
    }

    fn fit(&self, segments: &[Segment], unknowns: &[Unknown]) -> Result<Fit, IdentifyError> {
        let options = Options {
            noise: Some([0.003, 0.1].repeat(segments[0].x[0].len() / 2)),
            ..Options::default()
        };
        let segments: Vec<Segment> = segments
            .iter()
            .map(|segment| Segment { p: self.p.clone(), ..segment.clone() })
            .collect();
        identify(&self.system, &segments, unknowns, &options)
    }

    /// Root mean square errors of all angles in each segment, with fitted initial states.
    fn errors(&self, segments: &[Segment]) -> Result<Vec<f64>, IdentifyError> {
        let fit = self.fit(segments, &[])?;
        Ok((0..segments.len()).map(|i| angle_error(&fit, i, &segments[i])).collect())
    }
}

fn angle_error(fit: &Fit, index: usize, segment: &Segment) -> f64 {
    let arms = segment.x[0].len() / 2;
    ((0..arms).map(|i| fit.rms(index, 2 * i, segment).powi(2)).sum::<f64>() / arms as f64).sqrt()
}

/// Numbers found by SciPy: friction, segments (all or half), name, value.
fn scipy(path: &str) -> Result<Vec<[String; 4]>, Box<dyn Error>> {
    let text =
        std::fs::read_to_string(path).map_err(|error| format!("cannot read {path}: {error}"))?;
    let cells = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        [cells[0], cells[1], cells[3], cells[4]].map(String::from)
    };
    Ok(text.lines().skip(1).map(cells).collect())
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let path = args.next().unwrap_or_else(|| "examples/data/double_pendulum.csv".into());
    let others = args.next().map_or(Ok(Vec::new()), |path| scipy(&path))?;
    let segments = read(&path)?;
    let arms = segments[0].x[0].len() / 2;

    let mut best = (f64::INFINITY, KINDS[0]);
    for (name, kinds) in KINDS {
        let model = Model::new(arms, kinds, 1.3);
        let begin = Instant::now();
        let fit = model.fit(&segments, &model.unknowns)?;
        println!(
            "{name}: BIC {:.0}, {} iterations, {} simulations, {} Jacobians, {:.2} s, converged {}",
            fit.bic(),
            fit.iterations,
            fit.simulations,
            fit.jacobians,
            begin.elapsed().as_secs_f64(),
            fit.converged
        );
        for (i, unknown) in model.unknowns.iter().enumerate() {
            let (value, error, robust) = (fit.values[i], fit.errors[i], fit.robust_errors[i]);
            println!(
                "  {:<12} {:>11.4e} -> {value:>11.4e} ± {error:.1e} (robust {robust:.1e})",
                unknown.name, unknown.start
            );
        }
        if !fit.undetermined.is_empty() {
            println!("  not determined: {:?}", fit.undetermined);
        }
        if fit.bic() < best.0 {
            best = (fit.bic(), (name, kinds));
        }
    }

    let (name, kinds) = best.1;
    let half: Vec<Segment> = segments.iter().step_by(2).cloned().collect();
    let rest: Vec<Segment> = segments.iter().skip(1).step_by(2).cloned().collect();
    for (title, subset, fitted, evaluated) in [
        ("fitted to all segments", "all", &segments, &segments),
        ("fitted to half, errors of the others", "half", &half, &rest),
    ] {
        println!("{title}: root mean square angle errors, rad");
        let model = Model::new(arms, kinds, 1.3);
        let fit = model.fit(fitted, &model.unknowns)?;
        let found = fit.names.iter().map(String::as_str).zip(fit.values.iter().copied());
        let ours = model.with(found).errors(evaluated)?;
        let mut rows = vec![(format!("physgrad, {name}"), ours.clone())];
        rows.push(("published".into(), Model::published(arms).errors(evaluated)?));
        for (kind, kinds) in KINDS {
            let chosen = others.iter().filter(|row| row[0] == kind && row[1] == subset);
            let values: Vec<(&str, f64)> = chosen
                .map(|row| Ok((&*row[2], row[3].parse()?)))
                .collect::<Result<_, Box<dyn Error>>>()?;
            if !values.is_empty() {
                let model = Model::new(arms, kinds, 1.0).with(values.into_iter());
                rows.push((format!("SciPy, {kind}"), model.errors(evaluated)?));
            }
        }
        for (label, errors) in &rows {
            let mut sorted = errors.clone();
            sorted.sort_by(f64::total_cmp);
            let (median, max) = (
                0.5 * (sorted[(sorted.len() - 1) / 2] + sorted[sorted.len() / 2]),
                sorted[sorted.len() - 1],
            );
            // Also counts errors that are equal up to the tolerances of the fits.
            let wins =
                ours.iter().zip(errors).filter(|(ours, other)| **ours <= 1.001 * **other).count();
            let each: Vec<String> = errors.iter().map(|error| format!("{error:.4}")).collect();
            println!(
                "  {label:<28} median {median:.4}, max {max:.4}; ours is at most this in {wins} of {}",
                ours.len()
            );
            println!("    {}", each.join(" "));
        }
    }
    Ok(())
}

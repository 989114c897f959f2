//! Identifies the physical numbers of a measured pendulum of one to three arms, and chooses the
//! friction by an information criterion.
//!
//! Run: `cargo run --release --example identify -- [measured.csv] [every]`
//!
//! `every` uses one segment in so many for the fit and the others for validation. The data and
//! their source: `examples/data/README.md`.

use physgrad::identify::{Fit, Options, Segment, Unknown, identify};
use physgrad::tasks::{Arm, MultiPendulum};
use physgrad::{Integrated, Number, RungeKutta};
use std::error::Error;
use std::time::Instant;

/// Published numbers of each arm: mass, center, length, inertia (SI units), by number of arms.
const PUBLISHED: [&[[f64; 4]]; 3] = [
    &[[0.14758, 0.14775, 0.0, 1.0912e-4]],
    &[[0.093844, 0.108565, 0.172719, 4.3753e-4], [0.137596, 0.116779, 0.0, 1.26883e-3]],
    &[[0.258172, 0.160000, 0.172800, 1.0004e-4], [0.279428, 0.202939, 0.228700, 3.1416e-4], [0.118624, 0.183709, 0.0, 1.6874e-4]],
];
/// Published viscous friction, N m s/rad.
const FRICTION: [&[f64]; 3] = [&[2.2394e-4], &[2.37143e-4, 1.0e-5], &[1.47710e-3, 2.5960e-4, 1.0e-5]];

const VARIES: Number = Number::Trained { start: 1.0, min: 0.0, max: f64::INFINITY };
/// Sampling interval of the data, s.
const DT: f64 = 0.005;

/// Reads segments: columns segment, time, angles, rates.
fn read(path: &str) -> Result<Vec<Segment>, Box<dyn Error>> {
    let text = std::fs::read_to_string(path).map_err(|error| format!("cannot read {path}: {error}"))?;
    let mut segments: Vec<Segment> = Vec::new();
    for line in text.lines().filter(|line| !line.starts_with('#')).skip(1) {
        let row = line.split(',').map(str::parse).collect::<Result<Vec<f64>, _>>()?;
        if row[1] == 0.0 {
            segments.push(Segment::default());
        }
        let segment = segments.last_mut().ok_or("the first sample of a segment has the time 0")?;
        // Samples may be thinned: steps without a sample are missing.
        let step = (row[1] / DT).round() as usize;
        segment.x.resize(step, vec![f64::NAN; row.len() - 2]);
        let (angles, rates) = row[2..].split_at(row.len() / 2 - 1);
        segment.x.push(angles.iter().zip(rates).flat_map(|(&angle, &rate)| [angle, rate]).collect());
    }
    Ok(segments)
}

/// Joint friction: viscous, dry, quadratic.
const KINDS: [(&str, [bool; 3]); 6] = [
    ("viscous", [true, false, false]),
    ("dry", [false, true, false]),
    ("viscous + dry", [true, true, false]),
    ("viscous + quadratic", [true, false, true]),
    ("dry + quadratic", [false, true, true]),
    ("all", [true, true, true]),
];

type Pendulum = Integrated<MultiPendulum, RungeKutta>;

/// The pendulum, its fixed and initial numbers p, and the unknown entries of p.
///
/// Free swings determine masses, inertias and frictions up to a common factor, and one more
/// combination: the masses and the last inertia keep their published values.
fn model(arms: usize, kinds: [bool; 3], factor: f64) -> (Pendulum, Vec<f64>, Vec<Unknown>) {
    let arm =
        Arm { mass: VARIES, center: VARIES, length: VARIES, inertia: VARIES, viscous: VARIES, dry: VARIES, quadratic: VARIES };
    let ode = MultiPendulum { arms: vec![arm; arms], gravity: 9.81.into() };
    let (mut p, mut unknowns) = (Vec::new(), Vec::new());
    for (i, [mass, center, length, inertia]) in PUBLISHED[arms - 1].iter().copied().enumerate() {
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
        for (name, value, is_unknown) in entries {
            // Alternates between too large and too small.
            let start = if unknowns.len() % 2 == 0 { value * factor } else { value / factor };
            if is_unknown {
                // With fixed masses, only the sum of inertia and m a² has to be positive.
                let min = if name == "inertia" { f64::NEG_INFINITY } else { 0.0 };
                unknowns.push(Unknown { name: format!("{name}_{}", i + 1), index: p.len(), start, min, max: f64::INFINITY });
            }
            let absent = name == "viscous" || name == "dry" || name == "quadratic";
            p.push(if is_unknown {
                start
            } else if absent {
                0.0
            } else {
                value
            });
        }
    }
    (Integrated { ode, integrator: RungeKutta::RK4, dt: DT }, p, unknowns)
}

/// Root mean square error of all angles in a segment.
fn angle_error(fit: &Fit, index: usize, segment: &Segment) -> f64 {
    let arms = segment.x[0].len() / 2;
    ((0..arms).map(|i| fit.rms(index, 2 * i, segment).powi(2)).sum::<f64>() / arms as f64).sqrt()
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let path = args.next().unwrap_or_else(|| "examples/data/double_pendulum.csv".into());
    let every: usize = args.next().map_or(Ok(1), |text| text.parse())?;
    let segments = read(&path)?;
    let arms = segments[0].x[0].len() / 2;
    let noise = [0.003, 0.1].repeat(arms);
    let options = Options { noise: Some(noise), ..Options::default() };
    let scaled =
        |p: &[f64]| -> Vec<Segment> { segments.iter().map(|segment| Segment { p: p.to_vec(), ..segment.clone() }).collect() };
    for (name, kinds) in KINDS {
        let (system, p, unknowns) = model(arms, kinds, 1.3);
        let all = scaled(&p);
        let fitted: Vec<Segment> = all.iter().step_by(every).cloned().collect();
        let begin = Instant::now();
        let fit = identify(&system, &fitted, &unknowns, &options)?;
        println!(
            "{name}: BIC {:.0}, {} iterations, {} simulations, {} Jacobians, {:.2} s, converged {}",
            fit.bic(),
            fit.iterations,
            fit.simulations,
            fit.jacobians,
            begin.elapsed().as_secs_f64(),
            fit.converged
        );
        for (i, unknown) in unknowns.iter().enumerate() {
            println!("  {:<12} {:>11.4e} -> {:>11.4e} ± {:.1e}", unknown.name, unknown.start, fit.values[i], fit.errors[i]);
        }
        if !fit.undetermined.is_empty() {
            println!("  not determined: {:?}", fit.undetermined);
        }
        let errors: Vec<String> =
            fitted.iter().enumerate().map(|(i, segment)| format!("{:.4}", angle_error(&fit, i, segment))).collect();
        println!("  angle errors, rad: {}", errors.join(" "));
    }
    Ok(())
}

//! Forces at four points bring an elastic rod of 100 masses to rest, with default derivatives.
//!
//! Run: `cargo run --release --example rod -- [epochs] [picture.svg]`

use physgrad::policy::Linear;
use physgrad::prelude::*;
use physgrad::rng::Purpose;
use physgrad::train::Decay;
use physgrad::{Clip, Rollout, Training, initial_states};
use physgrad_plot::{Posture, Stage, mechanics};

const MASSES: usize = 100;
const STEPS: usize = 150;

/// Masses of 1 kg in a row between two walls. Springs connect neighbouring masses, and the outer
/// masses with the walls. A spring has the force k d + k₃ d³, with `stiffness` k, `hardening` k₃
/// and the difference d of the deflections. Viscous friction, with the coefficient `damping`, acts
/// on each mass. State: sideways deflections, m, then speeds, m/s. Control: forces at four masses,
/// N.
#[derive(Clone)]
#[rustfmt::skip]
struct Rod { stiffness: f64, hardening: f64, damping: f64, dt: f64 }

#[rustfmt::skip]
impl System for Rod {
    fn state_dim(&self) -> usize { 2 * MASSES }
    fn control_dim(&self) -> usize { 4 }
    #[inline(always)]
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        let ((q, v), (q_next, v_next)) = (x.split_at(MASSES), next.split_at_mut(MASSES));
        let spring = |d: T| d * (d * d * self.hardening + self.stiffness);
        let mut left = spring(q[0]);
        for i in 0..MASSES {
            let right = spring(if i + 1 < MASSES { q[i + 1] - q[i] } else { -q[i] });
            v_next[i] = v[i] + (right - left - v[i] * self.damping) * self.dt;
            left = right;
        }
        for (k, &u) in u.iter().enumerate() { v_next[20 * (k + 1) - 1] += u * self.dt; }
        for i in 0..MASSES { q_next[i] = q[i] + v_next[i] * self.dt; }
    }
}

#[rustfmt::skip]
impl Task for Rod {
    type System = Self;
    fn system(&self) -> &Self { self }
    fn horizon(&self) -> usize { STEPS }
    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) {
        for mode in 1..=3 {
            let height = rng.random_range(-1.0..1.0) / f64::from(mode);
            let wave = |i: usize| (f64::from(mode) * std::f64::consts::PI * (i + 1) as f64 / 101.0).sin();
            x[..MASSES].iter_mut().enumerate().for_each(|(i, q)| *q += height * wave(i));
        }
    }
    #[inline(always)]
    fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, next: &[T]) -> T {
        next.iter().map(|&x| x * x).sum::<T>() * 1e-3 + u.iter().map(|&u| u * u).sum::<T>() * 1e-5
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let epochs = args.next().map_or(Ok(120), |text| text.parse())?;
    let (task, policy) = (
        Rod { stiffness: 800.0, hardening: 2000.0, damping: 0.05, dt: 0.03 },
        Linear::new(2 * MASSES, 4),
    );
    check::system(&task).unwrap();
    let training = Training {
        epochs,
        clip: Clip::Norm(1.0),
        decay: Decay::Cosine { end: 0.0 },
        ..Training::default()
    };
    let report = Trainer::new(task.clone(), policy.clone())
        .field(Field::regular())
        .training(training)
        .run()?;

    const SAMPLES: usize = 64;
    let starts = initial_states(&task, 0, Purpose::Test, SAMPLES);
    let mut rollout = Rollout::new(&task, &policy, SAMPLES);
    rollout.start(&starts);
    rollout.run(&task, &policy, &report.weights)?;
    // Sum of kinetic and potential energy, J.
    let energy = |sample: usize, t: usize| {
        let x: Vec<f64> = (0..2 * MASSES).map(|i| f64::from(rollout.state(t, sample, i))).collect();
        let ends = [&[0.0], &x[..MASSES], &[0.0]].concat();
        let stored = |d: f64| 0.5 * task.stiffness * d * d + 0.25 * task.hardening * d.powi(4);
        ends.windows(2).map(|ends| stored(ends[1] - ends[0])).sum::<f64>()
            + x[MASSES..].iter().map(|v| 0.5 * v * v).sum::<f64>()
    };
    let mut left: Vec<f64> =
        (0..SAMPLES).map(|sample| 100.0 * energy(sample, STEPS) / energy(sample, 0)).collect();
    left.sort_by(f64::total_cmp);
    println!(
        "energy left after 4.5 s: median {:.2} %, largest {:.2} %",
        left[SAMPLES / 2],
        left[SAMPLES - 1]
    );
    if let Some(path) = args.next() {
        let posture = |t: usize| {
            let point =
                |i: usize| [6.0 * i as f64 / MASSES as f64, f64::from(rollout.state(t, 0, i))];
            Posture { chain: (0..MASSES).step_by(3).map(point).collect(), boxes: Vec::new() }
        };
        let stage = Stage {
            title: "Elastic rod brought to rest".into(),
            size: 0.05,
            floor: None,
            mark: None,
        };
        let postures: Vec<Posture> = (0..=STEPS).step_by(2).map(posture).collect();
        std::fs::write(path, mechanics(&stage, &postures, 2.0 * task.dt).to_svg())?;
    }
    Ok(())
}

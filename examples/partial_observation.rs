//! A recurrent policy swings up a cart-pole from observed positions, without velocities.
//!
//! Run: `cargo run --release --example partial_observation -- [epochs] [picture.svg]`

use physgrad::policy::Gru;
use physgrad::prelude::*;
use physgrad::rng::Purpose;
use physgrad::tasks::CartPoleSystem;
use physgrad::{Clip, Rollout, Training, initial_states};
use physgrad_plot::{Animation, Shape};
use std::f64::consts::PI;

/// Swing-up of one pole from near hanging. State [position m, velocity m/s, angle rad (0 = up),
/// rate rad/s].
#[derive(Clone)]
#[rustfmt::skip]
pub struct PositionsOnly { pub cart_pole: CartPoleSystem }

const STEPS: usize = 100;

#[rustfmt::skip]
impl Task for PositionsOnly {
    type System = CartPoleSystem;
    fn system(&self) -> &CartPoleSystem { &self.cart_pole }
    fn horizon(&self) -> usize { STEPS }
    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x.fill_with(|| rng.random_range(-0.3..0.3));
        x[2] += PI;
    }
    fn observation_dim(&self) -> Option<usize> { Some(3) }
    fn observe<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, y: &mut [T]) {
        (y[0], (y[1], y[2])) = (x[0], x[2].sin_cos());
    }
    fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, next: &[T]) -> T {
        (T::one() - next[2].cos() + next[0] * next[0] * 0.1 + u[0] * u[0] * 1e-4) * (1.0 / STEPS as f64)
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let epochs = args.next().map_or(Ok(200), |text| text.parse())?;
    let task =
        PositionsOnly { cart_pole: CartPoleSystem { dt: 0.02, ..CartPoleSystem::default() } };
    let policy = Gru::new(3, 24, 1);
    check::task(&task, &policy).unwrap();
    let training = Training {
        epochs,
        learning_rate: 1e-2,
        clip: Clip::Norm(1.0),
        workers: 2,
        ..Training::default()
    };
    let report =
        Trainer::new(task.clone(), policy).field(Field::regular()).training(training).run()?;

    const SAMPLES: usize = 64;
    let mut rollout = Rollout::new(&task, &policy, SAMPLES);
    rollout.start(&initial_states(&task, 0, Purpose::Test, SAMPLES));
    rollout.run(&task, &policy, &report.weights)?;
    let state = |sample: usize, t: usize, i: usize| f64::from(rollout.state(t, sample, i));
    let upright = (0..SAMPLES).filter(|&sample| state(sample, STEPS, 2).cos() > 0.95).count();
    println!("poles within 18 degrees of upright after 2 s: {upright} of {SAMPLES}");
    if let Some(last) = report.records.last() {
        println!("test loss after training with R: {:.3}", last.test_loss);
    }
    if let Some(path) = args.next() {
        let length = 2.0 * task.cart_pole.half_length.nominal();
        let frame = |t: usize| {
            let (cart, angle) = ([state(0, t, 0), 0.0], state(0, t, 2));
            let tip = [cart[0] + length * angle.sin(), length * angle.cos()];
            vec![
                Shape::Rect { center: cart, size: [0.4, 0.2], color: "#5B6470" },
                Shape::Line { from: cart, to: tip, width: 0.06, color: "#0072B2" },
            ]
        };
        let picture = Animation {
            title: "Swing-up from observed positions, by a recurrent policy".into(),
            seconds: STEPS as f64 * task.cart_pole.dt,
            view: ([-2.5, -1.2], [2.5, 1.2]),
            still: vec![Shape::Line {
                from: [-2.5, -0.1],
                to: [2.5, -0.1],
                width: 0.01,
                color: "#9AA0A8",
            }],
            frames: (0..=STEPS).map(frame).collect(),
            ..Animation::default()
        };
        std::fs::write(path, picture.to_svg())?;
    }
    Ok(())
}

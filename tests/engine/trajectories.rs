//! Derivatives of whole trajectories by given cotangents, and transitions in one call.

use super::noise::pendulum;
use physgrad::engine::{open_loop, rows};
use physgrad::number::NoiseNumbers;
use physgrad::policy::{AnyPolicy, Gru, Mlp, OpenLoop};
use physgrad::rng::{Purpose, stream};
use physgrad::train::Trajectories;
use physgrad::train::calls::{rollout, rollout_vjp};
use physgrad::{Field, Flow, Inputs, System, Task, Weights, gradients, initial_states};

/// Deterministic numbers between -1 and 1.
fn numbers(count: usize) -> Vec<f64> {
    (0..count).map(|i| (0.7 + 1.3 * i as f64).sin()).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn assert_close(found: &[f64], expected: &[f64], tolerance: f64, what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let size = expected.iter().fold(0.0_f64, |size, x| size.max(x.abs()));
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!((found - expected).abs() <= tolerance * size, "{what}, {i}: {found} {expected}");
    }
}

/// Cotangents of the mean loss: the gradients of the costs with respect to states and controls.
fn cotangents_of_the_loss(
    task: &impl Task,
    starts: &[f64],
    found: &Trajectories<f64>,
) -> Trajectories<f64> {
    let (n, m, params, horizon) = (2, 1, task.param_dim(), task.horizon());
    let width = n + params + 1;
    let noise = NoiseNumbers::of(&task.system().varied(params));
    let samples = starts.len() / width;
    let mut bars = Trajectories {
        states: vec![0.0; found.states.len()],
        controls: vec![0.0; found.controls.len()],
    };
    for sample in 0..samples {
        let start = &starts[sample * width..][..width];
        let (of_x, of_u) = (sample * (horizon + 1) * n, sample * horizon * m);
        let mut p = start[n..][..params].to_vec();
        for t in 0..horizon {
            noise.at(start[width - 1], t, |i, value| p[i] = value);
            let [x, next] = [t, t + 1].map(|t| &found.states[of_x + t * n..][..n]);
            let u = &found.controls[of_u + t * m..][..m];
            let inputs = Inputs { x, u, p: &p, t };
            let (mut x_bar, mut u_bar, mut next_bar) = ([0.0; 2], [0.0; 1], [0.0; 2]);
            let weight = [1.0 / samples as f64];
            let all = [&mut x_bar[..], &mut u_bar, &mut next_bar, &mut []];
            rows::running_cost_vjp(task, inputs, next, &weight, all);
            if t + 1 == horizon {
                let mut last_bar = [0.0; 2];
                rows::terminal_cost_vjp(task, next, &p, &weight, [&mut last_bar, &mut []]);
                (0..n).for_each(|i| next_bar[i] += last_bar[i]);
            }
            for i in 0..n {
                bars.states[of_x + t * n + i] += x_bar[i];
                bars.states[of_x + (t + 1) * n + i] += next_bar[i];
            }
            bars.controls[of_u + t] += u_bar[0];
        }
    }
    bars
}

#[test]
fn cotangents_of_the_loss_give_its_gradients_along_every_flow() {
    let task = pendulum();
    let starts: Vec<f64> = initial_states(&task, 3, Purpose::Train, 37);
    let policies: [&dyn AnyPolicy<f64>; 2] = [&Mlp::new([2, 6, 1]), &Gru::new(2, 5, 1)];
    for policy in policies {
        let weights = Weights::init(policy, &mut stream(1, Purpose::Policy, 0));
        let found = rollout(&task, policy, &weights, &starts).expect("finite");
        let bars = cotangents_of_the_loss(&task, &starts, &found);
        let flows = [Flow::REGULAR, Flow::MODIFIED, Flow::NETWORK, Flow::STOPPED];
        let fields = ["R", "M", "N", "S"].map(|name| name.parse::<Field>().expect("a field"));
        let expected = gradients(&task, policy, &weights, &starts, &fields).expect("finite");
        for (flow, expected) in flows.into_iter().zip(&expected) {
            let (theta_bar, _) =
                rollout_vjp(&task, policy, &weights, &starts, &bars, flow).expect("finite");
            assert_close(&theta_bar, expected, 1e-12, &flow.to_string());
        }
    }
}

#[test]
fn derivatives_of_a_trajectory_are_those_of_differences() {
    let task = pendulum();
    let policy = Mlp::new([2, 6, 1]);
    let theta = Weights::<f64>::init(&policy, &mut stream(1, Purpose::Policy, 0)).theta().to_vec();
    let starts: Vec<f64> = initial_states(&task, 3, Purpose::Train, 11);
    let width = starts.len() / 11;
    let of = |theta: Vec<f64>, starts: &[f64]| {
        rollout(&task, &policy, &Weights::new(&policy, theta), starts).expect("finite")
    };
    let found = of(theta.clone(), &starts);
    let bars = Trajectories {
        states: numbers(found.states.len()),
        controls: numbers(found.controls.len()),
    };
    let value =
        |at: &Trajectories<f64>| dot(&at.states, &bars.states) + dot(&at.controls, &bars.controls);
    let weights = Weights::new(&policy, theta.clone());
    let (theta_bar, starts_bar) =
        rollout_vjp(&task, &policy, &weights, &starts, &bars, Flow::REGULAR).expect("finite");
    let h = 1e-5;
    let moved = |numbers: &[f64], i: usize, h: f64| {
        let mut moved = numbers.to_vec();
        moved[i] += h;
        moved
    };
    let differences = |i: usize| {
        value(&of(moved(&theta, i, h), &starts)) - value(&of(moved(&theta, i, -h), &starts))
    };
    let expected: Vec<f64> = (0..theta.len()).map(|i| differences(i) / (2.0 * h)).collect();
    assert_close(&theta_bar, &expected, 1e-7, "parameters");
    // State, then `length`, the only number that is no noise.
    let names = task.system().varied(task.param_dim());
    let length = names.iter().find(|varied| varied.name.ends_with("length")).expect("a name").index;
    for sample in [0, 7, 8, 10] {
        for i in [0, 1, 2 + length] {
            let at = sample * width + i;
            let difference = value(&of(theta.clone(), &moved(&starts, at, h)))
                - value(&of(theta.clone(), &moved(&starts, at, -h)));
            let expected = difference / (2.0 * h);
            let error = (starts_bar[at] - expected).abs();
            assert!(error <= 1e-6 * expected.abs().max(1.0), "{at}: {} {expected}", starts_bar[at]);
        }
        let noise = NoiseNumbers::of(&task.system().varied(task.param_dim()));
        noise.at(0.0, 0, |i, _| assert_eq!(starts_bar[sample * width + 2 + i], 0.0, "noise {i}"));
        assert_eq!(starts_bar[sample * width + width - 1], 0.0, "the key of the noise");
    }
}

#[test]
fn given_controls_give_the_rollouts_and_derivatives_of_an_open_loop() {
    let task = pendulum();
    let (horizon, n) = (task.horizon(), 2);
    let policy = OpenLoop::new(n, 1, horizon);
    let starts: Vec<f64> = initial_states(&task, 5, Purpose::Train, 9);
    let (width, controls) = (starts.len() / 9, numbers(9 * horizon));
    let states = open_loop::states(&task, &starts, &controls, horizon);
    let states_bar = numbers(states.len());
    let [starts_bar, controls_bar] =
        open_loop::states_vjp(&task, &starts, &controls, &states, &states_bar);
    for sample in 0..9 {
        let start = &starts[sample * width..][..width];
        let theta = controls[sample * horizon..][..horizon].to_vec();
        let weights = Weights::new(&policy, theta);
        let found = rollout(&task, &policy, &weights, start).expect("finite");
        let of_states = sample * (horizon + 1) * n..(sample + 1) * (horizon + 1) * n;
        assert_eq!(states[of_states.clone()], found.states, "sample {sample}");
        let bars =
            Trajectories { states: states_bar[of_states].to_vec(), controls: vec![0.0; horizon] };
        let (theta_bar, start_bar) =
            rollout_vjp(&task, &policy, &weights, start, &bars, Flow::REGULAR).expect("finite");
        assert_close(&controls_bar[sample * horizon..][..horizon], &theta_bar, 1e-12, "controls");
        assert_close(&starts_bar[sample * width..][..width], &start_bar, 1e-12, "start");
    }
    // A shorter rollout has the first states of the long one.
    let short = open_loop::states(&task, &starts[..width], &controls[..4], 4);
    assert_eq!(short, states[..5 * n]);
}

#[test]
fn a_transition_is_its_three_parts() {
    let task = pendulum();
    let (samples, params) = (21, task.param_dim());
    let (x, u) = (numbers(2 * samples), numbers(samples));
    let p: Vec<f64> = numbers(params * samples).iter().map(|p| p + 2.0).collect();
    let inputs = Inputs { x: &x, u: &u, p: &p, t: 4 };
    let zeros = |width: usize| vec![0.0; width * samples];
    let (mut next, mut y, mut cost) = (zeros(2), zeros(2), zeros(1));
    rows::transition(&task, inputs, [&mut next, &mut y, &mut cost]);
    let (mut next_alone, mut y_alone, mut cost_alone) = (zeros(2), zeros(2), zeros(1));
    rows::step(&task, inputs, &mut next_alone);
    let seen = Inputs { x: &next, u: &[], p: &p, t: 5 };
    rows::observe(&task, seen, &mut y_alone);
    rows::running_cost(&task, inputs, &next, &mut cost_alone);
    assert_eq!((&next, &y, &cost), (&next_alone, &y_alone, &cost_alone));

    let bars = [numbers(2 * samples), numbers(2 * samples), numbers(samples)];
    let [next_bar, y_bar, cost_bar] = bars.each_ref().map(|bar| &bar[..]);
    let (mut x_bar, mut u_bar, mut p_bar) = (zeros(2), zeros(1), zeros(params));
    let all = [&mut x_bar[..], &mut u_bar, &mut p_bar];
    rows::transition_vjp(&task, inputs, &next, [next_bar, y_bar, cost_bar], all);
    let (mut x_1, mut u_1, mut next_1, mut p_1) = (zeros(2), zeros(1), zeros(2), zeros(params));
    let all = [&mut x_1[..], &mut u_1, &mut next_1, &mut p_1];
    rows::running_cost_vjp(&task, inputs, &next, cost_bar, all);
    let (mut next_2, mut p_2) = (zeros(2), zeros(params));
    rows::observe_vjp(&task, seen, y_bar, [&mut next_2, &mut p_2]);
    let total: Vec<f64> = (0..next.len()).map(|i| next_bar[i] + next_1[i] + next_2[i]).collect();
    let (mut x_3, mut u_3, mut p_3) = (zeros(2), zeros(1), zeros(params));
    rows::step_vjp(&task, inputs, &total, [&mut x_3, &mut u_3, &mut p_3]);
    let sum = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a + b).collect::<Vec<_>>();
    assert_close(&x_bar, &sum(&x_1, &x_3), 1e-14, "states");
    assert_close(&u_bar, &sum(&u_1, &u_3), 1e-14, "controls");
    assert_close(&p_bar, &sum(&sum(&p_1, &p_2), &p_3), 1e-14, "parameters");
}

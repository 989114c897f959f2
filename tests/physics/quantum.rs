//! Tests of quantum control: derivatives, the authors' reference data, conserved probability.

use physgrad::policy::{Conv, PolicyColumns, PolicyPass};
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::{LossMode, Quantum, QuantumSystem};
use physgrad::{Cotangents, Inputs, Policy, Scalar, System, Task, Weights, check, initial_states};
use serde_json::Value;

fn system(grid: usize) -> QuantumSystem {
    QuantumSystem { grid, ..QuantumSystem::default() }
}

fn norm(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x).sum::<f64>().sqrt()
}

#[test]
fn derivatives_on_grids_of_3_to_70_points_equal_dual_numbers() {
    for grid in [3, 8, 32, 33, 70] {
        println!("grid {grid}: {:?}", check::system(&system(grid)).unwrap());
    }
    // With this control, the matrix of the step is not diagonally dominant.
    let draw = |_: &mut _, x: &mut [f64], u: &mut [f64], _: &mut [f64]| {
        x.iter_mut().enumerate().for_each(|(i, x)| *x = (i as f64).sin());
        u[0] = -500.0;
    };
    check::system_at(&system(32), draw).unwrap_or_else(|mismatch| panic!("{mismatch}"));
}

#[test]
fn derivatives_of_convolutions_of_nine_shapes_equal_dual_numbers() {
    for (grid, width) in
        [(7, 1), (8, 3), (9, 8), (10, 15), (11, 16), (32, 5), (33, 17), (32, 24), (41, 4)]
    {
        println!(
            "grid {grid}, width {width}: {:?}",
            check::policy(&Conv::new(grid, width)).unwrap()
        );
    }
}

/// Adjacent samples share a matrix product, which also computes windows across their border.
/// Results are independent of these windows.
#[test]
fn a_sample_does_not_depend_on_adjacent_samples() {
    let policy = Conv::new(33, 7);
    let (n, total) = (66, 11);
    let weights = Weights::<f64>::init(&policy, &mut stream(0, Purpose::Policy, 0));
    let mut x: Vec<f64> = (0..n * total).map(|i| Scalar::sin(i as f64)).collect();
    x[4 * n..5 * n].fill(f64::NAN);
    let run = |pieces: &[PolicyColumns]| {
        let sizes = policy.sizes::<f64>(total);
        let (mut tape, mut tape_bar) = (vec![0.0; sizes.tape], vec![0.0; sizes.tape_bar]);
        let (mut u, mut x_bar) = (vec![f64::NAN; total], vec![f64::NAN; n * total]);
        let pass = |&at: &PolicyColumns| PolicyPass::new(weights.packed(), at, &x);
        for at in pieces {
            policy.forward(pass(at), &mut tape, &mut u);
        }
        for at in pieces {
            let ones = vec![1.0; total];
            policy.backward(pass(at), &tape, &ones, &mut tape_bar, Some(&mut x_bar));
        }
        u.into_iter().chain(x_bar).collect::<Vec<f64>>()
    };
    let together = run(&[PolicyColumns::range(0..total)]);
    let single: Vec<_> = (0..total).map(|c| PolicyColumns::range(c..c + 1)).collect();
    let turns = [
        PolicyColumns { first: 0, step: 2, count: 6 },
        PolicyColumns { first: 1, step: 2, count: 5 },
    ];
    for other in [run(&single), run(&turns)] {
        for (i, (&a, &b)) in together.iter().zip(&other).enumerate() {
            let column = if i < total { i } else { (i - total) / n };
            assert!(
                if column == 4 { a.is_nan() && b.is_nan() } else { a == b },
                "component {i}: {a} and {b}"
            );
        }
    }
}

#[test]
fn gradients_of_rollouts_equal_dual_numbers_in_every_flow() {
    for loss in [LossMode::Terminal, LossMode::Running] {
        let task = Quantum { loss, horizon: 25, ..Quantum::new(2) };
        println!("{loss:?}: {:?}", check::task(&task, &Conv::new(32, 3)).unwrap());
        let small = Quantum { system: system(9), ..task };
        println!("{loss:?}: {:?}", check::task(&small, &Conv::new(9, 4)).unwrap());
    }
}

/// Returns the contents of a reference file.
fn reference(kind: &str) -> Value {
    let path = format!("{}/reference/quantum_nx32_{kind}.json", env!("CARGO_MANIFEST_DIR"));
    serde_json::from_str(&std::fs::read_to_string(path).expect("a readable file")).expect("JSON")
}

fn data(array: &Value) -> Vec<f64> {
    array["data"]
        .as_array()
        .expect("an array")
        .iter()
        .map(|v| v.as_f64().expect("a number"))
        .collect()
}

fn error(got: &[f64], expected: &[f64]) -> f64 {
    assert!(got.len() == expected.len() && got.iter().all(|g| g.is_finite()));
    let scale = expected.iter().fold(0.0, |m: f64, e| m.max(e.abs()));
    got.iter().zip(expected).map(|(g, e)| (g - e).abs()).fold(0.0, f64::max) / scale
}

#[test]
fn steps_and_eigenstates_equal_the_reference_data_of_the_authors() {
    let file = reference("step");
    let (state, control, cotangent) =
        (data(&file["state"]), data(&file["control"]), data(&file["cotangent"]));
    let expected = ["next_state", "vjp_state", "vjp_control"].map(|key| data(&file[key]));
    let system = system(32);
    let mut worst = [0.0; 3];
    for case in 0..control.len() {
        let (at, u) = (case * 64..(case + 1) * 64, [control[case]]);
        let (mut next, mut x_bar, mut u_bar) = (vec![0.0; 64], vec![0.0; 64], [0.0]);
        system.step(Inputs::new(&state[at.clone()], &u), &mut next);
        system.vjp(
            Inputs::new(&state[at.clone()], &u),
            &cotangent[at.clone()],
            Cotangents::of(&mut x_bar, &mut u_bar),
        );
        let errors = [
            error(&next, &expected[0][at.clone()]),
            error(&x_bar, &expected[1][at]),
            error(&u_bar, &expected[2][case..=case]),
        ];
        worst = std::array::from_fn(|i| worst[i].max(errors[i]));
    }
    let ours: Vec<f64> = (1..=6).flat_map(|number| system.eigenstate(number)).collect();
    let eigenstates = error(&ours, &data(&file["eigenstates"]));
    println!("next state, vjp by state, vjp by control: {worst:?}; eigenstates: {eigenstates:.1e}");
    assert!(worst.iter().all(|&worst| worst <= 1e-12) && eigenstates <= 1e-12);
}

#[test]
fn probability_is_conserved_for_1e5_steps() {
    let task = Quantum::new(3);
    let system = task.system;
    let (mut x, mut next) = (initial_states(&task, 0, Purpose::Test, 1), vec![0.0; 64]);
    for step in 0..100_000 {
        let u = [30.0 * (0.1 * f64::from(step)).sin()];
        system.step(Inputs::new(&x, &u), &mut next);
        std::mem::swap(&mut x, &mut next);
    }
    println!("norm - 1 after 1e5 steps: {:.1e}", norm(&x) - 1.0);
    assert!((norm(&x) - 1.0).abs() < 1e-10);
}

#[test]
fn norm_of_the_adjoint_is_conserved_for_1e4_steps() {
    let task = Quantum::new(3);
    let mut states: Vec<Vec<f64>> = vec![initial_states(&task, 0, Purpose::Test, 1)];
    let controls: Vec<[f64; 1]> =
        (0..10_000).map(|step| [20.0 * (0.3 * f64::from(step)).cos()]).collect();
    for u in &controls {
        let mut next = vec![0.0; 64];
        task.system.step(Inputs::new(states.last().expect("a state"), u), &mut next);
        states.push(next);
    }
    let mut lambda: Vec<f64> = (0..64).map(|i| Scalar::sin(f64::from(i))).collect();
    let before = norm(&lambda);
    for (x, u) in states.iter().zip(&controls).rev() {
        let (mut x_bar, mut u_bar) = (vec![0.0; 64], [0.0]);
        task.system.vjp(Inputs::new(x, u), &lambda, Cotangents::of(&mut x_bar, &mut u_bar));
        lambda = x_bar;
    }
    println!(
        "relative change of the adjoint's norm after 1e4 steps: {:.1e}",
        norm(&lambda) / before - 1.0
    );
    assert!((norm(&lambda) / before - 1.0).abs() < 1e-10);
}

#[test]
fn initial_states_mix_the_two_lowest_eigenstates_by_their_weights() {
    for weighting in [[1.0, 1.0], [3.0, 1.0], [7.0, 1.0], [15.0, 1.0], [0.0, 1.0]] {
        let task = Quantum { weighting, ..Quantum::new(3) };
        let (samples, mut mean) = (2000, [0.0; 3]);
        for x in initial_states(&task, 0, Purpose::Train, samples).chunks_exact(64) {
            assert!((norm(x) - 1.0).abs() < 1e-13);
            for (target, mean) in (1..).zip(&mut mean) {
                *mean += (1.0 - Quantum { target, ..task }.running_cost(Inputs::new(x, &[0.0]), x))
                    / samples as f64;
            }
        }
        // E[w₁²n₁² / (w₁²n₁² + w₂²n₂²)] = w₁ / (w₁ + w₂) for weights w and standard normal n.
        let share = weighting[0] / (weighting[0] + weighting[1]);
        println!("weighting {weighting:?}: {mean:.3?}");
        assert!(
            (mean[0] - share).abs() < 0.03
                && (mean[1] - 1.0 + share).abs() < 0.03
                && mean[2].abs() < 1e-13
        );
    }
}

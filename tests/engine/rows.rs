//! Steps of many rows, as other languages call them.

use physgrad::engine::rows::{step, step_jvp, step_vjp};
use physgrad::rng::Purpose;
use physgrad::tasks::CartPole;
use physgrad::{Inputs, Tangents, initial_states};

#[test]
fn rows_have_the_bits_of_single_rows_and_derivatives_are_transposed() {
    let (task, samples) = (CartPole::new(1), 1100);
    let x: Vec<f64> = initial_states(&task, 0, Purpose::Train, samples);
    let u: Vec<f64> = (0..samples).map(|i| i as f64 * 0.01 - 5.0).collect();
    let inputs = Inputs::new(&x, &u);
    let (mut next, mut next_tan) = (vec![0.0; x.len()], vec![0.0; x.len()]);
    step(&task, inputs, &mut next);
    for row in [0, 8, 511, 512, samples - 1] {
        let mut one = vec![0.0; 4];
        step(&task, Inputs::new(&x[4 * row..][..4], &u[row..=row]), &mut one);
        assert_eq!(one, next[4 * row..][..4], "row {row}");
    }
    step_jvp(&task, inputs, Tangents { x: Some(&x), u: Some(&u), p: None }, &mut next_tan);
    let (mut x_bar, mut u_bar) = (vec![0.0; x.len()], vec![0.0; samples]);
    step_vjp(&task, inputs, &next, [&mut x_bar, &mut u_bar, &mut []]);
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let (forward, backward) = (dot(&next, &next_tan), dot(&x, &x_bar) + dot(&u, &u_bar));
    assert!((forward - backward).abs() < 1e-9 * forward.abs(), "{forward} {backward}");
}

#[test]
#[should_panic(expected = "`u` has 0 numbers; expected 2 rows of 1 numbers")]
fn a_step_without_controls_is_refused() {
    step(&CartPole::new(1), Inputs::new(&[0.0; 8], &[]), &mut [0.0; 8]);
}

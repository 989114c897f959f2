//! Schemes for Schrödinger's equation: derivatives, norm, order, phases.

use super::boxes::{
    Swinging, box_of, check_lively, dipole, every_effect, every_effect_typed, largest_difference,
    lively, norm, overlap, step,
};
use physgrad::actuator::{Delay, Limit, LimitKind};
use physgrad::count::{Counted, Ops};
use physgrad::effect::ForcedSystem;
use physgrad::policy::Linear;
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::{
    Absorbing, AbsorbingEdges, Cubic, Harmonic, Pade, Quantum, QuantumEffect, QuantumScheme,
    QuantumSystem, Strang,
};
use physgrad::{
    Actuated, Cotangents, Effect, Forced, Inputs, OdeInputs, Scalar, Substeps, System, Task, check,
    initial_states,
};
use std::f64::consts::{PI, TAU};

fn schemes(model: QuantumSystem) -> [QuantumScheme; 3] {
    [
        QuantumScheme::CrankNicolson(model),
        QuantumScheme::Pade(Pade(model)),
        QuantumScheme::Strang(Strang::new(model)),
    ]
}

#[test]
fn derivatives_of_every_scheme_equal_dual_numbers() {
    check_schemes(&[box_of(3), dipole(4), box_of(9), dipole(32)]);
    check_lively(&Forced { system: Pade(dipole(32)), effects: every_effect_typed() });
    check_lively(&Forced { system: Strang::new(dipole(32)), effects: every_effect_typed() });
}

/// Grids of more points than buffers on the stack have.
#[test]
#[ignore = "long: several seconds"]
fn derivatives_of_every_scheme_on_large_grids_equal_dual_numbers() {
    check_schemes(&[box_of(65), dipole(66)]);
}

fn check_schemes(models: &[QuantumSystem]) {
    for &model in models {
        check_lively(&Pade(model));
        check_lively(&Strang::new(model));
        for system in schemes(model) {
            for effects in [vec![Harmonic::default().into()], every_effect()] {
                check_lively(&Forced { system: system.clone(), effects });
            }
        }
    }
}

#[test]
fn derivatives_of_time_dependent_effects_and_wrappers_equal_dual_numbers() {
    let (limit, edges) =
        (Limit { bound: 20.0, kind: LimitKind::Smooth }, AbsorbingEdges::default());
    for system in schemes(dipole(8)) {
        check_lively(&Forced { system: system.clone(), effects: (Swinging, Cubic::default()) });
        let system = Absorbing::new(Forced { system, effects: every_effect() }, edges);
        let system = Actuated {
            system: Substeps { system, count: 3 },
            actuator: (limit, Delay { steps: 2 }),
        };
        check_lively(&system);
        let task = Quantum { horizon: 6, ..Quantum::with_system(system, 2) };
        check::task(&task, &Linear::with_bias(18, 1)).unwrap();
    }
}

/// Returns the next state, and the cotangents of state and control.
fn step_and_cotangents<S: System>(system: &S, x: &[f64], u: f64) -> Vec<f64> {
    let n = x.len();
    let bar: Vec<f64> = (0..n).map(|i| Scalar::sin(i as f64)).collect();
    let (mut x_bar, mut u_bar) = (vec![0.0; n], [0.0]);
    system.vjp(Inputs::new(x, &[u]), &bar, Cotangents::of(&mut x_bar, &mut u_bar));
    [step(system, x, u), x_bar, u_bar.to_vec()].concat()
}

#[test]
fn schemes_and_effects_chosen_at_run_time_have_the_results_of_typed_ones() {
    fn same<H: ForcedSystem<Model = QuantumSystem> + System + Clone>(
        alone: &H,
        chosen: &QuantumScheme,
    ) -> Vec<f64> {
        let (mut x, mut u) = (vec![0.0; alone.model().grid * 2], [0.0]);
        lively(&mut stream(0, Purpose::Check, 0), &mut x, &mut u, &mut []);
        let plain = step_and_cotangents(alone, &x, u[0]);
        assert_eq!(plain, step_and_cotangents(chosen, &x, u[0]));
        assert_eq!(
            plain,
            step_and_cotangents(
                &Forced { system: alone.clone(), effects: Vec::<QuantumEffect>::new() },
                &x,
                u[0]
            )
        );
        let typed = step_and_cotangents(
            &Forced { system: alone.clone(), effects: every_effect_typed() },
            &x,
            u[0],
        );
        assert_eq!(
            typed,
            step_and_cotangents(
                &Forced { system: alone.clone(), effects: every_effect() },
                &x,
                u[0]
            )
        );
        assert_eq!(
            typed,
            step_and_cotangents(
                &Forced { system: chosen.clone(), effects: every_effect() },
                &x,
                u[0]
            )
        );
        assert_ne!(plain, typed);
        plain
    }
    for model in [box_of(32), dipole(33)] {
        let [a, b, c] = schemes(model);
        let (a, b, c) = (same(&model, &a), same(&Pade(model), &b), same(&Strang::new(model), &c));
        assert!(
            largest_difference(&a, &b) > 1e-3 && largest_difference(&b, &c) > 1e-3,
            "two schemes differ by less than 1e-3"
        );
    }
}

#[test]
fn every_scheme_keeps_the_norm_for_5000_steps_with_any_potential() {
    for (model, effects) in
        [(box_of(32), vec![]), (dipole(32), every_effect()), (box_of(7), every_effect())]
    {
        for system in schemes(model) {
            let system = Forced { system, effects: effects.clone() };
            let task = Quantum { weighting: [1.0, 1.0], ..Quantum::with_system(model, 3) };
            let mut x = initial_states(&task, 0, Purpose::Test, 1);
            for t in 0..5000 {
                x = step(&system, &x, 300.0 * (0.1 * f64::from(t)).sin());
            }
            println!("norm - 1 after 5000 steps: {:e}", norm(&x) - 1.0);
            assert!((norm(&x) - 1.0).abs() < 1e-12, "{:?}: {:e}", system.system, norm(&x) - 1.0);
        }
    }
}

/// Returns the state after half a unit of time, and the derivatives of its infidelity with respect
/// to eight controls.
///
/// Each control acts for 1/16 of a unit of time, in `count` time steps. `scheme` is an index of
/// [`schemes`].
fn rollout<E: Effect<QuantumSystem>>(
    scheme: usize,
    effects: &E,
    count: usize,
) -> (Vec<f64>, Vec<f64>) {
    const PIECES: usize = 8;
    let model = QuantumSystem { dt: 0.0625 / count as f64, ..dipole(12) };
    let system = Substeps {
        system: Forced { system: schemes(model)[scheme].clone(), effects: effects.clone() },
        count,
    };
    let task = Quantum { horizon: PIECES, ..Quantum::with_system(system, 2) };
    let mut states = vec![
        (model.eigenstate(1).zip(model.eigenstate(2)).flat_map(|(a, b)| [0.8 * a, 0.6 * b]))
            .collect::<Vec<_>>(),
    ];
    let control = |k: usize| 8.0 * (1.0 + 5.0 * (k as f64 + 0.5) / PIECES as f64).sin();
    for k in 0..PIECES {
        states.push(step(&task.system, &states[k], control(k)));
    }
    let (mut bar, mut gradient) = (vec![0.0; 2 * model.grid], vec![0.0; PIECES]);
    task.running_cost_gradient(
        Inputs::new(&states[PIECES], &[0.0]),
        &states[PIECES],
        Cotangents { u: Some(&mut [0.0]), ..Cotangents::default() },
        &mut bar,
    );
    for k in (0..PIECES).rev() {
        let mut x_bar = vec![0.0; bar.len()];
        task.system.vjp(
            Inputs::new(&states[k], &[control(k)]),
            &bar,
            Cotangents::of(&mut x_bar, &mut gradient[k..=k]),
        );
        bar = x_bar;
    }
    (states[PIECES].clone(), gradient)
}

/// Returns the observed orders of state and gradient when the number of steps per control doubles
/// from `count`.
fn orders<E: Effect<QuantumSystem>>(
    scheme: usize,
    effects: &E,
    count: usize,
    reference: &(Vec<f64>, Vec<f64>),
) -> [f64; 2] {
    let errors = |count| {
        let (state, gradient) = rollout(scheme, effects, count);
        [largest_difference(&state, &reference.0), largest_difference(&gradient, &reference.1)]
    };
    let (coarse, fine) = (errors(count), errors(2 * count));
    let orders = [0, 1].map(|i| (coarse[i] / fine[i]).log2());
    println!("scheme {scheme}: {coarse:?}, {fine:?}: orders {orders:.2?}");
    orders
}

#[test]
fn states_and_gradients_converge_with_the_order_of_the_scheme() {
    let trap = Harmonic { stiffness: 50.0, center: 0.2 };
    let reference = rollout(1, &trap, 512);
    for (scheme, order, count) in [(0, 2.0, 32), (1, 4.0, 8), (2, 2.0, 8)] {
        for found in orders(scheme, &trap, count, &reference) {
            assert!((found - order).abs() < 0.3, "scheme {scheme}: {found}");
        }
    }
}

#[test]
fn with_the_cubic_term_strang_has_order_2_and_other_schemes_order_1() {
    let cubic = Cubic { strength: 3.0 };
    let reference = rollout(2, &cubic, 2048);
    for (scheme, order, count) in [(0, 1.0, 128), (1, 1.0, 64), (2, 2.0, 8)] {
        for found in orders(scheme, &cubic, count, &reference) {
            assert!((found - order).abs() < 0.3, "scheme {scheme}: {found}");
        }
    }
}

/// Returns the relative phase error of an eigenstate after a time step of 0.0625 / `count` in the
/// default box.
fn phase_error(scheme: usize, number: usize, count: usize) -> f64 {
    let model = QuantumSystem { dt: 0.0625 / count as f64, ..QuantumSystem::default() };
    let phi: Vec<f64> = model.eigenstate(number).flat_map(|phi| [phi, 0.0]).collect();
    let energy = 4.0 * ((PI * number as f64 / 66.0).sin() / model.spacing()).powi(2);
    let (size, phase) = overlap(&phi, &step(&schemes(model)[scheme], &phi, 0.0));
    assert!((size - 1.0).abs() < 1e-13, "the step changed the modulus of an eigenstate");
    ((-phase).rem_euclid(TAU) / (energy * model.dt) - 1.0).abs()
}

#[test]
fn phase_errors_of_eigenstates_3_to_5_have_the_stated_sizes() {
    for (number, crank_nicolson, pade) in [(3, 0.12, 0.0045), (4, 0.28, 0.033), (5, 0.43, 0.116)] {
        let errors = [0, 1, 2].map(|scheme| phase_error(scheme, number, 1));
        println!("eigenstate {number}: phase errors {errors:.4?}");
        assert!(
            (errors[0] - crank_nicolson).abs() < 0.006 && (errors[1] - pade).abs() < 0.03 * pade
        );
        assert!(errors[2] < 1e-14, "the phase error of Strang's scheme is {:e}", errors[2]);
    }
    // Least number of steps per 0.0625 with which the phase error of eigenstate 5 is at most 1 %.
    let least = |scheme| (1..).find(|&count| phase_error(scheme, 5, count) <= 0.01);
    assert_eq!([0, 1, 2].map(least), [Some(11), Some(3), Some(1)]);
}

#[test]
fn a_step_of_pade_equals_two_steps_of_crank_nicolson_with_shifted_energies() {
    #[derive(Clone, Debug)]
    struct Shift(f64);
    impl Effect<QuantumSystem> for Shift {
        fn add_forces<T: Scalar>(
            &self,
            _model: &QuantumSystem,
            _inputs: OdeInputs<'_, T>,
            potential: &mut [T],
        ) {
            potential.iter_mut().for_each(|v| *v += self.0);
        }
    }
    let (mut x, mut u) = (vec![0.0; 64], [0.0]);
    lively(&mut stream(0, Purpose::Check, 0), &mut x, &mut u, &mut []);
    // Two Crank-Nicolson steps of 2 dt / 3, with energies shifted by ±√3 / dt, yield both factors
    // of Padé's approximation.
    let (model, shift) = (box_of(32), 3f64.sqrt() / 0.0625);
    let part = QuantumSystem { dt: model.dt * 2.0 / 3.0, ..model };
    let halfway = step(&Forced { system: part, effects: Shift(-shift) }, &x, u[0]);
    let twice = step(&Forced { system: part, effects: Shift(shift) }, &halfway, u[0]);
    assert!(largest_difference(&twice, &step(&Pade(model), &x, u[0])) < 1e-13);
}

/// Compares a step without potential with the exact solution, a sum over all eigenstates.
#[test]
fn strang_solves_the_free_particle_to_1e_12() {
    for grid in [3, 6, 7, 33, 300] {
        let model = QuantumSystem { length: 2.0 * (grid + 1) as f64 / 33.0, ..box_of(grid) };
        let (mut x, mut u) = (vec![0.0; 2 * grid], [0.0]);
        lively(&mut stream(0, Purpose::Check, 0), &mut x, &mut u, &mut []);
        let mut expected = vec![0.0; 2 * grid];
        for number in 1..=grid {
            let phi: Vec<f64> =
                (1..=grid).map(|j| (PI * (number * j) as f64 / (grid + 1) as f64).sin()).collect();
            let share = |i: usize| {
                phi.iter().zip(x[i..].iter().step_by(2)).map(|(a, b)| a * b).sum::<f64>() * 2.0
                    / (grid + 1) as f64
            };
            let (re, im) = (share(0), share(1));
            let energy = 4.0
                * ((PI * number as f64 / (2 * grid + 2) as f64).sin() / model.spacing()).powi(2);
            let (sin, cos) = (-energy * model.dt).sin_cos();
            for (expected, phi) in expected.chunks_exact_mut(2).zip(&phi) {
                expected[0] += phi * (re * cos - im * sin);
                expected[1] += phi * (re * sin + im * cos);
            }
        }
        assert!(largest_difference(&expected, &step(&Strang::new(model), &x, 0.0)) < 1e-12);
    }
}

/// Returns operation counts of a step, and of `vjp` for state and control, for the state alone, and
/// for the control alone.
fn counts<S: System>(system: &S) -> [Ops; 4] {
    let n = system.state_dim();
    let x: Vec<Counted> = (0..n).map(|i| Counted(Scalar::sin(i as f64))).collect();
    let (u, mut next, mut x_bar, mut u_bar) =
        ([Counted(3.0)], x.clone(), x.clone(), [Counted(0.0)]);
    [
        Ops::of(|| system.step(Inputs::new(&x, &u), &mut next)).0,
        Ops::of(|| system.vjp(Inputs::new(&x, &u), &x, Cotangents::of(&mut x_bar, &mut u_bar))).0,
        Ops::of(|| {
            system.vjp(
                Inputs::new(&x, &u),
                &x,
                Cotangents { x: Some(&mut x_bar), ..Cotangents::default() },
            )
        })
        .0,
        Ops::of(|| {
            system.vjp(
                Inputs::new(&x, &u),
                &x,
                Cotangents { u: Some(&mut u_bar), ..Cotangents::default() },
            )
        })
        .0,
    ]
}

#[test]
fn a_step_of_pade_costs_two_of_crank_nicolson_less_one_potential() {
    let sums = |add, multiply| Ops { add, multiply, ..Ops::default() };
    let (crank_nicolson, pade) = (counts(&box_of(32)), counts(&Pade(box_of(32))));
    // For the cotangent of the control, the reverse pass recomputes the state between the factors.
    // It also adds the control cotangents of both factors.
    let more = [sums(0, 0), sums(4 * 32 + 1, 0), sums(0, 0), sums(4 * 32 + 1, 0)];
    // Additions to the requested cotangents occur once per step.
    let outputs = [sums(0, 0), sums(64 + 1, 0), sums(64, 0), sums(1, 0)];
    for i in 0..4 {
        let one = crank_nicolson[i] - outputs[i];
        assert_eq!(pade[i] + sums(0, 32), one + one + more[i] + outputs[i], "{i}");
    }
    assert_eq!(counts(&QuantumScheme::Pade(Pade(box_of(32)))), pade);
}

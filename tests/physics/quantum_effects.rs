//! Effects of quantum control, absorbing edges, renormalization and control shapes: derivatives,
//! equal results of lists, tuples and tables, and operation counts.

use super::boxes::{
    Swinging, box_of, check_lively, dipole, every_effect, every_effect_typed, lively, norm, step,
};
use physgrad::actuator::{Delay, Limit, LimitKind};
use physgrad::count::{Counted, Ops};
use physgrad::effect::HasModel;
use physgrad::policy::Linear;
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::{
    Absorbing, AbsorbingEdges, Cubic, LossMode, Quantum, QuantumEffect, QuantumSystem,
    Renormalized, Tabulated,
};
use physgrad::{
    Actuated, Cotangents, Effect, Forced, Inputs, Scalar, Start, Substeps, System, Task, check,
    initial_states,
};

#[test]
fn derivatives_of_every_effect_equal_dual_numbers() {
    for grid in [3, 32, 65] {
        for effect in every_effect() {
            check_lively(&Forced { system: box_of(grid), effects: vec![effect.clone()] });
            check_lively(&Forced { system: dipole(grid), effects: vec![effect.clone()] });
        }
        check_lively(&Forced { system: box_of(grid), effects: every_effect() });
        check_lively(&dipole(grid));
    }
}

#[test]
fn time_dependent_effect_depends_on_time_plus_phase() {
    let system = Forced { system: dipole(8), effects: (Swinging, Cubic::default()) };
    assert_eq!((system.state_dim(), system.param_dim()), (16, 1));
    check_lively(&system);
    let x: Vec<f64> = (0..16).map(|i| Scalar::sin(f64::from(i + 1))).collect();
    // Four steps of 0.0625 have the effect of a phase of 0.25.
    let after = |t: usize, phase: f64| {
        let mut next = vec![f64::NAN; 16];
        system.step(Inputs { t, p: &[phase], ..Inputs::new(&x, &[1.0]) }, &mut next);
        next
    };
    assert_eq!(after(4, 0.5), after(0, 0.75));
    assert_ne!(after(4, 0.5), after(0, 0.5));
    let task = Quantum { horizon: 6, ..Quantum::with_system(system, 2) };
    check::task(&task, &Linear::with_bias(16, 1)).unwrap();
    let start: Vec<f64> = initial_states(&task, 0, Purpose::Train, 1);
    assert!((norm(&start[..16]) - 1.0).abs() < 1e-13 && start[16] > 0.0 && start[16] <= 1.0);
}

#[test]
fn derivatives_with_absorbing_edges_and_actuators_equal_dual_numbers() {
    let edges = AbsorbingEdges::default();
    for grid in [5, 32, 65] {
        check_lively(&Absorbing::new(
            Forced { system: box_of(grid), effects: every_effect() },
            edges,
        ));
    }
    let system = || Forced { system: dipole(12), effects: every_effect() };
    for kind in [LimitKind::Smooth, LimitKind::Hard] {
        let actuator = (Limit { bound: 20.0, kind }, Delay { steps: 2 });
        check_lively(&Actuated { system: Absorbing::new(system(), edges), actuator });
        check_lively(&Absorbing::new(Actuated { system: system(), actuator }, edges));
    }
    let system = Absorbing::new(system(), edges);
    check_lively(&Substeps { system, count: 3 });
}

#[test]
fn gradients_of_rollouts_equal_dual_numbers_in_every_flow() {
    for loss in [LossMode::Terminal, LossMode::Running] {
        let limit = Limit { bound: 5.0, kind: LimitKind::Smooth };
        let system = Forced { system: dipole(8), effects: every_effect() };
        let system = Absorbing::new(system, AbsorbingEdges { width: 0.5, strength: 3.0 });
        let system = Actuated { system, actuator: (limit, Delay { steps: 2 }) };
        let n = system.state_dim();
        assert_eq!(n, 16 + 2);
        let task = Quantum { loss, horizon: 12, ..Quantum::with_system(system, 2) };
        check::task(&task, &Linear::with_bias(n, 1)).unwrap();
    }
}

/// Returns the next state, and the cotangents of state and control, requested together and alone.
fn step_and_cotangents<S: System>(system: &S, x: &[f64], u: f64) -> Vec<f64> {
    let n = x.len();
    let bar: Vec<f64> = (0..n).map(|i| Scalar::sin(i as f64)).collect();
    let (mut x_bar, mut u_bar) = (vec![0.0; 2 * n], [0.0; 2]);
    let (both, state) = x_bar.split_at_mut(n);
    system.vjp(Inputs::new(x, &[u]), &bar, Cotangents::of(both, &mut u_bar[..1]));
    system.vjp(Inputs::new(x, &[u]), &bar, Cotangents { x: Some(state), ..Cotangents::default() });
    system.vjp(
        Inputs::new(x, &[u]),
        &bar,
        Cotangents { u: Some(&mut u_bar[1..]), ..Cotangents::default() },
    );
    [step(system, x, u), x_bar, u_bar.to_vec()].concat()
}

#[test]
fn lists_equal_tuples_and_effects_of_strength_0_change_nothing() {
    let mut rng = stream(0, Purpose::Check, 0);
    for system in [box_of(32), dipole(33)] {
        let (mut x, mut u) = (vec![0.0; 2 * system.grid], [0.0]);
        lively(&mut rng, &mut x, &mut u, &mut []);
        let typed =
            step_and_cotangents(&Forced { system, effects: every_effect_typed() }, &x, u[0]);
        assert_eq!(
            typed,
            step_and_cotangents(&Forced { system, effects: every_effect() }, &x, u[0])
        );

        let without_effects = step_and_cotangents(&system, &x, u[0]);
        assert_ne!(typed, without_effects);
        assert_eq!(without_effects, step_and_cotangents(&Forced { system, effects: () }, &x, u[0]));
        assert_eq!(
            without_effects,
            step_and_cotangents(&Forced { system, effects: Vec::<QuantumEffect>::new() }, &x, u[0])
        );
        assert_eq!(
            without_effects,
            step_and_cotangents(&Forced { system, effects: Cubic { strength: 0.0 } }, &x, u[0])
        );
        for edges in [
            AbsorbingEdges { width: 0.0, strength: 10.0 },
            AbsorbingEdges { width: 0.3, strength: 0.0 },
        ] {
            assert_eq!(
                without_effects,
                step_and_cotangents(&Absorbing::new(system, edges), &x, u[0])
            );
        }
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

fn sums(add: u64, multiply: u64) -> Ops {
    Ops { add, multiply, ..Ops::default() }
}

#[test]
fn an_effect_costs_only_its_own_operations() {
    let (model, n) = (box_of(32), 32);
    let plain = counts(&model);
    let solve = sums(8 * n - 6, 12 * n - 8);
    // At each point, the potential takes one multiplication. A pivot takes 4 additions, 7
    // multiplications, a negation and a division. The square of the off-diagonal entries takes one
    // multiplication. The last 4 n additions form the next state `2 y - ψ`.
    let eliminated = Ops { divide: n, negate: n, ..sums(4 * n, 8 * n + 1) };
    assert_eq!(plain[0], eliminated + solve + sums(4 * n, 0));
    // The cotangent of the next state is v. With the matrix A of the step, `y = A⁻¹ ψ` and
    // `w = A⁻ᴴ v`. The cotangent of the state takes the elimination, its conjugation, one solve,
    // `2 w - v`, and the addition to the output.
    let state = eliminated + Ops { negate: n + 1, ..solve } + sums(4 * n + 2 * n, 0);
    assert_eq!(plain[2], state);
    // The cotangent of the control takes a second solve, and the cotangents `dt Im(w̄ y)` of the
    // potential. It also takes their weighted sum, and the addition to the output.
    let potential = sums(n, 3 * n);
    let control = sums(n + 1, n);
    assert_eq!(plain[1], state + solve + potential + control);
    assert_eq!(plain[3] + sums(2 * n, 0), plain[1]);
    assert_eq!(counts(&dipole(32)), plain);
    assert_eq!(counts(&Forced { system: model, effects: () }), plain);
    assert_eq!(counts(&Forced { system: model, effects: Vec::<QuantumEffect>::new() }), plain);

    // The cubic term depends on the state. The cotangent of the state therefore takes the second
    // solve.
    let (add_forces, forces_and_vjp) = (sums(2 * n, 3 * n), sums(4 * n, 6 * n));
    let cubic = [add_forces, forces_and_vjp, forces_and_vjp + solve + potential, add_forces];
    let added = |effect: &QuantumEffect| match effect {
        QuantumEffect::Cubic(_) => cubic,
        _ => [sums(n, 0); 4],
    };
    let mut all = plain;
    for effect in every_effect() {
        let found = counts(&Forced { system: model, effects: vec![effect.clone()] });
        let extra = added(&effect);
        for i in 0..4 {
            assert_eq!(found[i], plain[i] + extra[i], "{effect:?}, {i}");
            all[i] += extra[i];
        }
    }
    let mut effects = every_effect();
    assert_eq!(counts(&Forced { system: model, effects: effects.clone() }), all);
    effects.reverse();
    assert_eq!(counts(&Forced { system: model, effects }), all);
    assert_eq!(counts(&Forced { system: model, effects: every_effect_typed() }), all);

    // Three of the points at 2 j / 33 lie within 0.2 of each wall.
    let edges = counts(&Absorbing::new(model, AbsorbingEdges { width: 0.2, strength: 1.0 }));
    assert_eq!(edges, plain.map(|plain| plain + sums(0, 2 * 6)));
}

#[test]
fn a_task_with_wrapped_system_has_the_costs_of_the_bare_system() {
    let plain = Quantum { loss: LossMode::Terminal, ..Quantum::new(2) };
    let system = Actuated {
        system: Absorbing::new(plain.system, AbsorbingEdges::default()),
        actuator: Delay { steps: 1 },
    };
    let wrapped = Quantum { loss: LossMode::Terminal, ..Quantum::with_system(system, 2) };
    assert_eq!(HasModel::<QuantumSystem>::model(wrapped.system()), &plain.system);
    let (mut x, mut extended) = (vec![0.0; 64], vec![0.0; 65]);
    plain.start(&mut stream(0, Purpose::Train, 3), Start { x: &mut x, p: &mut [] });
    wrapped.start(&mut stream(0, Purpose::Train, 3), Start { x: &mut extended, p: &mut [] });
    assert_eq!(extended, [&x[..], &[0.0]].concat());
    extended[64] = 7.0;
    assert_eq!(wrapped.terminal_cost(&extended, &[]), plain.terminal_cost(&x, &[]));
    let (mut bar, mut extended_bar) = (vec![0.0; 64], vec![0.0; 65]);
    plain.terminal_cost_gradient(&x, &[], &mut bar, None);
    wrapped.terminal_cost_gradient(&extended, &[], &mut extended_bar, None);
    assert_eq!(extended_bar, [&bar[..], &[0.0]].concat());
}

#[test]
fn a_table_has_the_values_and_derivatives_of_its_potential() {
    let mut rng = stream(0, Purpose::Check, 0);
    let system = dipole(33);
    let (mut x, mut u) = (vec![0.0; 2 * system.grid], [0.0]);
    lively(&mut rng, &mut x, &mut u, &mut []);
    for effect in every_effect().into_iter().filter(|effect| !effect.state_dependent()) {
        let table = Tabulated::of(&system, &effect);
        let typed = step_and_cotangents(
            &Forced { system, effects: (table.clone(), Cubic::default()) },
            &x,
            u[0],
        );
        assert_eq!(
            typed,
            step_and_cotangents(
                &Forced { system, effects: vec![effect, Cubic::default().into()] },
                &x,
                u[0]
            )
        );
        check_lively(&Forced { system, effects: table });
    }
}

#[test]
#[should_panic(expected = "depends on state, control or parameters has no table")]
fn state_dependent_potentials_have_no_table() {
    Tabulated::of(&box_of(8), &Cubic::default());
}

#[test]
fn renormalization_changes_only_the_norm_and_has_exact_derivatives() {
    for grid in [3, 32, 65] {
        check_lively(&Renormalized { system: box_of(grid) });
        check_lively(&Renormalized { system: Substeps { system: box_of(grid), count: 3 } });
    }
    check_lively(&Renormalized {
        system: Forced { system: dipole(8), effects: (Swinging, Cubic::default()) },
    });
    // State components beyond the wave are unaffected.
    let system = Forced { system: dipole(8), effects: Cubic::default() };
    let system = Renormalized { system: Actuated { system, actuator: Delay { steps: 1 } } };
    check_lively(&system);
    let mut x: Vec<f64> = (0..17).map(|i| Scalar::sin(f64::from(i))).collect();
    x[16] = 2.0;
    let (kept, free) = (step(&system, &x, 1.0), step(&system.system, &x, 1.0));
    assert!((norm(&kept[..16]) - 1.0).abs() < 1e-15 && kept[16] == free[16]);
    let size = norm(&free[..16]);
    assert!(
        size > 1.5
            && kept[..16].iter().zip(&free).all(|(kept, free)| (kept * size - free).abs() < 1e-14)
    );
    assert!(
        step(&system, &[0.0; 17], 1.0)[0].is_nan(),
        "renormalizing a zero wave does not give NaN"
    );
}

//! Effects of quantum control, its absorbing edges and the shapes of its control: derivatives, and the physics they
//! claim.

use physgrad::policy::Linear;
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::tasks::{
    Absorbing, AbsorbingEdges, Barrier, ControlShape, Cubic, DoubleWell, Harmonic, LossMode, Quantum, QuantumEffect,
    QuantumSystem,
};
use physgrad::{
    Actuated, Around, Cotangent, Counted, Counts, Delay, Effect, Limit, LimitKind, Real, Scalar, Substeps, System, Task, With,
    check,
};
use rand::RngExt;
use std::f64::consts::{PI, TAU};

fn box_of(grid: usize) -> QuantumSystem {
    QuantumSystem { grid, ..QuantumSystem::default() }
}

fn dipole(grid: usize) -> QuantumSystem {
    QuantumSystem { control: ControlShape::Dipole, ..box_of(grid) }
}

/// Off the middle, where there is a choice: nothing hides behind a symmetry.
fn every_effect() -> Vec<QuantumEffect> {
    vec![
        Harmonic { center: 0.3, ..Harmonic::default() }.into(),
        Barrier { center: -0.2, ..Barrier::default() }.into(),
        DoubleWell::default().into(),
        Cubic::default().into(),
    ]
}

fn every_effect_typed() -> (Harmonic, Barrier, DoubleWell, Cubic) {
    (
        Harmonic { center: 0.3, ..Harmonic::default() },
        Barrier { center: -0.2, ..Barrier::default() },
        DoubleWell::default(),
        Cubic::default(),
    )
}

/// States of norm about 1, and large controls. There is one control: its cotangent must not nearly vanish by chance, for
/// errors are measured against it.
fn lively(rng: &mut Rng, x: &mut [f64], u: &mut [f64]) {
    let size = (3.0 / x.len() as f64).sqrt();
    x.iter_mut().for_each(|x| *x = rng.random_range(-size..size));
    u.iter_mut().for_each(|u| *u = rng.random_range(-30.0..30.0));
}

fn check_lively<S: System>(system: &S) {
    check::try_system_at(system, lively).unwrap_or_else(|mismatch| panic!("{mismatch}"));
}

fn step<S: System>(system: &S, x: &[f64], u: f64) -> Vec<f64> {
    let mut next = vec![f64::NAN; x.len()];
    system.step(x, &[u], &mut next);
    next
}

fn run<S: System>(system: &S, mut x: Vec<f64>, steps: usize) -> Vec<f64> {
    for _ in 0..steps {
        x = step(system, &x, 0.0);
    }
    x
}

/// A state from a wave function of the place, normalized.
fn wave(body: &QuantumSystem, psi: impl Fn(f64) -> (f64, f64)) -> Vec<f64> {
    let x: Vec<f64> = body.points().flat_map(|x| <[f64; 2]>::from(psi(x))).collect();
    let norm = norm(&x);
    x.into_iter().map(|x| x / norm).collect()
}

/// A Gaussian whose density has the standard deviation `sigma`, with the wave number k.
fn packet(body: &QuantumSystem, center: f64, sigma: f64, k: f64) -> Vec<f64> {
    wave(body, |x| {
        let size = (-((x - center) / (2.0 * sigma)).powi(2)).exp();
        (size * (k * x).cos(), size * (k * x).sin())
    })
}

fn norm(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn densities(x: &[f64]) -> Vec<f64> {
    x.chunks_exact(2).map(|psi| psi[0] * psi[0] + psi[1] * psi[1]).collect()
}

fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    assert!(a.len() == b.len() && a.iter().chain(b).all(|x| x.is_finite()));
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// `⟨a, b⟩` as size and phase.
fn overlap(a: &[f64], b: &[f64]) -> (f64, f64) {
    let (mut re, mut im) = (0.0, 0.0);
    for (a, b) in a.chunks_exact(2).zip(b.chunks_exact(2)) {
        re += a[0] * b[0] + a[1] * b[1];
        im += a[0] * b[1] - a[1] * b[0];
    }
    (re.hypot(im), im.atan2(re))
}

fn potential<E: Effect<QuantumSystem>>(effect: &E, body: &QuantumSystem) -> Vec<f64> {
    let mut potential = vec![0.0; body.grid];
    effect.act(body, &vec![0.0; 2 * body.grid], &mut potential);
    potential
}

#[test]
fn the_derivatives_of_every_effect_are_those_of_duals() {
    for grid in [3, 32, 65] {
        for effect in every_effect() {
            check_lively(&With { system: box_of(grid), effects: vec![effect.clone()] });
            check_lively(&With { system: dipole(grid), effects: vec![effect.clone()] });
        }
        check_lively(&With { system: box_of(grid), effects: every_effect() });
        check_lively(&dipole(grid));
    }
}

/// An effect that somebody else may write: a force that swings with time, and depends on the state as well.
#[derive(Clone, Debug)]
struct Swinging;

impl Effect<QuantumSystem> for Swinging {
    fn act<T: Scalar>(&self, body: &QuantumSystem, x: &[T], forces: &mut [T]) {
        let push = x[x.len() - 1].sin() * x[0];
        for (v, point) in forces.iter_mut().zip(body.points()) {
            *v += push * T::lift(point);
        }
    }
    fn clock(&self) -> Option<f64> {
        Some(1.0)
    }
}

#[test]
fn effects_may_depend_on_time() {
    let system = With { system: dipole(8), effects: (Swinging, Cubic::default()) };
    assert_eq!(system.state_dim(), 17);
    check_lively(&system);
    let x: Vec<f64> = (0..17).map(|i| Scalar::sin(f64::from(i))).collect();
    assert_eq!(step(&system, &x, 1.0)[16], x[16] + 0.0625);
    let task = Quantum { horizon: 6, ..Quantum::around(system, 2) };
    check::task(&task, &Linear::with_bias(17, 1));
    let mut start = vec![0.0; 17];
    task.start(&mut stream(0, Purpose::Train, 0), &mut start);
    assert!((norm(&start[..16]) - 1.0).abs() < 1e-13 && start[16] > 0.0 && start[16] <= 1.0);
}

#[test]
fn the_derivatives_with_absorbing_edges_and_behind_actuators_are_those_of_duals() {
    let edges = AbsorbingEdges::default();
    for grid in [5, 32, 65] {
        check_lively(&Absorbing { system: With { system: box_of(grid), effects: every_effect() }, edges });
    }
    let system = || With { system: dipole(12), effects: every_effect() };
    for kind in [LimitKind::Smooth, LimitKind::Hard] {
        let actuator = (Limit { bound: 20.0, kind }, Delay { steps: 2 });
        check_lively(&Actuated { system: Absorbing { system: system(), edges }, actuator });
        check_lively(&Absorbing { system: Actuated { system: system(), actuator }, edges });
    }
    let system = Absorbing { system: system(), edges };
    check_lively(&Substeps { system, count: 3 });
}

#[test]
fn whole_rollouts_of_every_flow() {
    for loss in [LossMode::Final, LossMode::Continuous] {
        let limit = Limit { bound: 5.0, kind: LimitKind::Smooth };
        let system = With { system: dipole(8), effects: every_effect() };
        let system = Absorbing { system, edges: AbsorbingEdges { width: 0.5, strength: 3.0 } };
        let system = Actuated { system, actuator: (limit, Delay { steps: 2 }) };
        let n = system.state_dim();
        assert_eq!(n, 16 + 2);
        let task = Quantum { loss, horizon: 12, ..Quantum::around(system, 2) };
        check::task(&task, &Linear::with_bias(n, 1));
    }
}

/// Everything of a step and its reverse: the next state and all cotangents.
fn everything<S: System>(system: &S, x: &[f64], u: f64) -> Vec<f64> {
    let n = x.len();
    let bar: Vec<f64> = (0..n).map(|i| Scalar::sin(i as f64)).collect();
    let (mut x_bar, mut u_bar) = (vec![0.0; 2 * n], [0.0; 2]);
    let (both, state) = x_bar.split_at_mut(n);
    system.vjp(x, &[u], &bar, both, &mut u_bar[..1]);
    system.vjp_state(x, &[u], &bar, state);
    system.vjp_control(x, &[u], &bar, &mut u_bar[1..]);
    [step(system, x, u), x_bar, u_bar.to_vec()].concat()
}

#[test]
fn a_list_has_the_numbers_of_a_tuple_and_what_does_nothing_changes_none() {
    let mut rng = stream(0, Purpose::Check, 0);
    for system in [box_of(32), dipole(33)] {
        let (mut x, mut u) = (vec![0.0; 2 * system.grid], [0.0]);
        lively(&mut rng, &mut x, &mut u);
        let typed = everything(&With { system, effects: every_effect_typed() }, &x, u[0]);
        assert_eq!(typed, everything(&With { system, effects: every_effect() }, &x, u[0]));

        let alone = everything(&system, &x, u[0]);
        assert_ne!(typed, alone);
        assert_eq!(alone, everything(&With { system, effects: () }, &x, u[0]));
        assert_eq!(alone, everything(&With { system, effects: Vec::<QuantumEffect>::new() }, &x, u[0]));
        assert_eq!(alone, everything(&With { system, effects: Cubic { strength: 0.0 } }, &x, u[0]));
        for edges in [AbsorbingEdges { width: 0.0, strength: 10.0 }, AbsorbingEdges { width: 0.3, strength: 0.0 }] {
            assert_eq!(alone, everything(&Absorbing { system, edges }, &x, u[0]));
        }
    }
}

/// What a step, `vjp`, `vjp_state` and `vjp_control` do.
fn counts<S: System>(system: &S) -> [Counts; 4] {
    let n = system.state_dim();
    let x: Vec<Counted> = (0..n).map(|i| Counted(Scalar::sin(i as f64))).collect();
    let (u, mut next, mut x_bar, mut u_bar) = ([Counted(3.0)], x.clone(), x.clone(), [Counted(0.0)]);
    [
        Counts::of(|| system.step(&x, &u, &mut next)).0,
        Counts::of(|| system.vjp(&x, &u, &x, &mut x_bar, &mut u_bar)).0,
        Counts::of(|| system.vjp_state(&x, &u, &x, &mut x_bar)).0,
        Counts::of(|| system.vjp_control(&x, &u, &x, &mut u_bar)).0,
    ]
}

fn sums(add: u64, multiply: u64) -> Counts {
    Counts { add, multiply, ..Counts::default() }
}

#[test]
fn an_effect_costs_its_own_operations_and_no_others() {
    let (body, n) = (box_of(32), 32);
    let plain = counts(&body);
    let solve = sums(8 * n - 6, 12 * n - 8);
    // The potential is one multiplication; a pivot is 4 additions, 7 multiplications, a change of sign and a division.
    let eliminated = Counts { divide: n, negate: n, ..sums(4 * n, 8 * n + 1) };
    assert_eq!(plain[0], eliminated + solve + sums(4 * n, 0));
    // Eliminated and conjugated, and solved once.
    let state = eliminated + Counts { negate: n + 1, ..solve } + sums(4 * n, 0);
    assert_eq!(plain[2], state);
    // Solved twice; and the cotangents of the potential, Im(w̄ y) times dt, and of the control.
    let potential = sums(n, 3 * n);
    let control = sums(n, n);
    assert_eq!(plain[1], state + solve + potential + control);
    assert_eq!(plain[3], plain[1]);
    assert_eq!(counts(&dipole(32)), plain);
    assert_eq!(counts(&With { system: body, effects: () }), plain);
    assert_eq!(counts(&With { system: body, effects: Vec::<QuantumEffect>::new() }), plain);

    // The cubic term reads the state, so that the state's cotangent needs the second solve.
    let (act, act_and_reverse) = (sums(2 * n, 3 * n), sums(4 * n, 6 * n));
    let cubic = [act, act_and_reverse, act_and_reverse + solve + potential, act];
    let added = |effect: &QuantumEffect| match effect {
        QuantumEffect::Cubic(_) => cubic,
        _ => [sums(n, 0); 4],
    };
    let mut all = plain;
    for effect in every_effect() {
        let found = counts(&With { system: body, effects: vec![effect.clone()] });
        let more = added(&effect);
        for i in 0..4 {
            assert_eq!(found[i], plain[i] + more[i], "{effect:?}, {i}");
            all[i] += more[i];
        }
    }
    let mut effects = every_effect();
    assert_eq!(counts(&With { system: body, effects: effects.clone() }), all);
    effects.reverse();
    assert_eq!(counts(&With { system: body, effects }), all);
    assert_eq!(counts(&With { system: body, effects: every_effect_typed() }), all);

    // Points at 2 j / 33: three are within 0.2 of either wall.
    let edges = counts(&Absorbing { system: body, edges: AbsorbingEdges { width: 0.2, strength: 1.0 } });
    assert_eq!(edges, plain.map(|plain| plain + sums(0, 2 * 6)));
}

#[test]
fn every_real_potential_keeps_the_norm() {
    for effects in every_effect().into_iter().map(|effect| vec![effect]).chain([every_effect()]) {
        let system = With { system: dipole(32), effects };
        let mut x = vec![0.0; 64];
        Quantum::new(3).start(&mut stream(0, Purpose::Test, 0), &mut x);
        for t in 0..5000 {
            x = step(&system, &x, 30.0 * (0.1 * f64::from(t)).sin());
        }
        assert!((norm(&x) - 1.0).abs() < 1e-11, "{:?}: {:e}", system.effects, norm(&x) - 1.0);
    }
}

#[test]
fn absorbing_edges_only_take() {
    let body = QuantumSystem { grid: 399, length: 10.0, dt: 0.002, ..QuantumSystem::default() };
    let edges = AbsorbingEdges { width: 3.0, strength: 30.0 };
    let system = Absorbing { system: With { system: body, effects: Cubic { strength: 2.0 } }, edges };
    // At the speed 2k = 20; it would be back in the middle after 500 steps.
    let mut x = packet(&body, 5.0, 0.5, 10.0);
    let mut before = norm(&x);
    for _ in 0..500 {
        x = step(&system, &x, 0.0);
        assert!(norm(&x) <= before * (1.0 + 1e-14));
        before = norm(&x);
    }
    assert!(before * before < 0.01, "{:e} is left", before * before);
    // In one step, nothing but the edges, each point for itself.
    let x = packet(&body, 5.0, 3.0, 1.0);
    let (kept, free) = (step(&system, &x, 0.0), step(&system.system, &x, 0.0));
    for ((x, kept), free) in body.points().zip(kept.chunks_exact(2)).zip(free.chunks_exact(2)) {
        let depth = (3.0 - x.min(10.0 - x)).max(0.0);
        let factor = if depth < 1e-9 { 1.0 } else { (-0.002 * 30.0 * depth * depth / 9.0f64).exp() };
        assert!((kept[0] - free[0] * factor).abs() < 1e-15 && (kept[1] - free[1] * factor).abs() < 1e-15, "at {x}");
    }
}

/// What the documentation says of the defaults.
#[test]
fn the_default_edges_take_a_fifth_of_the_ground_state() {
    let system = Absorbing { system: box_of(32), edges: AbsorbingEdges::default() };
    let left = |number| {
        let x = box_of(32).eigenstate(number).flat_map(|phi| [phi, 0.0]).collect();
        norm(&run(&system, x, 128)).powi(2)
    };
    println!("{:.3}, {:.3}", left(1), left(3));
    assert!((left(1) - 0.8).abs() < 0.03 && (left(3) - 1.0 / 6.0).abs() < 0.03);
}

/// The lowest eigenvalues of -D₂ + diag(potential), by Sturm's sequence and bisection.
fn levels(body: &QuantumSystem, potential: &[f64], count: usize) -> Vec<f64> {
    let per_square = 1.0 / body.spacing().powi(2);
    let below = |energy: f64| {
        let (mut pivot, mut negative) = (f64::INFINITY, 0);
        for v in potential {
            pivot = 2.0 * per_square + v - energy - per_square * per_square / pivot;
            negative += usize::from(pivot < 0.0);
        }
        negative
    };
    let bisect = |n: usize| {
        let (mut low, mut high) = (0.0, 4.0 * per_square);
        for _ in 0..80 {
            let middle = 0.5 * (low + high);
            if below(middle) > n { high = middle } else { low = middle }
        }
        low
    };
    (0..count).map(bisect).collect()
}

#[test]
fn the_levels_of_a_trap_are_those_of_an_oscillator() {
    let trap = Harmonic { stiffness: 2500.0, center: 0.1 };
    let omega = 2.0 * 2500f64.sqrt();
    let errors = |grid| -> Vec<f64> {
        let levels = levels(&box_of(grid), &potential(&trap, &box_of(grid)), 4);
        levels.iter().enumerate().map(|(n, level)| level / (omega * (n as f64 + 0.5)) - 1.0).collect()
    };
    let (coarse, fine) = (errors(199), errors(399));
    println!("{coarse:?}, {fine:?}");
    for (coarse, fine) in coarse.iter().zip(&fine) {
        // Second order in dx.
        assert!(fine.abs() < 1e-3 && (3.9..4.1).contains(&(coarse / fine)));
    }
}

#[test]
fn a_coherent_state_swings_and_comes_back() {
    let (stiffness, steps) = (2500.0, 2000);
    let omega = 2.0 * f64::sqrt(stiffness);
    let body = QuantumSystem { grid: 399, dt: TAU / omega / steps as f64, ..dipole(0) };
    let trap = With { system: body, effects: Harmonic { stiffness, center: 0.0 } };
    // The density of the ground state is a Gaussian of this width.
    let sigma = 0.5f64.sqrt() * stiffness.powf(-0.25);
    let start = packet(&body, 1.0 + 0.3, sigma, 0.0);
    let half = run(&trap, start.clone(), steps / 2);
    let (there, _) = overlap(&half, &packet(&body, 1.0 - 0.3, sigma, 0.0));
    let (back, phase) = overlap(&start, &run(&trap, half, steps / 2));
    println!("{there}, {back}, {phase}");
    // exp(-i ω (n + 1/2) 2π/ω) = -1 for every n.
    assert!(there > 0.999 && back > 0.999 && PI - phase.abs() < 0.1);
    // A constant force moves its middle by c / 2k, and nothing else.
    let shifted = packet(&body, 1.0 - 0.2, sigma, 0.0);
    let after = (0..500).fold(shifted.clone(), |x, _| step(&trap, &x, 2.0 * stiffness * 0.2));
    assert!(overlap(&shifted, &after).0 > 0.999);
}

#[test]
fn a_barrier_lets_through_what_eckart_says() {
    let body = QuantumSystem { grid: 1599, length: 40.0, dt: 0.002, ..QuantumSystem::default() };
    let barrier = Barrier { height: 25.0, width: 0.5, center: 1.0 };
    let (sigma, wave_number) = (2.5, 5.0);
    let start = packet(&body, 10.0, sigma, wave_number);
    // At the speed 2k = 10, from 10 to about 32.
    let after = run(&With { system: body, effects: barrier }, start, 1100);
    let through: f64 = densities(&after).iter().zip(body.points()).filter(|(_, x)| *x > 21.0).map(|(d, _)| d).sum();
    let Barrier { height, width, .. } = barrier;
    let transmission = |k: f64| {
        let (with, without) = ((PI * k * width).sinh().powi(2), (PI / 2.0 * (4.0 * height * width * width - 1.0).sqrt()).cosh());
        with / (with + without.powi(2))
    };
    // Wave numbers are spread by 1 / 2σ.
    let (mut expected, mut total) = (0.0, 0.0);
    for i in -400..=400 {
        let off = f64::from(i) / 100.0;
        let weight = (-0.5 * off * off).exp();
        expected += weight * transmission(wave_number + off / (2.0 * sigma));
        total += weight;
    }
    println!("{through}, expected {}", expected / total);
    assert!((through - expected / total).abs() < 0.01);
}

#[test]
fn a_double_well_has_two_valleys_and_keeps_a_symmetric_state() {
    let (well, body) = (DoubleWell { height: 40.0, separation: 1.0 }, QuantumSystem { grid: 199, ..dipole(0) });
    let v = potential(&well, &body);
    // Points at 0.01 j: bottoms at 0.5 and 1.5.
    assert!(v[49].abs() < 1e-9 && v[149].abs() < 1e-9 && (v[99] - 40.0).abs() < 1e-9);
    assert!(v.iter().all(|&v| v >= 0.0) && v.iter().rev().eq(&v), "mirrored bit for bit");
    let curvature = (v[48] - 2.0 * v[49] + v[50]) / 0.01f64.powi(2);
    // V = k δ², ω = 2 sqrt(k).
    let omega = 2.0 * (curvature / 2.0).sqrt();
    assert!((omega / (8.0 * 40f64.sqrt()) - 1.0).abs() < 1e-3, "{omega}");

    let effects = (well, Cubic { strength: 3.0 });
    let start: Vec<f64> = body.eigenstate(1).zip(body.eigenstate(3)).flat_map(|(a, b)| [0.6 * a, 0.8 * b]).collect();
    let after = densities(&run(&With { system: body, effects }, start.clone(), 500));
    let mirrored: Vec<f64> = after.iter().rev().copied().collect();
    assert!(largest_difference(&after, &densities(&start)) > 1e-3, "it moves");
    assert!(largest_difference(&after, &mirrored) < 1e-12);

    // Below the top it stays where it is for long, and is found in the other valley in the end: after half the beat of
    // the two lowest levels.
    let deep = DoubleWell { height: 60.0, separation: 1.0 };
    let body = QuantumSystem { dt: 0.002, grid: 99, ..body };
    let levels = levels(&body, &potential(&deep, &body), 3);
    let splitting = levels[1] - levels[0];
    assert!(levels[1] < 60.0 && splitting < 0.1 * (levels[2] - levels[0]), "{levels:?}");
    let stiffness = 240.0 / 0.25;
    let left = packet(&body, 0.5, 0.5f64.sqrt() * f64::powf(stiffness, -0.25), 0.0);
    let on_the_right = |x: &[f64]| densities(&x[100..]).iter().sum::<f64>();
    let half_beat = (PI / splitting / body.dt) as usize;
    let there = run(&With { system: body, effects: deep }, left.clone(), half_beat);
    println!("{levels:?}, {half_beat} steps, {}", on_the_right(&there));
    assert!(on_the_right(&left) < 0.01 && on_the_right(&there) > 0.85);
}

#[test]
fn the_opposite_control_does_the_same_to_the_mirrored_state_of_a_dipole() {
    let mirror = |x: &[f64]| x.chunks_exact(2).rev().flatten().copied().collect::<Vec<f64>>();
    let mut rng = stream(0, Purpose::Check, 1);
    for grid in [32, 33] {
        let (mut x, mut u) = (vec![0.0; 2 * grid], [0.0]);
        lively(&mut rng, &mut x, &mut u);
        let mirrored = mirror(&step(&dipole(grid), &mirror(&x), -u[0]));
        assert!(largest_difference(&step(&dipole(grid), &x, u[0]), &mirrored) < 1e-14);
        let mirrored = mirror(&step(&box_of(grid), &mirror(&x), -u[0]));
        assert!(largest_difference(&step(&box_of(grid), &x, u[0]), &mirrored) > 1e-3, "not so a tilt");
    }
}

/// The same densities in the limit of small steps, and in one step a phase that differs by O(dt³).
#[test]
fn a_dipole_is_a_tilt_up_to_a_global_phase_and_the_time_step() {
    let apart = |count: u32| {
        let dt = 0.5 / f64::from(count);
        let (tilt, dipole) = (QuantumSystem { dt, ..box_of(16) }, QuantumSystem { dt, ..dipole(16) });
        let start: Vec<f64> = tilt.eigenstate(1).zip(tilt.eigenstate(2)).flat_map(|(a, b)| [0.6 * a, 0.8 * b]).collect();
        let (mut a, mut b) = (start.clone(), start);
        for t in 0..count {
            let u = 10.0 * (20.0 * (f64::from(t) + 0.5) * dt).sin();
            (a, b) = (step(&tilt, &a, u), step(&dipole, &b, u));
        }
        largest_difference(&densities(&a), &densities(&b))
    };
    let (coarse, fine) = (apart(4000), apart(8000));
    println!("{coarse:e}, {fine:e}");
    assert!(fine < 1e-6 && (3.9..4.1).contains(&(coarse / fine)));
    assert!(apart(8) > 1e-3, "with the paper's time step they differ");
}

/// The same energy everywhere.
#[derive(Clone, Debug)]
struct Uniform(f64);

impl Effect<QuantumSystem> for Uniform {
    fn act<T: Scalar>(&self, _body: &QuantumSystem, _x: &[T], forces: &mut [T]) {
        forces.iter_mut().for_each(|v| *v += T::lift(self.0));
    }
    fn vjp<R: Real, C: Cotangent<R>>(&self, _body: &QuantumSystem, _x: &[R], _forces_bar: &[C], _x_bar: &mut [C]) {}
    fn reads_state(&self) -> bool {
        false
    }
}

#[test]
fn where_the_density_is_constant_the_cubic_term_is_an_energy() {
    let strength = 3.0;
    let phases = |body: &QuantumSystem| wave(body, |x| (Scalar::cos(3.0 * x), Scalar::sin(3.0 * x)));
    let body = box_of(32);
    let energy = strength / 32.0 / body.spacing();
    let x = phases(&body);
    let cubic = step(&With { system: body, effects: Cubic { strength } }, &x, 5.0);
    let uniform = step(&With { system: body, effects: Uniform(energy) }, &x, 5.0);
    assert!(largest_difference(&cubic, &uniform) < 1e-14);

    // An eigenstate turns by 2 atan(E dt/2), by about dt more for each unit of energy.
    let phi: Vec<f64> = body.eigenstate(2).flat_map(|phi| [phi, 0.0]).collect();
    let level = 4.0 / body.spacing().powi(2) * (PI / 33.0).sin().powi(2);
    let (size, phase) = overlap(&phi, &step(&With { system: body, effects: Uniform(energy) }, &phi, 0.0));
    assert!((size - 1.0).abs() < 1e-13 && (phase + 2.0 * (0.03125 * (level + energy)).atan()).abs() < 1e-13);

    // In a box so large that nothing moves, every point turns by its own density alone.
    let still = QuantumSystem { length: 3.3e7, ..body };
    let x = phases(&QuantumSystem { length: 2.0, ..still });
    let strength = 0.01 * still.spacing() * 32.0;
    let after = step(&With { system: still, effects: Cubic { strength } }, &x, 0.0);
    let turn = -2.0 * f64::atan(0.01 * 0.0625 / 2.0);
    for (x, after) in x.chunks_exact(2).zip(after.chunks_exact(2)) {
        let (size, phase) = overlap(x, after);
        assert!((size * 32.0 - 1.0).abs() < 1e-9 && (phase - turn).abs() < 1e-9, "{phase} and {turn}");
    }
}

/// `sqrt(κ/2) / cosh(κ x)` turns by `exp(i κ² t)` and keeps its shape if the strength is -4κ.
#[test]
fn an_attractive_condensate_has_a_soliton() {
    let (kappa, steps) = (5.0, 1000);
    let errors = |steps: usize| {
        let period = TAU / (kappa * kappa);
        let body = QuantumSystem { grid: 399, length: 6.0, dt: period / steps as f64, ..QuantumSystem::default() };
        let start = wave(&body, |x| (1.0 / (kappa * (x - 3.0)).cosh(), 0.0));
        let bound = run(&With { system: body, effects: Cubic { strength: -4.0 * kappa } }, start.clone(), steps);
        let free = run(&body, start.clone(), steps);
        assert!(overlap(&start, &free).0 < 0.7, "without it, it spreads");
        let (size, phase) = overlap(&start, &bound);
        (1.0 - size, phase)
    };
    let (size, phase) = errors(steps);
    println!("{size:e}, {phase:e}");
    assert!(size < 1e-3 && phase.abs() < 0.05);
}

#[test]
fn a_task_around_anything_pays_for_the_body_alone() {
    let plain = Quantum { loss: LossMode::Final, ..Quantum::new(2) };
    let system =
        Actuated { system: Absorbing { system: plain.system, edges: AbsorbingEdges::default() }, actuator: Delay { steps: 1 } };
    let around = Quantum { loss: LossMode::Final, ..Quantum::around(system, 2) };
    assert_eq!(Around::<QuantumSystem>::body(around.system()), &plain.system);
    let (mut x, mut more) = (vec![0.0; 64], vec![0.0; 65]);
    plain.start(&mut stream(0, Purpose::Train, 3), &mut x);
    around.start(&mut stream(0, Purpose::Train, 3), &mut more);
    assert_eq!(more, [&x[..], &[0.0]].concat());
    more[64] = 7.0;
    assert_eq!(around.terminal_cost(&more), plain.terminal_cost(&x));
    let (mut bar, mut more_bar) = (vec![f64::NAN; 64], vec![f64::NAN; 65]);
    plain.terminal_cost_gradient(&x, &mut bar);
    around.terminal_cost_gradient(&more, &mut more_bar);
    assert_eq!(more_bar, [&bar[..], &[0.0]].concat());
}

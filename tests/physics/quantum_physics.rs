//! Documented physics of the effects of quantum control.

use super::boxes::{
    box_of, densities, dipole, every_effect, largest_difference, lively, norm, overlap, packet,
    run, step, wave,
};
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::{
    Absorbing, AbsorbingEdges, Barrier, Cubic, DoubleWell, Harmonic, Quantum, QuantumSystem,
};
use physgrad::{
    Cotangent, Cotangents, Effect, Forced, Inputs, OdeInputs, Real, Scalar, Start, Task,
};
use std::f64::consts::{PI, TAU};

fn potential<E: Effect<QuantumSystem>>(effect: &E, model: &QuantumSystem) -> Vec<f64> {
    let mut potential = vec![0.0; model.grid];
    effect.add_forces(
        model,
        Inputs::new(&vec![0.0; 2 * model.grid], &[]).continuous(0.0),
        &mut potential,
    );
    potential
}

#[test]
fn every_real_potential_keeps_the_norm_for_5000_steps() {
    for effects in every_effect().into_iter().map(|effect| vec![effect]).chain([every_effect()]) {
        let system = Forced { system: dipole(32), effects };
        let mut x = vec![0.0; 64];
        Quantum::new(3).start(&mut stream(0, Purpose::Test, 0), Start { x: &mut x, p: &mut [] });
        for t in 0..5000 {
            x = step(&system, &x, 30.0 * (0.1 * f64::from(t)).sin());
        }
        assert!((norm(&x) - 1.0).abs() < 1e-11, "{:?}: {:e}", system.effects, norm(&x) - 1.0);
    }
}

#[test]
fn absorbing_edges_only_remove_probability() {
    let model = QuantumSystem { grid: 399, length: 10.0, dt: 0.002, ..QuantumSystem::default() };
    let edges = AbsorbingEdges { width: 3.0, strength: 30.0 };
    let system = Absorbing::new(Forced { system: model, effects: Cubic { strength: 2.0 } }, edges);
    // The packet moves at the speed 2k = 20. Without edges, it returns to the middle after 250 and
    // after 500 steps.
    let mut x = packet(&model, 5.0, 0.5, 10.0);
    let mut before = norm(&x);
    for _ in 0..500 {
        x = step(&system, &x, 0.0);
        assert!(norm(&x) <= before * (1.0 + 1e-14));
        before = norm(&x);
    }
    assert!(before * before < 0.01, "the remaining probability is {:e}", before * before);
    // In one step, the edges multiply the wave at each point by a factor.
    let x = packet(&model, 5.0, 3.0, 1.0);
    let (kept, free) = (step(&system, &x, 0.0), step(system.system(), &x, 0.0));
    for ((x, kept), free) in model.points().zip(kept.chunks_exact(2)).zip(free.chunks_exact(2)) {
        let depth = (3.0 - x.min(10.0 - x)).max(0.0);
        let factor =
            if depth < 1e-9 { 1.0 } else { (-0.002 * 30.0 * depth * depth / 9.0f64).exp() };
        assert!(
            (kept[0] - free[0] * factor).abs() < 1e-15
                && (kept[1] - free[1] * factor).abs() < 1e-15,
            "at {x}"
        );
    }
}

#[test]
fn default_edges_keep_0_8_of_eigenstate_1_and_a_sixth_of_eigenstate_3() {
    let system = Absorbing::new(box_of(32), AbsorbingEdges::default());
    let left = |number| {
        let x = box_of(32).eigenstate(number).flat_map(|phi| [phi, 0.0]).collect();
        norm(&run(&system, x, 128)).powi(2)
    };
    println!("remaining probability of eigenstates 1 and 3: {:.3}, {:.3}", left(1), left(3));
    assert!((left(1) - 0.8).abs() < 0.03 && (left(3) - 1.0 / 6.0).abs() < 0.03);
}

/// Returns the lowest `count` eigenvalues of -D₂ + diag(potential), by Sturm's sequence and
/// bisection. D₂ is the matrix of the second difference over dx².
fn levels(model: &QuantumSystem, potential: &[f64], count: usize) -> Vec<f64> {
    let per_square = 1.0 / model.spacing().powi(2);
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
fn levels_of_a_trap_equal_those_of_the_harmonic_oscillator() {
    let trap = Harmonic { stiffness: 2500.0, center: 0.1 };
    let omega = 2.0 * 2500f64.sqrt();
    let errors = |grid| -> Vec<f64> {
        let levels = levels(&box_of(grid), &potential(&trap, &box_of(grid)), 4);
        levels
            .iter()
            .enumerate()
            .map(|(n, level)| level / (omega * (n as f64 + 0.5)) - 1.0)
            .collect()
    };
    let (coarse, fine) = (errors(199), errors(399));
    println!("relative errors of levels: {coarse:?}, {fine:?}");
    for (coarse, fine) in coarse.iter().zip(&fine) {
        // Errors are of second order in dx.
        assert!(fine.abs() < 1e-3 && (3.9..4.1).contains(&(coarse / fine)));
    }
}

#[test]
fn a_coherent_state_returns_after_a_period_with_the_phase_pi() {
    let (stiffness, steps) = (2500.0, 2000);
    let omega = 2.0 * f64::sqrt(stiffness);
    let model = QuantumSystem { grid: 399, dt: TAU / omega / steps as f64, ..dipole(0) };
    let trap = Forced { system: model, effects: Harmonic { stiffness, center: 0.0 } };
    // The density of the ground state is a Gaussian with this standard deviation.
    let sigma = 0.5f64.sqrt() * stiffness.powf(-0.25);
    let start = packet(&model, 1.0 + 0.3, sigma, 0.0);
    let half = run(&trap, start.clone(), steps / 2);
    let (there, _) = overlap(&half, &packet(&model, 1.0 - 0.3, sigma, 0.0));
    let (back, phase) = overlap(&start, &run(&trap, half, steps / 2));
    println!("overlaps after half a period and a period: {there}, {back}; phase {phase}");
    // exp(-i ω (n + 1/2) 2π/ω) = -1 for all n.
    assert!(there > 0.999 && back > 0.999 && PI - phase.abs() < 0.1);
    // The potential u x of the control shifts the center of a trap of stiffness k by -u / (2 k).
    // The energy changes by a constant.
    let shifted = packet(&model, 1.0 - 0.2, sigma, 0.0);
    let after = (0..500).fold(shifted.clone(), |x, _| step(&trap, &x, 2.0 * stiffness * 0.2));
    assert!(overlap(&shifted, &after).0 > 0.999);
}

#[test]
fn barrier_transmission_matches_eckart() {
    let model = QuantumSystem { grid: 1599, length: 40.0, dt: 0.002, ..QuantumSystem::default() };
    let barrier = Barrier { height: 25.0, width: 0.5, center: 1.0 };
    let (sigma, wave_number) = (2.5, 5.0);
    let start = packet(&model, 10.0, sigma, wave_number);
    // The packet moves at the speed 2k = 10, from 10 to about 32.
    let after = run(&Forced { system: model, effects: barrier }, start, 1100);
    let through: f64 = densities(&after)
        .iter()
        .zip(model.points())
        .filter(|(_, x)| *x > 21.0)
        .map(|(d, _)| d)
        .sum();
    let Barrier { height, width, .. } = barrier;
    let transmission = |k: f64| {
        let (with, without) = (
            (PI * k * width).sinh().powi(2),
            (PI / 2.0 * (4.0 * height * width * width - 1.0).sqrt()).cosh(),
        );
        with / (with + without.powi(2))
    };
    // Wave numbers have the standard deviation 1 / (2 σ).
    let (mut expected, mut total) = (0.0, 0.0);
    for i in -400..=400 {
        let off = f64::from(i) / 100.0;
        let weight = (-0.5 * off * off).exp();
        expected += weight * transmission(wave_number + off / (2.0 * sigma));
        total += weight;
    }
    println!("transmission {through}, expected {}", expected / total);
    assert!((through - expected / total).abs() < 0.01);
}

#[test]
fn a_double_well_has_the_documented_shape_symmetry_and_tunneling() {
    let (well, model) =
        (DoubleWell { height: 40.0, separation: 1.0 }, QuantumSystem { grid: 199, ..dipole(0) });
    let v = potential(&well, &model);
    // Points at 0.01 j: minima at 0.5 and 1.5.
    assert!(v[49].abs() < 1e-9 && v[149].abs() < 1e-9 && (v[99] - 40.0).abs() < 1e-9);
    assert!(
        v.iter().all(|&v| v >= 0.0) && v.iter().rev().eq(&v),
        "the potential is negative, or not symmetric bit for bit"
    );
    let curvature = (v[48] - 2.0 * v[49] + v[50]) / 0.01f64.powi(2);
    // At a small distance δ from a minimum, V = k δ² and ω = 2 sqrt(k).
    let omega = 2.0 * (curvature / 2.0).sqrt();
    assert!((omega / (8.0 * 40f64.sqrt()) - 1.0).abs() < 1e-3, "{omega}");

    let effects = (well, Cubic { strength: 3.0 });
    let start: Vec<f64> = model
        .eigenstate(1)
        .zip(model.eigenstate(3))
        .flat_map(|(a, b)| [0.6 * a, 0.8 * b])
        .collect();
    let after = densities(&run(&Forced { system: model, effects }, start.clone(), 500));
    let mirrored: Vec<f64> = after.iter().rev().copied().collect();
    assert!(largest_difference(&after, &densities(&start)) > 1e-3, "the density does not change");
    assert!(largest_difference(&after, &mirrored) < 1e-12);

    // At energies below the barrier, the particle tunnels slowly. It reaches the other well after
    // half the beat period of the two lowest levels.
    let deep = DoubleWell { height: 60.0, separation: 1.0 };
    let model = QuantumSystem { dt: 0.002, grid: 99, ..model };
    let levels = levels(&model, &potential(&deep, &model), 3);
    let splitting = levels[1] - levels[0];
    assert!(levels[1] < 60.0 && splitting < 0.1 * (levels[2] - levels[0]), "{levels:?}");
    // Near a minimum, k = 4 height / (separation / 2)².
    let stiffness = 240.0 / 0.25;
    let left = packet(&model, 0.5, 0.5f64.sqrt() * f64::powf(stiffness, -0.25), 0.0);
    let on_the_right = |x: &[f64]| densities(&x[100..]).iter().sum::<f64>();
    let half_beat = (PI / splitting / model.dt) as usize;
    let there = run(&Forced { system: model, effects: deep }, left.clone(), half_beat);
    println!(
        "levels {levels:?}, {half_beat} steps, probability on the right {}",
        on_the_right(&there)
    );
    assert!(on_the_right(&left) < 0.01 && on_the_right(&there) > 0.85);
}

#[test]
fn mirroring_with_the_opposite_control_is_a_symmetry_of_the_dipole_only() {
    let mirror = |x: &[f64]| x.chunks_exact(2).rev().flatten().copied().collect::<Vec<f64>>();
    let mut rng = stream(0, Purpose::Check, 1);
    for grid in [32, 33] {
        let (mut x, mut u) = (vec![0.0; 2 * grid], [0.0]);
        lively(&mut rng, &mut x, &mut u, &mut []);
        let mirrored = mirror(&step(&dipole(grid), &mirror(&x), -u[0]));
        assert!(largest_difference(&step(&dipole(grid), &x, u[0]), &mirrored) < 1e-14);
        let mirrored = mirror(&step(&box_of(grid), &mirror(&x), -u[0]));
        assert!(
            largest_difference(&step(&box_of(grid), &x, u[0]), &mirrored) > 1e-3,
            "a tilt has this symmetry"
        );
    }
}

/// Densities agree in the limit of small steps. The phase of one step differs by O(dt³).
#[test]
fn densities_of_dipole_and_tilt_converge_to_each_other_with_order_2() {
    let difference = |count: u32| {
        let dt = 0.5 / f64::from(count);
        let (tilt, dipole) =
            (QuantumSystem { dt, ..box_of(16) }, QuantumSystem { dt, ..dipole(16) });
        let start: Vec<f64> = tilt
            .eigenstate(1)
            .zip(tilt.eigenstate(2))
            .flat_map(|(a, b)| [0.6 * a, 0.8 * b])
            .collect();
        let (mut a, mut b) = (start.clone(), start);
        for t in 0..count {
            let u = 10.0 * (20.0 * (f64::from(t) + 0.5) * dt).sin();
            (a, b) = (step(&tilt, &a, u), step(&dipole, &b, u));
        }
        largest_difference(&densities(&a), &densities(&b))
    };
    let (coarse, fine) = (difference(4000), difference(8000));
    println!("differences of densities: {coarse:e}, {fine:e}");
    assert!(fine < 1e-6 && (3.9..4.1).contains(&(coarse / fine)));
    assert!(
        difference(8) > 1e-3,
        "the densities differ by at most 1e-3 at the time step of the paper"
    );
}

/// Potential that is equal at all points.
#[derive(Clone, Debug)]
struct Uniform(f64);

impl Effect<QuantumSystem> for Uniform {
    fn add_forces<T: Scalar>(
        &self,
        _model: &QuantumSystem,
        _inputs: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        forces.iter_mut().for_each(|v| *v += self.0);
    }
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        _model: &QuantumSystem,
        _inputs: OdeInputs<'_, R>,
        _forces_bar: &[C],
        _bars: Cotangents<'_, C>,
    ) {
    }
    fn state_dependent(&self) -> bool {
        false
    }
}

#[test]
fn at_constant_density_the_cubic_term_equals_a_uniform_potential() {
    let strength = 3.0;
    let phases =
        |model: &QuantumSystem| wave(model, |x| (Scalar::cos(3.0 * x), Scalar::sin(3.0 * x)));
    let model = box_of(32);
    let energy = strength / 32.0 / model.spacing();
    let x = phases(&model);
    let cubic = step(&Forced { system: model, effects: Cubic { strength } }, &x, 5.0);
    let uniform = step(&Forced { system: model, effects: Uniform(energy) }, &x, 5.0);
    assert!(largest_difference(&cubic, &uniform) < 1e-14);

    // A step changes the phase of an eigenstate by -2 atan(E dt/2).
    let phi: Vec<f64> = model.eigenstate(2).flat_map(|phi| [phi, 0.0]).collect();
    let level = 4.0 / model.spacing().powi(2) * (PI / 33.0).sin().powi(2);
    let (size, phase) =
        overlap(&phi, &step(&Forced { system: model, effects: Uniform(energy) }, &phi, 0.0));
    assert!(
        (size - 1.0).abs() < 1e-13
            && (phase + 2.0 * (0.03125 * (level + energy)).atan()).abs() < 1e-13
    );

    // In a very large box, the kinetic energy is negligible. The change of phase at each point then
    // depends only on the density at this point.
    let still = QuantumSystem { length: 3.3e7, ..model };
    let x = phases(&QuantumSystem { length: 2.0, ..still });
    let strength = 0.01 * still.spacing() * 32.0;
    let after = step(&Forced { system: still, effects: Cubic { strength } }, &x, 0.0);
    let turn = -2.0 * f64::atan(0.01 * 0.0625 / 2.0);
    for (x, after) in x.chunks_exact(2).zip(after.chunks_exact(2)) {
        let (size, phase) = overlap(x, after);
        assert!(
            (size * 32.0 - 1.0).abs() < 1e-9 && (phase - turn).abs() < 1e-9,
            "{phase} and {turn}"
        );
    }
}

/// `sqrt(κ/2) / cosh(κ x)` acquires the phase `exp(i κ² t)` and keeps its shape if the strength is
/// -4κ.
#[test]
fn an_attractive_condensate_has_a_soliton() {
    let (kappa, steps) = (5.0, 1000);
    let errors = |steps: usize| {
        let period = TAU / (kappa * kappa);
        let model = QuantumSystem {
            grid: 399,
            length: 6.0,
            dt: period / steps as f64,
            ..QuantumSystem::default()
        };
        let start = wave(&model, |x| (1.0 / (kappa * (x - 3.0)).cosh(), 0.0));
        let bound = run(
            &Forced { system: model, effects: Cubic { strength: -4.0 * kappa } },
            start.clone(),
            steps,
        );
        let free = run(&model, start.clone(), steps);
        assert!(
            overlap(&start, &free).0 < 0.7,
            "without the cubic term, the packet does not spread"
        );
        let (size, phase) = overlap(&start, &bound);
        (1.0 - size, phase)
    };
    let (size, phase) = errors(steps);
    println!("1 - overlap {size:e}, phase {phase:e}");
    assert!(size < 1e-3 && phase.abs() < 0.05);
}

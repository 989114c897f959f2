//! Absent effects cost no operations. Tests compare operation counts and results, not times.

use super::by_hand::{cart_pole::ByHand, guidance, quantum};
use physgrad::actuator::{AnyActuator, Delay, Lag, Limit, LimitKind};
use physgrad::count::{OpCount, Ops};
use physgrad::effect::{ForcedSystem, HasModel};
use physgrad::engine::Batch;
use physgrad::policy::Mlp;
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::{
    Absorbing, AbsorbingEdges, Barrier, Bumpers, CartDamping, CartPole, CartPoleEffect,
    CartPoleSystem, CoupledCartPole, Cubic, DoubleWell, Drive, DryFriction, Evade, Flock, Friction,
    Guidance, GuidanceEffect, GuidanceSystem, GustyWind, Harmonic, Obstacles, PoleDamping, Quantum,
    QuantumEffect, QuantumSystem, Spread, SteadyWind, Walls,
};
use physgrad::{
    Actuated, Cotangents, Effect, Float, Flow, Forced, Inputs, Rollout, Start, System, Task,
    Weights, initial_states,
};

fn cart_pole(poles: usize) -> CartPoleSystem {
    CartPoleSystem { poles, ..CartPoleSystem::default() }
}

fn cart_pole_effects() -> Vec<CartPoleEffect> {
    vec![
        PoleDamping::default().into(),
        CartDamping::default().into(),
        DryFriction::default().into(),
        SteadyWind::default().into(),
        GustyWind::default().into(),
        Bumpers::default().into(),
    ]
}

fn agents(drivers: usize, evaders: usize) -> GuidanceSystem {
    GuidanceSystem { drivers, evaders, ..GuidanceSystem::default() }
}

fn guidance_effects() -> Vec<GuidanceEffect> {
    vec![
        Friction::default().into(),
        Spread::default().into(),
        Evade::default().into(),
        Flock::default().into(),
        Drive::default().into(),
        Obstacles::default().into(),
        Walls::default().into(),
    ]
}

fn quantum_effects() -> Vec<QuantumEffect> {
    vec![
        Harmonic::default().into(),
        Barrier::default().into(),
        DoubleWell::default().into(),
        Cubic::default().into(),
    ]
}

/// Returns the counts of a step, its VJP, and its VJP with respect to the control only.
fn counts<S: System>(system: &S) -> [Ops; 3] {
    let OpCount { step, vjp, vjp_control } = OpCount::of(system);
    [step, vjp, vjp_control]
}

fn minus(a: [Ops; 3], b: [Ops; 3]) -> [Ops; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

/// Checks that absent effects cost no operations. Checks that the operations of an effect depend
/// neither on other effects nor on their order.
fn costs_add_up<H: ForcedSystem + System + Clone, E: Effect<H::Model>>(system: &H, effects: &[E]) {
    let with =
        |effects: &[E]| counts(&Forced { system: system.clone(), effects: effects.to_vec() });
    let bare = counts(system);
    assert_eq!(with(&[]), bare, "an empty list adds operations");
    assert_eq!(
        counts(&Forced { system: system.clone(), effects: () }),
        bare,
        "`()` adds operations"
    );
    let own: Vec<_> =
        effects.iter().map(|effect| minus(with(std::slice::from_ref(effect)), bare)).collect();
    let mut sum = bare;
    for (i, own) in own.iter().enumerate() {
        assert!(own[0].total() > 0, "{:?} has no operations", effects[i]);
        sum = std::array::from_fn(|k| sum[k] + own[k]);
        assert_eq!(
            with(&effects[..=i]),
            sum,
            "the operations of {:?} depend on the effects before it",
            effects[i]
        );
        let mut others = effects.to_vec();
        others.remove(i);
        assert_eq!(
            minus(with(effects), with(&others)),
            *own,
            "removing {:?} does not save exactly its own operations",
            effects[i]
        );
    }
    let mut turned = effects.to_vec();
    turned.reverse();
    assert_eq!(with(&turned), with(effects), "reversed order");
    turned.rotate_left(1);
    assert_eq!(with(&turned), with(effects), "reversed and rotated order");
}

#[test]
fn an_effect_costs_its_own_operations_and_nothing_when_absent() {
    for poles in [1, 3] {
        costs_add_up(&cart_pole(poles), &cart_pole_effects());
        costs_add_up(&CoupledCartPole(cart_pole(poles)), &cart_pole_effects());
    }
    // With at least two drivers and two evaders, each effect of guidance acts on some agent.
    for (drivers, evaders) in [(2, 2), (2, 4), (3, 2)] {
        costs_add_up(&agents(drivers, evaders), &guidance_effects());
    }
    for grid in [3, 10] {
        costs_add_up(&QuantumSystem { grid, ..QuantumSystem::default() }, &quantum_effects());
    }
}

#[test]
fn absorbing_edges_cost_four_multiplications_with_any_effects() {
    let (system, edges) =
        (QuantumSystem { grid: 10, ..QuantumSystem::default() }, AbsorbingEdges::default());
    let own = |effects: &[QuantumEffect]| {
        let system = Forced { system, effects: effects.to_vec() };
        minus(counts(&Absorbing::new(system.clone(), edges)), counts(&system))
    };
    // The edges multiply both components at the first and the last point, which are within 0.2 of a
    // wall.
    let two_points = Ops { multiply: 4, ..Ops::default() };
    let effects = quantum_effects();
    for present in 0..=effects.len() {
        assert_eq!(own(&effects[..present]), [two_points; 3]);
    }
    assert_eq!(minus(counts(&Absorbing::new(system, edges)), counts(&system)), [two_points; 3]);
}

#[test]
fn cart_pole_with_and_without_damping_has_the_operations_of_handwritten_code() {
    let system = cart_pole(3);
    let (pole, cart, wind) =
        (PoleDamping::default(), CartDamping::default(), SteadyWind::default());
    let by_hand = ByHand::<false, false> { system, pole, cart, wind };
    assert_eq!(OpCount::of(&system).step, OpCount::of(&by_hand).step);
    assert_eq!(OpCount::of(&system).vjp, OpCount::of(&by_hand).vjp);
    let friction = Forced { system, effects: (pole, cart) };
    let by_hand = ByHand::<true, false> { system, pole, cart, wind };
    assert_eq!(OpCount::of(&friction).step, OpCount::of(&by_hand).step);
    assert_eq!(OpCount::of(&friction).vjp, OpCount::of(&by_hand).vjp);
}

/// Returns the handwritten herding of the paper.
fn herding_by_hand(system: GuidanceSystem) -> guidance::ByHand {
    let (friction, spread, evade, flock) = Default::default();
    guidance::ByHand { system, friction, spread, evade, flock }
}

#[test]
fn guidance_has_the_operations_of_handwritten_code_plus_those_of_its_options() {
    for (drivers, evaders) in [(1, 1), (2, 4), (3, 2)] {
        let (library, by_hand) =
            (agents(drivers, evaders).herding(), herding_by_hand(agents(drivers, evaders)));
        let (library, by_hand) = (OpCount::of(&library), OpCount::of(&by_hand));
        let (d, e) = (drivers as u64, evaders as u64);
        // The library subtracts the friction of evaders from accelerations of 0, in x and y. To
        // support the mean, it multiplies the center of the herd by a weight, in x and y.
        let step = Ops { add: 2 * e, multiply: 2, ..Ops::default() };
        assert_eq!(library.step - by_hand.step, step);
        // Friction takes one more subtraction per velocity component, because the library does not
        // merge it into the factor of the velocities. The weight is a factor in the forward and in
        // the reverse pass. The library can compute the cotangents of the control alone, and
        // therefore takes separate multiplications by dt for them.
        let vjp = Ops { add: 2 * (d + e), multiply: 4 + 2 * d, ..Ops::default() };
        assert_eq!(library.vjp - by_hand.vjp, vjp);
    }
}

#[test]
fn quantum_has_the_operations_of_handwritten_code_plus_a_product_per_point() {
    for grid in [3, 10] {
        let system = QuantumSystem { grid, ..QuantumSystem::default() };
        let (trap, cubic) = (Harmonic::default(), Cubic::default());
        // The library multiplies the potential by dt/2 at each point. The handwritten code
        // multiplies the control once. The reverse pass of the library sums the cotangent of the
        // control before adding it to the output.
        let more = Ops { multiply: grid as u64 - 1, ..Ops::default() };
        let more_back = Ops { add: 1, ..more };
        let bare = OpCount::of(&quantum::ByHand::<false, false> { system, trap, cubic });
        assert_eq!(OpCount::of(&system).step - bare.step, more);
        assert_eq!(OpCount::of(&system).vjp - bare.vjp, more_back);
        let (full, library) = (
            quantum::ByHand::<true, true> { system, trap, cubic },
            Forced { system, effects: (trap, cubic) },
        );
        assert_eq!(OpCount::of(&library).step - OpCount::of(&full).step, more);
        assert_eq!(OpCount::of(&library).vjp - OpCount::of(&full).vjp, more_back);
    }
}

/// Checks that next state and cotangents agree to 1e-12.
fn same_physics<A: System, B: System>(a: &A, b: &B) {
    let (n, m) = (a.state_dim(), a.control_dim());
    let wave = |len: usize, speed: f64| {
        (0..len).map(|i| (1.0 + speed * i as f64).sin()).collect::<Vec<_>>()
    };
    let (x, u, cotangents) = (wave(n, 1.3), wave(m, 0.7), wave(n, 2.1));
    let mut found = [vec![0.0; 2 * n + m], vec![0.0; 2 * n + m]];
    for (found, by_hand) in found.iter_mut().zip([false, true]) {
        let (next, rest) = found.split_at_mut(n);
        let (x_bar, u_bar) = rest.split_at_mut(n);
        if by_hand {
            b.step(Inputs::new(&x, &u), next);
            b.vjp(Inputs::new(&x, &u), &cotangents, Cotangents::of(x_bar, u_bar));
        } else {
            a.step(Inputs::new(&x, &u), next);
            a.vjp(Inputs::new(&x, &u), &cotangents, Cotangents::of(x_bar, u_bar));
        }
    }
    for (a, b) in found[0].iter().zip(&found[1]) {
        assert!((a - b).abs() <= 1e-12 * (1.0 + a.abs()), "{a} and {b}");
    }
}

#[test]
fn handwritten_code_has_the_same_results_to_1e_12() {
    let system = cart_pole(3);
    let (pole, cart, wind) =
        (PoleDamping::default(), CartDamping::default(), SteadyWind::default());
    same_physics(&system, &ByHand::<false, false> { system, pole, cart, wind });
    same_physics(
        &Forced { system, effects: (pole, cart) },
        &ByHand::<true, false> { system, pole, cart, wind },
    );
    same_physics(
        &Forced { system, effects: (pole, cart, wind) },
        &ByHand::<true, true> { system, pole, cart, wind },
    );
    same_physics(&agents(2, 4).herding(), &herding_by_hand(agents(2, 4)));
    let (system, trap, cubic) = (QuantumSystem::default(), Harmonic::default(), Cubic::default());
    same_physics(&system, &quantum::ByHand::<false, false> { system, trap, cubic });
    same_physics(
        &Forced { system, effects: (trap, cubic) },
        &quantum::ByHand::<true, true> { system, trap, cubic },
    );
}

/// Returns all states of a trajectory under an oscillating control, and all cotangents of the
/// reverse pass, as bits. Uses one sample and f64.
fn steps<T: Task>(task: &T) -> Vec<u64> {
    let (n, m, horizon) = (task.system().state_dim(), task.system().control_dim(), task.horizon());
    let (mut x, mut p) = (vec![0.0; n], vec![0.0; task.param_dim()]);
    // `initial_states` would compile whole rollouts of each task.
    task.start(&mut stream(3, Purpose::Train, 0), Start { x: &mut x, p: &mut p });
    let mut states = vec![x];
    let control =
        |t: usize| (0..m).map(|i| (0.3 * t as f64 + i as f64).sin()).collect::<Vec<f64>>();
    for t in 0..horizon {
        let mut next = vec![0.0; n];
        task.system().step(Inputs { x: &states[t], u: &control(t), p: &p, t }, &mut next);
        states.push(next);
    }
    let mut found = states.concat();
    let mut bar = vec![0.0; n];
    task.terminal_cost_gradient(&states[horizon], &[], &mut bar, None);
    // The terminal cost depends on some components only. Adds a cotangent of 0.1 to all.
    bar.iter_mut().for_each(|bar| *bar += 0.1);
    for t in (0..horizon).rev() {
        let (mut x_bar, mut u_bar, mut u_only) = (vec![0.0; n], vec![0.0; m], vec![0.0; m]);
        let u = control(t);
        let inputs = Inputs { x: &states[t], u: &u, p: &p, t };
        task.system().vjp(inputs, &bar, Cotangents::of(&mut x_bar, &mut u_bar));
        task.system().vjp(
            inputs,
            &bar,
            Cotangents { u: Some(&mut u_only), ..Cotangents::default() },
        );
        found.extend(x_bar.iter().chain(&u_bar).chain(&u_only));
        bar = x_bar;
    }
    assert!(found.iter().all(|x| x.is_finite()));
    found.into_iter().map(f64::to_bits).collect()
}

/// Compares the bits of trajectories and cotangents.
fn same_bits<A: Task, B: Task>(a: &A, b: &B) {
    assert_eq!(steps(a), steps(b));
}

/// Returns mean loss, last states and the gradients of all flows of a batch of rollouts, as bits.
fn bits<F: Float, T: Task>(task: &T) -> Vec<u64> {
    let (n, m) = (task.system().state_dim(), task.system().control_dim());
    let policy = Mlp::new([n, 6, m]);
    let weights = Weights::<F>::init(&policy, &mut stream(3, Purpose::Policy, 0));
    let samples = 9;
    let starts: Vec<F> = initial_states(task, 3, Purpose::Train, samples);
    let mut found = Vec::new();
    for flow in Flow::ALL {
        let mut batch = Batch::new(task, &policy, samples, &[flow], 1);
        found.push(batch.run(task, &policy, &weights, &starts).expect("finite").to_bits());
        found.extend(batch.gradients()[0].values().iter().map(|g| g.as_().to_bits()));
    }
    let mut rollout = Rollout::for_evaluation(task, &policy, samples);
    rollout.start(&starts);
    rollout.run(task, &policy, &weights).expect("finite");
    let last = (0..samples).flat_map(|sample| (0..n).map(move |i| (sample, i)));
    found.extend(last.map(|(sample, i)| rollout.state(task.horizon(), sample, i).as_().to_bits()));
    found
}

/// Compares the bits of whole rollouts in lanes, in single precision, and calls [`same_bits`].
///
/// Each pair of tasks takes long to compile.
fn same_rollouts<A: Task, B: Task>(a: &A, b: &B) {
    assert_eq!(bits::<f32, _>(a), bits::<f32, _>(b));
    same_bits(a, b);
}

fn swing<S: HasModel<CartPoleSystem>>(system: S) -> CartPole<S> {
    CartPole { horizon: 30, ..CartPole::with_system(system) }
}

fn herd<S: HasModel<GuidanceSystem>>(system: S) -> Guidance<S> {
    Guidance { horizon: 20, ..Guidance::with_system(system) }
}

fn particle<S: HasModel<QuantumSystem>>(system: S) -> Quantum<S> {
    Quantum { horizon: 20, ..Quantum::with_system(system, 3) }
}

#[test]
fn empty_effects_and_actuators_keep_the_bits_of_trajectories() {
    let system = cart_pole(2);
    same_bits(&swing(system), &swing(Forced { system, effects: () }));
    same_bits(&swing(system), &swing(Forced { system, effects: Vec::<CartPoleEffect>::new() }));
    same_bits(&swing(system), &swing(Actuated { system, actuator: () }));
    same_bits(&swing(system), &swing(Actuated { system, actuator: Vec::<AnyActuator>::new() }));
    let system = agents(2, 3);
    same_bits(&herd(system), &herd(Forced { system, effects: () }));
    same_bits(&herd(system), &herd(Forced { system, effects: Vec::<GuidanceEffect>::new() }));
    let system = QuantumSystem { grid: 9, ..QuantumSystem::default() };
    same_bits(&particle(system), &particle(Forced { system, effects: () }));
    same_bits(
        &particle(system),
        &particle(Forced { system, effects: Vec::<QuantumEffect>::new() }),
    );
}

#[test]
fn typed_and_listed_effects_have_the_same_bits() {
    let effects = (
        PoleDamping::default(),
        DryFriction::default(),
        GustyWind::default(),
        Bumpers { half_travel: 0.8, ..Bumpers::default() },
    );
    let list: Vec<CartPoleEffect> =
        vec![effects.0.into(), effects.1.into(), effects.2.into(), effects.3.into()];
    let system = cart_pole(2);
    same_rollouts(
        &swing(Forced { system, effects }),
        &swing(Forced { system, effects: list.clone() }),
    );
    let system = CoupledCartPole(system);
    same_bits(&swing(Forced { system, effects }), &swing(Forced { system, effects: list }));

    // Friction alone, before wind, and after wind.
    let (pole, cart, wind) =
        (PoleDamping::default(), CartDamping::default(), SteadyWind::default());
    let list: [CartPoleEffect; 3] = [pole.into(), cart.into(), wind.into()];
    let system = cart_pole(3);
    same_bits(
        &swing(Forced { system, effects: (pole, cart) }),
        &swing(Forced { system, effects: list[..2].to_vec() }),
    );
    same_bits(
        &swing(Forced { system, effects: (pole, cart, wind) }),
        &swing(Forced { system, effects: list.to_vec() }),
    );
    let others_first: Vec<CartPoleEffect> = vec![wind.into(), cart.into(), pole.into()];
    same_bits(
        &swing(Forced { system, effects: (wind, (cart, pole)) }),
        &swing(Forced { system, effects: others_first }),
    );

    let system = agents(2, 4);
    let (drive, obstacles, walls) =
        (Drive::default(), Obstacles::default(), Walls { half_width: 2.0, ..Walls::default() });
    let paper = (Friction::default(), Spread::default(), Evade::default(), Flock::default());
    let effects = (paper, (drive, obstacles.clone(), walls));
    let list: Vec<GuidanceEffect> = vec![
        paper.0.into(),
        paper.1.into(),
        paper.2.into(),
        paper.3.into(),
        drive.into(),
        obstacles.into(),
        walls.into(),
    ];
    same_rollouts(&herd(Forced { system, effects }), &herd(Forced { system, effects: list }));

    let system = QuantumSystem { grid: 9, ..QuantumSystem::default() };
    let (edges, effects) = (
        AbsorbingEdges::default(),
        (Harmonic::default(), (Barrier::default(), DoubleWell::default()), Cubic::default()),
    );
    let (typed, listed) =
        (Forced { system, effects }, Forced { system, effects: quantum_effects() });
    same_rollouts(&particle(typed), &particle(listed.clone()));
    same_bits(&particle(Absorbing::new(typed, edges)), &particle(Absorbing::new(listed, edges)));
}

#[test]
fn typed_and_listed_actuators_have_the_same_bits() {
    let system = cart_pole(2);
    let (limit, delay, lag) =
        (Limit { bound: 2.0, kind: LimitKind::Smooth }, Delay { steps: 2 }, Lag::new(0.05, 0.01));
    let chain = vec![AnyActuator::Limit(limit), AnyActuator::Delay(delay), AnyActuator::Lag(lag)];
    same_bits(
        &swing(Actuated { system, actuator: (limit, (delay, lag)) }),
        &swing(Actuated { system, actuator: chain.clone() }),
    );
    let typed = Actuated { system, actuator: (limit, (delay, lag)) };
    assert_eq!(OpCount::of(&typed), OpCount::of(&Actuated { system, actuator: chain }));
}

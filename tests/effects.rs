//! The promise of effects: what a scene does not name is not there. Counts and bits are exact; nothing is timed.

#[path = "../benches/by_hand/mod.rs"]
mod by_hand;

use by_hand::cart_pole::ByHand;
use physgrad::policy::Mlp;
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::{
    Bumpers, CartDamping, CartPole, CartPoleEffect, CartPoleSystem, CoupledCartPole, DryFriction, GustyWind, PoleDamping,
    SteadyWind,
};
use physgrad::{
    Actuated, AnyActuator, Around, Batch, Cost, Delay, Effect, Float, Flow, Host, Lag, Limit, LimitKind, Rollout, System, Task,
    Weights, With,
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

/// Counts of step, VJP and VJP to the control alone, one after the other.
fn counts<S: System>(system: &S) -> [physgrad::Counts; 3] {
    let Cost { step, vjp, vjp_control } = Cost::of(system);
    [step, vjp, vjp_control]
}

fn minus(a: [physgrad::Counts; 3], b: [physgrad::Counts; 3]) -> [physgrad::Counts; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

/// Absent effects cost nothing, present ones their own operations, whatever else is there and in whatever order.
fn costs_add_up<H: Host + System + Clone, E: Effect<H::Body>>(system: &H, effects: &[E]) {
    let with = |effects: &[E]| counts(&With { system: system.clone(), effects: effects.to_vec() });
    let bare = counts(system);
    assert_eq!(with(&[]), bare, "an empty list is no effect");
    assert_eq!(counts(&With { system: system.clone(), effects: () }), bare, "() is no effect");
    let own: Vec<_> = effects.iter().map(|effect| minus(with(std::slice::from_ref(effect)), bare)).collect();
    let mut sum = bare;
    for (i, own) in own.iter().enumerate() {
        assert!(own[0].total() > 0, "{:?} does something", effects[i]);
        sum = std::array::from_fn(|k| sum[k] + own[k]);
        assert_eq!(with(&effects[..=i]), sum, "{:?} costs the same beside others", effects[i]);
        let mut others = effects.to_vec();
        others.remove(i);
        assert_eq!(minus(with(effects), with(&others)), *own, "all but {:?}", effects[i]);
    }
    let mut turned = effects.to_vec();
    turned.reverse();
    assert_eq!(with(&turned), with(effects), "the order does not matter");
    turned.rotate_left(1);
    assert_eq!(with(&turned), with(effects), "the order does not matter");
}

#[test]
fn an_effect_costs_its_own_operations_and_nothing_when_absent() {
    for poles in [1, 3] {
        costs_add_up(&cart_pole(poles), &cart_pole_effects());
        costs_add_up(&CoupledCartPole(cart_pole(poles)), &cart_pole_effects());
    }
}

#[test]
fn a_bare_scene_has_the_operations_of_a_system_that_never_heard_of_effects() {
    let system = cart_pole(3);
    let (pole, cart, wind) = (PoleDamping::default(), CartDamping::default(), SteadyWind::default());
    let by_hand = ByHand::<false, false> { system, pole, cart, wind };
    assert_eq!(Cost::of(&system).step, Cost::of(&by_hand).step);
    assert_eq!(Cost::of(&system).vjp, Cost::of(&by_hand).vjp);
    let friction = With { system, effects: (pole, cart) };
    let by_hand = ByHand::<true, false> { system, pole, cart, wind };
    assert_eq!(Cost::of(&friction).step, Cost::of(&by_hand).step);
    assert_eq!(Cost::of(&friction).vjp, Cost::of(&by_hand).vjp);
}

/// Mean loss, last states and the gradients of all flows, as bits.
fn bits<F: Float, T: Task>(task: &T) -> Vec<u64> {
    let (n, m) = (task.system().state_dim(), task.system().control_dim());
    let policy = Mlp::new([n, 6, m]);
    let weights = Weights::<F>::init(&policy, &mut stream(3, Purpose::Policy, 0));
    let samples = 9;
    let mut starts = vec![0.0; samples * n];
    for (sample, x) in starts.chunks_exact_mut(n).enumerate() {
        task.start(&mut stream(3, Purpose::Train, sample as u64), x);
    }
    let starts: Vec<F> = starts.into_iter().map(F::lift).collect();
    let mut found = Vec::new();
    for flow in Flow::ALL {
        let mut batch = Batch::new(task, &policy, samples, &[flow], 1);
        found.push(batch.run(task, &policy, &weights, &starts).expect("finite").to_bits());
        found.extend(batch.gradients()[0].iter().map(|g| g.as_().to_bits()));
    }
    let mut rollout = Rollout::for_evaluation(task, &policy, samples);
    rollout.start(&starts);
    rollout.run(task, &policy, &weights).expect("finite");
    let last = (0..samples).flat_map(|sample| (0..n).map(move |i| (sample, i)));
    found.extend(last.map(|(sample, i)| rollout.state(task.horizon(), sample, i).as_().to_bits()));
    found
}

fn same_bits<A: Task, B: Task>(a: &A, b: &B) {
    assert_eq!(bits::<f32, _>(a), bits::<f32, _>(b));
    assert_eq!(bits::<f64, _>(a), bits::<f64, _>(b));
}

fn swing<S: Around<CartPoleSystem>>(system: S) -> CartPole<S> {
    CartPole { horizon: 30, ..CartPole::around(system) }
}

#[test]
fn without_effects_a_rollout_has_the_bits_of_the_system_alone() {
    let system = cart_pole(2);
    same_bits(&swing(system), &swing(With { system, effects: () }));
    same_bits(&swing(system), &swing(With { system, effects: Vec::<CartPoleEffect>::new() }));
    same_bits(&swing(system), &swing(Actuated { system, actuator: () }));
    same_bits(&swing(system), &swing(Actuated { system, actuator: Vec::<AnyActuator>::new() }));
}

#[test]
fn typed_and_listed_effects_have_the_same_bits() {
    let effects =
        (PoleDamping::default(), DryFriction::default(), GustyWind::default(), Bumpers { reach: 0.8, ..Bumpers::default() });
    let list: Vec<CartPoleEffect> = vec![effects.0.into(), effects.1.into(), effects.2.into(), effects.3.into()];
    let system = cart_pole(2);
    same_bits(&swing(With { system, effects }), &swing(With { system, effects: list.clone() }));
    let system = CoupledCartPole(system);
    same_bits(&swing(With { system, effects }), &swing(With { system, effects: list }));
}

#[test]
fn typed_and_listed_actuators_have_the_same_bits() {
    let system = cart_pole(2);
    let (limit, delay, lag) = (Limit { bound: 2.0, kind: LimitKind::Smooth }, Delay { steps: 2 }, Lag::new(0.05, 0.01));
    let chain = vec![AnyActuator::Limit(limit), AnyActuator::Delay(delay), AnyActuator::Lag(lag)];
    same_bits(&swing(Actuated { system, actuator: (limit, (delay, lag)) }), &swing(Actuated { system, actuator: chain.clone() }));
    let typed = Actuated { system, actuator: (limit, (delay, lag)) };
    assert_eq!(Cost::of(&typed), Cost::of(&Actuated { system, actuator: chain }));
}

//! Wrappers of systems forward the cause of a non-finite number.

use physgrad::actuator::Delay;
use physgrad::effect::{DynEffect, ForcedSystem, Named};
use physgrad::engine::Cause;
use physgrad::integrator::{AnyIntegrator, ImplicitMidpoint};
use physgrad::policy::Linear;
use physgrad::scalar::{CotangentPack, Dual, Lanes};
use physgrad::tasks::{
    Barrier, Bumpers, CartPole, CartPoleEffect, CartPoleSystem, Cubic, DoublePendulum, Evade,
    GuidanceSystem, GustyWind, Pade, QuantumEffect, QuantumScheme, QuantumSystem, Renormalized,
    SteadyWind, Strang, Tabulated, Upright,
};
use physgrad::{
    Actuated, Cotangents, Divergence, DynSystem, DynTask, Effect, Forced, Inputs, Integrated,
    OdeInputs, Real, Scalar, Substeps, System, Task, Weights, check, rollout,
};

/// Effect whose force is infinite at a state of ones.
const OVERFLOWING: Cubic = Cubic { strength: 1e308 };

/// Returns the cause at a state of ones.
fn cause<S: System>(system: &S) -> Option<Cause> {
    let (x, u, p) = (
        vec![1.0; system.state_dim()],
        vec![0.0; system.control_dim()],
        vec![1.0; system.param_dim()],
    );
    system.diagnose(Inputs { p: &p, ..Inputs::new(&x, &u) })
}

/// Each of these systems has more state components than forces.
#[test]
fn forced_systems_name_the_effect_with_a_non_finite_force() {
    let model = QuantumSystem { grid: 7, ..QuantumSystem::default() };
    let cubic = Some(Cause::Effect("Cubic"));
    assert_eq!(cause(&Forced { system: model, effects: OVERFLOWING }), cubic);
    assert_eq!(cause(&Forced { system: Pade(model), effects: OVERFLOWING }), cubic);
    assert_eq!(cause(&Forced { system: Strang::new(model), effects: OVERFLOWING }), cubic);
    assert_eq!(
        cause(&Forced {
            system: QuantumScheme::CrankNicolson(model),
            effects: vec![QuantumEffect::from(OVERFLOWING)]
        }),
        cubic
    );
    let windy = Forced {
        system: CartPoleSystem::default(),
        effects: GustyWind { gust: 1e200.into(), ..GustyWind::default() },
    };
    assert_eq!(cause(&windy), Some(Cause::Effect("GustyWind")));
    let herd =
        Forced { system: GuidanceSystem::default(), effects: Evade { strength: f64::INFINITY } };
    assert_eq!(cause(&herd), Some(Cause::Effect("Evade")));
    assert_eq!(
        cause(&Forced { system: model, effects: (Barrier::default(), Cubic::default()) }),
        None
    );
}

#[test]
fn the_cause_has_the_name_that_named_gives_to_its_effect() {
    let model = QuantumSystem { grid: 7, ..QuantumSystem::default() };
    let table = Tabulated { values: vec![f64::INFINITY; 7] };
    let named = Named { name: "effects.double_well", effect: QuantumEffect::from(table) };
    assert_eq!(
        cause(&Forced { system: model, effects: vec![named] }),
        Some(Cause::Effect("effects.double_well"))
    );
    let both = (
        Named { name: "finite", effect: Barrier::default() },
        Named { name: "infinite", effect: OVERFLOWING },
    );
    assert_eq!(cause(&Forced { system: model, effects: both }), Some(Cause::Effect("infinite")));
}

#[test]
fn wrappers_forward_the_cause_of_the_wrapped_system() {
    let model = QuantumSystem { grid: 7, ..QuantumSystem::default() };
    let system = Forced { system: model, effects: OVERFLOWING };
    let cubic = Some(Cause::Effect("Cubic"));
    assert_eq!(cause(&Renormalized { system }), cubic);
    assert_eq!(cause(&Substeps { system, count: 3 }), cubic);
    assert_eq!(
        cause(&Actuated { system: Renormalized { system }, actuator: Delay { steps: 2 } }),
        cubic
    );
    // Newton's iteration does not converge for this time step.
    let integrator = AnyIntegrator::ImplicitMidpoint(ImplicitMidpoint::default());
    let stepped = Integrated { ode: DoublePendulum::default(), integrator, dt: 1e12 };
    let Upright { first_angle, from, spread, loss, control_weight, control_bound, horizon, .. } =
        Upright::double_pendulum();
    let hard = DynTask::new(Upright {
        system: stepped,
        first_angle,
        from,
        spread,
        loss,
        control_weight,
        control_bound,
        horizon,
    });
    let hard = hard.system();
    assert!(matches!(cause(hard), Some(Cause::Unsolved(_))), "{:?}", cause(hard));
    assert_eq!(cause(hard), cause(&stepped));
    // `check::stability` evaluates JVPs through these wrappers.
    let system = DynTask::new(Upright::double_pendulum()).system().clone();
    let lagging = Actuated { system: Substeps { system, count: 2 }, actuator: Delay { steps: 1 } };
    let zeros = vec![0.0; 5];
    assert!(check::stability(&lagging, Inputs::new(&zeros, &zeros[..1])).multiplier.is_finite());
    // The engine diagnoses the step of one sample, which fills all lanes.
    let substeps = Substeps { system: hard.clone(), count: 2 };
    let ones = [Lanes([1.0_f64; 8]); 4];
    assert!(matches!(substeps.diagnose(Inputs::new(&ones, &ones[..1])), Some(Cause::Unsolved(_))));
}

/// System whose state is 1e200 after one substep and infinite after two, even without effects.
struct Overflows;

impl ForcedSystem for Overflows {
    type Model = Self;
    fn model(&self) -> &Self {
        self
    }
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn force_dim(&self) -> usize {
        1
    }
    fn dt(&self) -> f64 {
        1.0
    }
    fn forced_step<E: Effect<Self>, T: Scalar>(
        &self,
        effects: &E,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    ) {
        next[0] = inputs.x[0] * 1e200;
        effects.add_forces(self, inputs.continuous(1.0), next);
    }
}

/// Effect that adds the state to the forces.
#[derive(Clone, Debug)]
struct AddsState;

impl Effect<Overflows> for AddsState {
    fn add_forces<T: Scalar>(
        &self,
        _model: &Overflows,
        OdeInputs { x, .. }: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        forces[0] += x[0];
    }
}

#[test]
fn a_non_finite_state_is_not_attributed_to_an_effect() {
    let system = Forced { system: Overflows, effects: AddsState };
    assert_eq!(cause(&Substeps { system, count: 4 }), None);
}

/// The wind overflows at the speed that bumpers cause with long time steps.
#[test]
fn an_effect_that_overflows_at_a_grown_state_is_not_the_cause() {
    let effects =
        || -> Vec<CartPoleEffect> { vec![SteadyWind::default().into(), Bumpers::default().into()] };
    let end = |dt: f64, effects: Vec<CartPoleEffect>| {
        let system = CartPoleSystem { dt, ..CartPoleSystem::default() };
        let task = CartPole::with_system(Forced { system, effects });
        let policy = Linear::with_bias(task.system().state_dim(), 1);
        let weights = Weights::new(&policy, vec![0.0_f32; task.system().state_dim() + 1]);
        let mut start = vec![0.0; task.system().state_dim()];
        // Beyond the bumpers, at 2 m.
        start[0] = 3.0;
        rollout(&task, &policy, &weights, &start).map(drop)
    };
    assert_eq!(end(0.02, effects()), Ok(()));
    let divergence = end(1.0, effects()).expect_err("the bumpers are unstable");
    let Divergence::Forward { cause: Some(Cause::Grown(largest)), .. } = divergence else {
        panic!("{divergence:?}")
    };
    assert!(largest > 4e9, "{largest:e}, whose fourth power must exceed the range of f32");
    let message = divergence.to_string();
    assert!(message.contains("Reduce the time step") && !message.contains("wind"), "{message}");
    // An effect that overflows at an ordinary state is the cause.
    let storm = SteadyWind { speed: 1e30.into(), ..SteadyWind::default() };
    let divergence = end(0.02, vec![storm.into()]).expect_err("the wind overflows");
    let Divergence::Forward { cause: Some(Cause::Effect(_)), .. } = divergence else {
        panic!("{divergence:?}")
    };
}

/// User-defined effect with an infinite force.
#[derive(Clone, Debug)]
struct Explosion;

impl Effect<QuantumSystem> for Explosion {
    fn add_forces<T: Scalar>(
        &self,
        _model: &QuantumSystem,
        _inputs: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        forces[0] += f64::INFINITY;
    }
}

#[test]
fn effects_of_users_have_the_names_of_their_types_behind_pointers() {
    let model = QuantumSystem { grid: 7, ..QuantumSystem::default() };
    let cause_of = |effect: DynEffect<QuantumSystem>| {
        let listed =
            vec![QuantumEffect::from(Cubic::default()), QuantumEffect::from(effect.clone())];
        let causes = [
            cause(&Forced { system: model, effects: effect }),
            cause(&Forced { system: model, effects: listed }),
        ];
        assert_eq!(causes[0], causes[1]);
        causes[0]
    };
    assert_eq!(cause_of(DynEffect::new(Explosion)), Some(Cause::Effect("Explosion")));
    assert_eq!(cause_of(DynEffect::new(Cubic::default())), None);
    // A cause names the effect inside the pointer, not the pointer.
    assert_eq!(
        cause_of(DynEffect::new((Cubic::default(), OVERFLOWING))),
        Some(Cause::Effect("Cubic"))
    );
    assert_eq!(
        cause_of(DynEffect::new(Named { name: "boom", effect: Explosion })),
        Some(Cause::Effect("boom"))
    );
}

/// System of a task behind a pointer, with default derivatives, which use dual numbers over lanes.
struct Around(DynSystem);

impl System for Around {
    fn state_dim(&self) -> usize {
        self.0.state_dim()
    }
    fn control_dim(&self) -> usize {
        self.0.control_dim()
    }
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        self.0.step(inputs, next);
    }
}

/// Returns the message of the panic of `call`.
fn panic_of(call: impl FnOnce()) -> String {
    *std::panic::catch_unwind(std::panic::AssertUnwindSafe(call))
        .expect_err("the call panics")
        .downcast::<String>()
        .expect("a formatted message")
}

#[test]
fn a_scalar_outside_of_the_set_of_a_pointer_panics_with_scalar_set_and_advice() {
    let task = DynTask::new(Upright::double_pendulum());
    let message = panic_of(|| {
        let x = [Dual::<f64, 3>::constant(0.1); 4];
        task.system().step(Inputs::new(&x, &[Dual::constant(0.0)]), &mut [Dual::constant(0.0); 4]);
    });
    for part in [
        "`DynTask` of ",
        "Upright",
        "`step` has no instance for",
        "Dual<f64, 3>",
        "`Dual<f64, 4>`",
        "call `step` of",
    ] {
        assert!(message.contains(part), "{part}: {message}");
    }
    let message = panic_of(|| {
        let number = Lanes::<f64, 8>::splat(0.1);
        let (mut x_bar, mut u_bar) = ([CotangentPack([number]); 4], [CotangentPack([number])]);
        let around = Around(DynTask::new(Upright::double_pendulum()).system().clone());
        around.vjp(
            Inputs::new(&[number; 4], &[number]),
            &x_bar.clone(),
            Cotangents::of(&mut x_bar, &mut u_bar),
        );
    });
    assert!(
        message.contains("Dual<") && message.contains("needs a `vjp` and a `jvp` of its own"),
        "{message}"
    );

    let model = QuantumSystem { grid: 7, ..QuantumSystem::default() };
    let message = panic_of(|| {
        let x = [Dual::<f64, 3>::constant(0.1); 14];
        let inputs = OdeInputs { x: &x, u: &x[..1], p: &[], t: x[0] };
        DynEffect::new(Explosion).add_forces(&model, inputs, &mut [Dual::constant(0.0); 7]);
    });
    for part in [
        "`DynEffect` of Explosion",
        "`add_forces` has no instance for",
        "Dual<f64, 3>",
        "`Dual<f64, 4>`",
        "without",
    ] {
        assert!(message.contains(part), "{part}: {message}");
    }
}

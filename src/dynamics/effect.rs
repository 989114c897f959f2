//! Optional parts of the physics, and systems to whose forces they add.
//!
//! [`Effect`] is the trait to implement for a custom effect. [`ForcedSystem`] is a system whose
//! forces effects can change, and [`Forced`] combines the two.
//!
//! The effects are part of a system's type: `()` for none, a tuple for several. Absent effects
//! compile to nothing: no branch, state, memory or operation.

mod dyn_effect;
mod list;
mod named;
mod tuples;
mod without;

use crate::dynamics::cause::Cause;
use crate::dynamics::default_vjp::{Add, Function, default_vjp};
use crate::dynamics::inputs::{Cotangents, Inputs, OdeInputs, Start};
use crate::dynamics::number::{Numbers, ParamDual, Varied, param_vjp};
use crate::dynamics::outline;
use crate::dynamics::system::{System, step_vjp};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, CotangentPack, Over, Real, Scalar};
pub use dyn_effect::DynEffect;
pub(crate) use list::{AddForces, Vjp, any_effect};
pub use named::Named;
use std::fmt::Debug;
pub(crate) use without::system_without_effects;

/// Optional part of the physics that adds to the forces of a system, or to its Hamiltonian.
///
/// `B` is the model that effects read: sizes, masses, lengths. The documentation of each system
/// defines its state and its forces.
///
/// Only [`add_forces`](Effect::add_forces) is required. The default derivative is exact. An
/// analytic [`vjp`](Effect::vjp) is faster. [`check::system`](crate::check::system) compares the
/// two for a system with the effect.
///
/// ```
/// use physgrad::tasks::CartPoleSystem;
/// use physgrad::{Effect, Forced, OdeInputs, Scalar, check};
///
/// /// A spring that pulls the cart to the middle: F = -stiffness x.
/// #[derive(Clone, Debug)]
/// struct Spring { stiffness: f64 }
///
/// impl Effect<CartPoleSystem> for Spring {
///     fn add_forces<T: Scalar>(&self, _model: &CartPoleSystem, inputs: OdeInputs<'_, T>, forces: &mut [T]) {
///         forces[0] -= inputs.x[0] * self.stiffness;
///     }
/// }
///
/// let system = Forced { system: CartPoleSystem::default(), effects: Spring { stiffness: 3.0 } };
/// check::system(&system).unwrap();
/// ```
pub trait Effect<B>: Clone + Debug + Send + Sync {
    /// Number of parameters of this effect. They are the first entries of the `p` that it receives.
    /// Default: the count of [`numbers`](Effect::numbers) that vary.
    #[inline(always)]
    fn param_dim(&self) -> usize {
        self.numbers().varied()
    }

    /// Physical numbers of this effect that may vary between samples or be trained. Numbers that
    /// vary are the last of its parameters. Default: none.
    #[inline(always)]
    fn numbers(&self) -> Numbers<'_> {
        Numbers::default()
    }

    /// Numbers that vary, with their indices in `p`, where the parameters of this effect begin at
    /// `first`. An effect that contains another one forwards it; see
    /// [`System::varied`](crate::System::varied).
    fn varied(&self, first: usize) -> Vec<Varied> {
        let numbers = self.numbers();
        numbers.placed(first + self.param_dim() - numbers.varied())
    }

    /// Draws the parameters of one sample into `p`, which holds [`param_dim`](Effect::param_dim)
    /// zeros. The physical numbers that vary receive their draws afterwards.
    fn draw_params(&self, _rng: &mut Rng, _p: &mut [f64]) {}

    /// Adds the forces of this effect to `forces`. The time `inputs.t` has the unit of
    /// [`dt`](ForcedSystem::dt).
    ///
    /// Mark implementations `#[inline(always)]`: only inlined code is compiled for AVX2.
    fn add_forces<T: Scalar>(&self, model: &B, inputs: OdeInputs<'_, T>, forces: &mut [T]);

    /// Adds the Jacobian product `(∂forces/∂x)ᵀ forces_bar`, and likewise for `u` and `p`, to those
    /// cotangents that are requested.
    ///
    /// An implementation may omit the cotangents of physical numbers that vary. If the system or an
    /// effect has such numbers, dual numbers provide the cotangents of all parameters, and `p` is
    /// not requested.
    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        model: &B,
        inputs: OdeInputs<'_, R>,
        forces_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        default_effect_vjp(self, model, inputs, forces_bar, cotangents);
    }

    /// Returns whether the forces depend on state, control or parameters. If they do not, a system
    /// may skip [`vjp`](Effect::vjp).
    #[inline(always)]
    fn state_dependent(&self) -> bool {
        true
    }

    /// Returns the name of this effect if its forces or their derivatives are non-finite. The
    /// inputs must be finite. `forces` is the number of forces of the system. The name is that of
    /// the type, or the one given by [`Named`]. Used only for error messages.
    #[doc(hidden)]
    fn diagnose<R: Real>(
        &self,
        model: &B,
        inputs: OdeInputs<'_, R>,
        forces: usize,
    ) -> Option<&'static str> {
        let name = || {
            std::any::type_name::<Self>()
                .split('<')
                .next()
                .and_then(|path| path.rsplit("::").next())
        };
        if is_finite(self, model, inputs, forces) { None } else { name() }
    }
}

/// [`Effect::add_forces`] as a function of state, control and parameters.
struct Forces<'a, E, B, R> {
    effect: &'a E,
    model: &'a B,
    t: R,
}

impl<B, E: Effect<B>, R: Real> Function<R, 3> for Forces<'_, E, B, R> {
    #[inline(always)]
    fn eval<T: Over<R>>(&self, [x, u, p]: [&[T]; 3], forces: &mut [T]) {
        forces.fill(T::zero());
        self.effect.add_forces(self.model, Inputs { x, u, p, t: T::constant(self.t) }, forces);
    }
}

/// Exact transposed Jacobian product of any effect through [`Effect::add_forces`].
#[inline]
pub(crate) fn default_effect_vjp<B, E: Effect<B>, R: Real, C: Cotangent<R>>(
    effect: &E,
    model: &B,
    inputs: OdeInputs<'_, R>,
    forces_bar: &[C],
    cotangents: Cotangents<'_, C>,
) {
    let forces = Forces { effect, model, t: inputs.t };
    default_vjp(&forces, inputs.lists(), forces_bar, cotangents.lists(), Add::Each);
}

/// Returns whether the forces of an effect and their derivatives with respect to state and control
/// are finite.
pub(crate) fn is_finite<B, E: Effect<B>, R: Real>(
    effect: &E,
    model: &B,
    inputs: OdeInputs<'_, R>,
    forces: usize,
) -> bool {
    let mut force = vec![R::zero(); forces];
    let zeros = |len: usize| vec![CotangentPack([R::zero()]); len];
    let (mut x_bar, mut u_bar) = (zeros(inputs.x.len()), zeros(inputs.u.len()));
    effect.add_forces(model, inputs, &mut force);
    effect.vjp(
        model,
        inputs,
        &vec![CotangentPack([R::one()]); forces],
        Cotangents::of(&mut x_bar, &mut u_bar),
    );
    force.iter().chain(x_bar.iter().chain(&u_bar).map(|bar| &bar.0[0])).all(Real::is_finite)
}

/// System to whose forces effects can add.
///
/// Required: [`forced_step`](ForcedSystem::forced_step), the model, the time step, and the
/// dimensions of state, control and forces. Effects receive the inputs of the step, with the time
/// in place of the step number ([`Inputs::continuous`]). A system with parameters of its own
/// removes these from the inputs of the effects ([`Inputs::skip_params`]).
pub trait ForcedSystem: Send + Sync {
    /// Model that effects read; often the system itself.
    type Model;

    /// Returns the model that effects read.
    fn model(&self) -> &Self::Model;
    /// Number of state components.
    fn state_dim(&self) -> usize;
    /// Number of control components.
    fn control_dim(&self) -> usize;
    /// Number of parameters, without those of effects and without numbers that vary. Default: 0.
    fn param_dim(&self) -> usize {
        0
    }
    /// Physical numbers that may vary; see [`System::numbers`].
    #[inline(always)]
    fn numbers(&self) -> Numbers<'_> {
        Numbers::default()
    }
    /// Number of forces to which effects add.
    fn force_dim(&self) -> usize;
    /// Time step, in the unit of time of the system: s, except for quantum systems.
    fn dt(&self) -> f64;

    /// Writes the next state under the given effects.
    fn forced_step<E: Effect<Self::Model>, T: Scalar>(
        &self,
        effects: &E,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    );

    /// VJP of [`forced_step`](ForcedSystem::forced_step). Adds to the requested cotangents.
    ///
    /// Defaults to exact derivatives, as [`System::vjp`] does. Override it for speed. It may omit
    /// the cotangents of physical numbers that vary, as [`Effect::vjp`] may.
    #[inline(always)]
    fn forced_vjp<E: Effect<Self::Model>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        step_vjp(&SystemStep { system: self, effects }, inputs, next_bar, cotangents);
    }
}

/// Forced system with its effects, for default derivatives.
struct SystemStep<'a, H: ?Sized, E> {
    system: &'a H,
    effects: &'a E,
}

impl<H: ForcedSystem + ?Sized, E: Effect<H::Model>> System for SystemStep<'_, H, E> {
    fn state_dim(&self) -> usize {
        self.system.state_dim()
    }
    fn control_dim(&self) -> usize {
        self.system.control_dim()
    }
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        self.system.forced_step(self.effects, inputs, next);
    }
}

/// Adds the cotangents of all parameters of a step, by dual numbers. Used if physical numbers vary,
/// because analytic VJPs may omit their cotangents.
pub(crate) fn step_param_vjp<S: System, R: Real, C: Cotangent<R>>(
    system: &S,
    inputs: Inputs<'_, R>,
    next_bar: &[C],
    p_bar: Option<&mut [C]>,
) {
    let step = |_: usize, [x, u, p]: [&[ParamDual]; 3], next: &mut [ParamDual]| {
        outline::step(system, Inputs { x, u, p, t: inputs.t }, next);
    };
    param_vjp(&step, inputs.lists(), next_bar, p_bar);
}

/// System with effects. The parameters are those of the system, those of the effects, then the
/// numbers of the system that vary.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Forced<H, E> {
    /// System to whose forces the effects add.
    pub system: H,
    /// Effects: `()` for none, a tuple for several, a `Vec` for a choice at run time.
    pub effects: E,
}

impl<H: ForcedSystem, E: Effect<H::Model>> System for Forced<H, E> {
    fn state_dim(&self) -> usize {
        self.system.state_dim()
    }

    fn control_dim(&self) -> usize {
        self.system.control_dim()
    }

    fn param_dim(&self) -> usize {
        self.system.param_dim() + self.effects.param_dim() + self.system.numbers().varied()
    }

    fn varied(&self, params: usize) -> Vec<Varied> {
        let numbers = self.system.numbers();
        let mut varied = self.effects.varied(self.system.param_dim());
        varied.extend(numbers.placed(params - numbers.varied()));
        varied
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        self.system.forced_step(&self.effects, inputs, next);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        if cotangents.p.is_some() && !self.varied(inputs.p.len()).is_empty() {
            step_param_vjp(self, inputs, next_bar, cotangents.p.take());
        }
        self.system.forced_vjp(&self.effects, inputs, next_bar, cotangents);
    }

    fn diagnose<R: Real>(&self, inputs: Inputs<'_, R>) -> Option<Cause> {
        let inputs = inputs.skip_params(self.system.param_dim()).continuous(self.system.dt());
        self.effects
            .diagnose(self.system.model(), inputs, self.system.force_dim())
            .map(Cause::Effect)
    }
}

/// System that contains a model `B`, for instance `B` alone, with effects or behind an actuator.
///
/// Tasks for `B` accept any such system. The first components of the state are those of `B`.
pub trait HasModel<B>: System {
    /// Returns the model.
    fn model(&self) -> &B;
    /// Draws the initial values of the state components beyond those of the model, and the
    /// parameters of the effects.
    fn start_extra(&self, rng: &mut Rng, start: Start<'_>);
}

impl<H: ForcedSystem, E: Effect<H::Model>> HasModel<H::Model> for Forced<H, E> {
    #[inline(always)]
    fn model(&self) -> &H::Model {
        self.system.model()
    }

    fn start_extra(&self, rng: &mut Rng, start: Start<'_>) {
        self.effects
            .draw_params(rng, &mut start.p[self.system.param_dim()..][..self.effects.param_dim()]);
    }
}

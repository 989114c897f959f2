//! [`Ode`]: a vector field in continuous time.
//!
//! An [`Integrator`](crate::integrator::Integrator) discretizes the vector field into a
//! [`System`](crate::System); see [`Integrated`](crate::Integrated).

use crate::dynamics::cause::Cause;
use crate::dynamics::default_vjp::{Add, Function, default_vjp};
use crate::dynamics::effect::{Effect, Forced, ForcedSystem};
use crate::dynamics::inputs::{Cotangents, Inputs, OdeInputs};
use crate::dynamics::number::{Numbers, ParamDual, Varied, param_vjp};
use crate::dynamics::outline::outline;
use crate::dynamics::system::System;
use crate::numbers::kernels::Vectorized;
use crate::numbers::scalar::{Cotangent, CotangentPack, Float, Over, Real, Scalar};
use crate::numbers::zip::zip;
use smallvec::{SmallVec, smallvec};

/// An ordinary differential equation `dx/dt = f(x, u, p, t)`, with constant control during a step.
///
/// Required: the dimensions and [`rate`](Ode::rate). [`rate_vjp`](Ode::rate_vjp) defaults to exact
/// derivatives, as [`System::vjp`] does. Override it with an analytic derivative for speed.
/// [`Integrated`](crate::Integrated) turns an `Ode` into a [`System`](crate::System).
///
/// ```
/// use physgrad::{Integrated, Ode, OdeInputs, Scalar, check, integrator::RungeKutta};
///
/// /// A mass on a spring, pulled by u: x = [position in m, velocity in m/s].
/// struct Spring { stiffness: f64 }
///
/// impl Ode for Spring {
///     fn state_dim(&self) -> usize { 2 }
///     fn control_dim(&self) -> usize { 1 }
///     fn rate<T: Scalar>(&self, OdeInputs { x, u, .. }: OdeInputs<'_, T>, rate: &mut [T]) {
///         rate[0] = x[1];
///         rate[1] = u[0] - x[0] * self.stiffness;
///     }
/// }
///
/// let system = Integrated { ode: Spring { stiffness: 3.0 }, integrator: RungeKutta::RK4, dt: 0.1 };
/// check::system(&system).unwrap();
/// ```
pub trait Ode: Send + Sync {
    /// Number of state components.
    fn state_dim(&self) -> usize;
    /// Number of control components.
    fn control_dim(&self) -> usize;

    /// Number of parameters. Default: the count of [`numbers`](Ode::numbers) that vary.
    fn param_dim(&self) -> usize {
        self.numbers().varied()
    }

    /// Physical numbers that may vary; see [`System::numbers`](crate::System::numbers).
    #[inline(always)]
    fn numbers(&self) -> Numbers<'_> {
        Numbers::default()
    }

    /// Numbers that vary, with their indices in `p`, of length `params`. A right-hand side that
    /// contains another one forwards it; see [`System::varied`](crate::System::varied).
    fn varied(&self, params: usize) -> Vec<Varied> {
        let numbers = self.numbers();
        numbers.placed(params - numbers.varied())
    }

    /// Writes `f(x, u, p, t)`, of `state_dim` entries, into `rate`. The time t is in s.
    fn rate<T: Scalar>(&self, inputs: OdeInputs<'_, T>, rate: &mut [T]);

    /// Adds `(∂f/∂x)ᵀ rate_bar`, `(∂f/∂u)ᵀ rate_bar` and `(∂f/∂p)ᵀ rate_bar` to those cotangents
    /// that are requested.
    #[inline(always)]
    fn rate_vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: OdeInputs<'_, R>,
        rate_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let rate = Rate { ode: self, t: inputs.t };
        default_vjp(&rate, inputs.lists(), rate_bar, cotangents.lists(), Add::Sum);
    }

    /// Index of the velocity of component `i`, or `None` if `i` is not a position.
    ///
    /// `Some(j)` requires `f_i = x_j` exactly, as partitioned integrators
    /// ([`SemiImplicit`](crate::integrator::SemiImplicit), [`Verlet`](crate::integrator::Verlet))
    /// assume. Component `j` must not be a position itself.
    #[inline(always)]
    fn velocity(&self, _i: usize) -> Option<usize> {
        None
    }

    /// Diagnoses a non-finite rate, or a non-finite derivative of the rate; see
    /// [`System::diagnose`](crate::System::diagnose).
    fn diagnose<R: Real>(&self, _inputs: OdeInputs<'_, R>) -> Option<Cause> {
        None
    }
}

/// [`Ode::rate`] as a function of state, control and parameters.
struct Rate<'a, O: ?Sized, R> {
    ode: &'a O,
    t: R,
}

impl<O: Ode + ?Sized, R: Real> Function<R, 3> for Rate<'_, O, R> {
    #[inline(always)]
    fn eval<T: Over<R>>(&self, [x, u, p]: [&[T]; 3], rate: &mut [T]) {
        self.ode.rate(Inputs { x, u, p, t: T::constant(self.t) }, rate);
    }
}

/// [`Ode::rate`] in dual numbers, never inlined: compiled once per vector field.
#[inline(never)]
fn dual_rate<O: Ode>(ode: &O, inputs: OdeInputs<'_, ParamDual>, rate: &mut [ParamDual]) {
    ode.rate(inputs, rate);
}

/// Adds the cotangents of all parameters of a rate, by dual numbers. Used if physical numbers vary,
/// because analytic VJPs may omit their cotangents.
fn rate_param_vjp<O: Ode, R: Real, C: Cotangent<R>>(
    ode: &O,
    inputs: OdeInputs<'_, R>,
    rate_bar: &[C],
    p_bar: Option<&mut [C]>,
) {
    // The stages of adaptive steps have different times in different lanes.
    let rate = |lane: usize, [x, u, p]: [&[ParamDual]; 3], rate: &mut [ParamDual]| {
        dual_rate(ode, Inputs { x, u, p, t: ParamDual::from(inputs.t.lane(lane).to_f64()) }, rate);
    };
    param_vjp(&rate, inputs.lists(), rate_bar, p_bar);
}

/// Object-safe [`Ode`] for one scalar type.
///
/// Integrators take `&dyn DynOde<T>`, so they are monomorphized once per scalar type and not once
/// per vector field. Every [`Ode`] implements `DynOde`.
pub trait DynOde<T> {
    /// See [`Ode::rate`].
    fn rate(&self, inputs: OdeInputs<'_, T>, rate: &mut [T]);
    /// See [`Ode::velocity`].
    fn velocity(&self, i: usize) -> Option<usize>;
}

/// A [`DynOde`] with derivatives: object-safe [`Ode`] for one scalar and one cotangent type.
pub trait DynOdeVjp<R, C>: DynOde<R> {
    /// See [`Ode::rate_vjp`].
    fn rate_vjp(&self, inputs: OdeInputs<'_, R>, rate_bar: &[C], cotangents: Cotangents<'_, C>);
    /// Writes row `i` of the Jacobian, `∂f_i/∂x`.
    fn slopes(&self, inputs: OdeInputs<'_, R>, i: usize, row: &mut [R]);
}

impl<O: Ode, T: Scalar> DynOde<T> for O {
    #[inline(always)]
    fn rate(&self, inputs: OdeInputs<'_, T>, rate: &mut [T]) {
        Ode::rate(self, inputs, rate);
    }

    #[inline(always)]
    fn velocity(&self, i: usize) -> Option<usize> {
        Ode::velocity(self, i)
    }
}

/// Outlined [`DynOdeVjp::slopes`].
struct Slopes<'a, O, R> {
    ode: &'a O,
    inputs: OdeInputs<'a, R>,
    i: usize,
    row: &'a mut [R],
}

impl<O: Ode, R: Real> Vectorized for Slopes<'_, O, R> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        /// One cotangent per component; on the stack for up to 32 components.
        type Bars<R> = SmallVec<[CotangentPack<R, 1>; 32]>;
        let Self { ode, inputs, i, row } = self;
        let (n, none) = (inputs.x.len(), CotangentPack([R::zero()]));
        let (mut rate_bar, mut x_bar): (Bars<R>, Bars<R>) =
            (smallvec![none; n], smallvec![none; n]);
        rate_bar[i] = CotangentPack([R::one()]);
        ode.rate_vjp(
            inputs,
            &rate_bar,
            Cotangents { x: Some(&mut x_bar), ..Cotangents::default() },
        );
        for (slope, CotangentPack([bar])) in zip(row.iter_mut(), x_bar) {
            *slope = bar;
        }
    }
}

impl<O: Ode, R: Real, C: Cotangent<R>> DynOdeVjp<R, C> for O {
    #[inline(always)]
    fn rate_vjp(&self, inputs: OdeInputs<'_, R>, rate_bar: &[C], cotangents: Cotangents<'_, C>) {
        Ode::rate_vjp(self, inputs, rate_bar, cotangents);
    }

    fn slopes(&self, inputs: OdeInputs<'_, R>, i: usize, row: &mut [R]) {
        outline::<R>(Slopes { ode: self, inputs, i, row });
    }
}

/// A [`ForcedSystem`] in continuous time: an [`Ode`], with or without effects.
pub trait ForcedOde: ForcedSystem {
    /// Writes the rates under `effects`.
    fn forced_rate<E: Effect<Self::Model>, T: Scalar>(
        &self,
        effects: &E,
        inputs: OdeInputs<'_, T>,
        rate: &mut [T],
    );

    /// VJP of [`forced_rate`](ForcedOde::forced_rate). Adds to the requested cotangents. It may
    /// omit the cotangents of physical numbers that vary, as [`Effect::vjp`] may.
    fn forced_rate_vjp<E: Effect<Self::Model>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        inputs: OdeInputs<'_, R>,
        rate_bar: &[C],
        cotangents: Cotangents<'_, C>,
    );

    /// See [`Ode::velocity`].
    fn velocity_of(&self, i: usize) -> Option<usize>;
}

impl<H: ForcedOde, E: Effect<H::Model>> Ode for Forced<H, E> {
    fn state_dim(&self) -> usize {
        self.system.state_dim()
    }

    fn control_dim(&self) -> usize {
        self.system.control_dim()
    }

    fn param_dim(&self) -> usize {
        System::param_dim(self)
    }

    fn varied(&self, params: usize) -> Vec<Varied> {
        System::varied(self, params)
    }

    #[inline(always)]
    fn rate<T: Scalar>(&self, inputs: OdeInputs<'_, T>, rate: &mut [T]) {
        self.system.forced_rate(&self.effects, inputs, rate);
    }

    #[inline(always)]
    fn rate_vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: OdeInputs<'_, R>,
        rate_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        if cotangents.p.is_some() && !System::varied(self, inputs.p.len()).is_empty() {
            rate_param_vjp(self, inputs, rate_bar, cotangents.p.take());
        }
        self.system.forced_rate_vjp(&self.effects, inputs, rate_bar, cotangents);
    }

    #[inline(always)]
    fn velocity(&self, i: usize) -> Option<usize> {
        self.system.velocity_of(i)
    }

    fn diagnose<R: Real>(&self, inputs: OdeInputs<'_, R>) -> Option<Cause> {
        let inputs = inputs.skip_params(self.system.param_dim());
        self.effects
            .diagnose(self.system.model(), inputs, self.system.force_dim())
            .map(Cause::Effect)
    }
}

/// Vector field without effects.
impl<H: ForcedOde> Ode for H {
    fn state_dim(&self) -> usize {
        ForcedSystem::state_dim(self)
    }

    fn control_dim(&self) -> usize {
        ForcedSystem::control_dim(self)
    }

    fn param_dim(&self) -> usize {
        ForcedSystem::param_dim(self) + ForcedSystem::numbers(self).varied()
    }

    #[inline(always)]
    fn numbers(&self) -> Numbers<'_> {
        ForcedSystem::numbers(self)
    }

    #[inline(always)]
    fn rate<T: Scalar>(&self, inputs: OdeInputs<'_, T>, rate: &mut [T]) {
        self.forced_rate(&(), inputs, rate);
    }

    #[inline(always)]
    fn rate_vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: OdeInputs<'_, R>,
        rate_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        if cotangents.p.is_some() && ForcedSystem::numbers(self).varied() > 0 {
            rate_param_vjp(self, inputs, rate_bar, cotangents.p.take());
        }
        self.forced_rate_vjp(&(), inputs, rate_bar, cotangents);
    }

    #[inline(always)]
    fn velocity(&self, i: usize) -> Option<usize> {
        self.velocity_of(i)
    }
}

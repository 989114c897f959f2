//! [`Ode`]: a vector field in continuous time.
//!
//! An [`Integrator`](crate::Integrator) discretizes it into a [`System`](crate::System); see
//! [`Integrated`](crate::Integrated).

use crate::dynamics::cause::Cause;
use crate::dynamics::effect::{Effect, Forced, ForcedSystem};
use crate::dynamics::outline::outline;
use crate::numbers::forward_mode::{concat, jacobian};
use crate::numbers::kernels::Vectorized;
use crate::numbers::scalar::{Cotangent, CotangentPack, Float, Real, Scalar};
use crate::numbers::zip::zip;
use smallvec::{SmallVec, smallvec};

/// An ordinary differential equation `dx/dt = f(x, u)`, with constant control during a step.
///
/// Required: the dimensions and [`rate`](Ode::rate). [`rate_vjp`](Ode::rate_vjp) defaults to exact
/// derivatives by dual numbers. Override it with an analytic derivative for speed.
/// [`Integrated`](crate::Integrated) turns an `Ode` into a [`System`](crate::System).
///
/// ```
/// use physgrad::{Integrated, Ode, RungeKutta, Scalar, check};
///
/// /// A mass on a spring, pulled by u: x = [place in m, speed in m/s].
/// struct Spring { stiffness: f64 }
///
/// impl Ode for Spring {
///     fn state_dim(&self) -> usize { 2 }
///     fn control_dim(&self) -> usize { 1 }
///     fn rate<T: Scalar>(&self, x: &[T], u: &[T], rate: &mut [T]) {
///         rate[0] = x[1];
///         rate[1] = u[0] - x[0] * T::lift(self.stiffness);
///     }
/// }
///
/// let system = Integrated { ode: Spring { stiffness: 3.0 }, integrator: RungeKutta::RK4, dt: 0.1 };
/// check::system(&system);
/// ```
pub trait Ode: Send + Sync {
    /// Number of state components.
    fn state_dim(&self) -> usize;
    /// Number of control components.
    fn control_dim(&self) -> usize;

    /// Writes `f(x, u)`, of `state_dim` entries, into `rate`.
    fn rate<T: Scalar>(&self, x: &[T], u: &[T], rate: &mut [T]);

    /// Adds `(∂f/∂x)ᵀ rate_bar` to `x_bar`, and `(∂f/∂u)ᵀ rate_bar` to `u_bar` if given.
    #[inline(always)]
    fn rate_vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], rate_bar: &[C], x_bar: &mut [C], u_bar: Option<&mut [C]>) {
        rate_vjp_by_duals(self, x, u, rate_bar, x_bar, u_bar);
    }

    /// Index of the velocity of component `i`, or `None` if `i` is not a position.
    ///
    /// `Some(j)` requires `f_i(x, u) = x_j` exactly, as partitioned integrators
    /// ([`SemiImplicit`](crate::SemiImplicit), [`Verlet`](crate::Verlet)) assume.
    #[inline(always)]
    fn velocity(&self, _i: usize) -> Option<usize> {
        None
    }

    /// Diagnoses a non-finite rate; see [`System::diagnose`](crate::System::diagnose).
    fn diagnose<F: Float>(&self, _x: &[F], _u: &[F]) -> Option<Cause> {
        None
    }
}

/// Default [`Ode::rate_vjp`]: exact, by dual numbers through [`Ode::rate`].
#[inline]
fn rate_vjp_by_duals<O: Ode + ?Sized, R: Real, C: Cotangent<R>>(
    ode: &O,
    x: &[R],
    u: &[R],
    rate_bar: &[C],
    x_bar: &mut [C],
    mut u_bar: Option<&mut [C]>,
) {
    let n = x.len();
    let inputs = 0..if u_bar.is_some() { n + u.len() } else { n };
    let rate = |xu: &[_], rate: &mut [_]| ode.rate(&xu[..n], &xu[n..], rate);
    jacobian(&concat(x, u), inputs, n, rate, |i, column: &[R]| {
        let mut bar = C::null();
        for (&rate_bar, &slope) in zip(rate_bar.iter(), column) {
            bar += rate_bar * slope;
        }
        match &mut u_bar {
            Some(u_bar) if i >= n => u_bar[i - n] += bar,
            _ => x_bar[i] += bar,
        }
    });
}

/// Object-safe [`Ode`] for one scalar type.
///
/// Integrators take `&dyn DynOde<T>`, so they are monomorphized once per scalar type and not once
/// per vector field. Every [`Ode`] implements it.
pub trait DynOde<T> {
    /// See [`Ode::rate`].
    fn rate(&self, x: &[T], u: &[T], rate: &mut [T]);
    /// See [`Ode::velocity`].
    fn velocity(&self, i: usize) -> Option<usize>;
}

/// A [`DynOde`] with derivatives: object-safe [`Ode`] for one scalar and one cotangent type.
pub trait DynOdeVjp<R, C>: DynOde<R> {
    /// See [`Ode::rate_vjp`].
    fn rate_vjp(&self, x: &[R], u: &[R], rate_bar: &[C], x_bar: &mut [C], u_bar: Option<&mut [C]>);
    /// Writes row `i` of the Jacobian, `∂f_i/∂x`.
    fn slopes(&self, x: &[R], u: &[R], i: usize, row: &mut [R]);
}

impl<O: Ode, T: Scalar> DynOde<T> for O {
    #[inline(always)]
    fn rate(&self, x: &[T], u: &[T], rate: &mut [T]) {
        Ode::rate(self, x, u, rate);
    }

    #[inline(always)]
    fn velocity(&self, i: usize) -> Option<usize> {
        Ode::velocity(self, i)
    }
}

/// Outlined [`DynOdeVjp::slopes`].
struct Slopes<'a, O, R> {
    ode: &'a O,
    x: &'a [R],
    u: &'a [R],
    i: usize,
    row: &'a mut [R],
}

impl<O: Ode, R: Real> Vectorized for Slopes<'_, O, R> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        /// One cotangent per component; on the stack for up to 32 components.
        type Bars<R> = SmallVec<[CotangentPack<R, 1>; 32]>;
        let Self { ode, x, u, i, row } = self;
        let none = CotangentPack([R::zero()]);
        let (mut rate_bar, mut x_bar): (Bars<R>, Bars<R>) = (smallvec![none; x.len()], smallvec![none; x.len()]);
        rate_bar[i] = CotangentPack([R::one()]);
        ode.rate_vjp(x, u, &rate_bar, &mut x_bar, None);
        for (slope, CotangentPack([bar])) in zip(row.iter_mut(), x_bar) {
            *slope = bar;
        }
    }
}

impl<O: Ode, R: Real, C: Cotangent<R>> DynOdeVjp<R, C> for O {
    #[inline(always)]
    fn rate_vjp(&self, x: &[R], u: &[R], rate_bar: &[C], x_bar: &mut [C], u_bar: Option<&mut [C]>) {
        Ode::rate_vjp(self, x, u, rate_bar, x_bar, u_bar);
    }

    fn slopes(&self, x: &[R], u: &[R], i: usize, row: &mut [R]) {
        outline::<R>(Slopes { ode: self, x, u, i, row });
    }
}

/// A [`ForcedSystem`] in continuous time; with effects, it is an [`Ode`].
///
/// As for [`ForcedSystem`], `x` and `x_bar` may have more than `state_dim` components. The others
/// belong to effects.
pub trait ForcedOde: ForcedSystem {
    /// Writes the rates of the `state_dim` components under `effects`.
    fn forced_rate<E: Effect<Self::Model>, T: Scalar>(&self, effects: &E, x: &[T], u: &[T], rate: &mut [T]);

    /// Adds the cotangents of the state to `x_bar`, and those of the control to `u_bar` if given.
    ///
    /// Effects add the cotangents of the components beyond `state_dim`.
    fn forced_rate_vjp<E: Effect<Self::Model>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        x: &[R],
        u: &[R],
        rate_bar: &[C],
        x_bar: &mut [C],
        u_bar: Option<&mut [C]>,
    );

    /// See [`Ode::velocity`].
    fn velocity_of(&self, i: usize) -> Option<usize>;
}

/// State: the components of the system, then the time if an effect depends on it.
impl<H: ForcedOde, E: Effect<H::Model>> Ode for Forced<H, E> {
    fn state_dim(&self) -> usize {
        crate::dynamics::system::System::state_dim(self)
    }

    fn control_dim(&self) -> usize {
        self.system.control_dim()
    }

    #[inline(always)]
    fn rate<T: Scalar>(&self, x: &[T], u: &[T], rate: &mut [T]) {
        let n = self.system.state_dim();
        self.system.forced_rate(&self.effects, x, u, &mut rate[..n]);
        rate[n..].fill(T::one());
    }

    #[inline(always)]
    fn rate_vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], rate_bar: &[C], x_bar: &mut [C], u_bar: Option<&mut [C]>) {
        self.system.forced_rate_vjp(&self.effects, x, u, &rate_bar[..self.system.state_dim()], x_bar, u_bar);
    }

    #[inline(always)]
    fn velocity(&self, i: usize) -> Option<usize> {
        if i < self.system.state_dim() { self.system.velocity_of(i) } else { None }
    }

    fn diagnose<F: Float>(&self, x: &[F], u: &[F]) -> Option<Cause> {
        crate::dynamics::system::System::diagnose(self, x, u)
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

    #[inline(always)]
    fn rate<T: Scalar>(&self, x: &[T], u: &[T], rate: &mut [T]) {
        self.forced_rate(&(), x, u, rate);
    }

    #[inline(always)]
    fn rate_vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], rate_bar: &[C], x_bar: &mut [C], u_bar: Option<&mut [C]>) {
        self.forced_rate_vjp(&(), x, u, rate_bar, x_bar, u_bar);
    }

    #[inline(always)]
    fn velocity(&self, i: usize) -> Option<usize> {
        self.velocity_of(i)
    }
}

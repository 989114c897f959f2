//! [`Ode`]: a vector field in continuous time, which an [`Integrator`](crate::Integrator) makes a [`System`].

use crate::dynamics::apart::apart;
use crate::dynamics::cause::Cause;
use crate::dynamics::effect::{Effect, Host, With};
use crate::numbers::forward_mode::{concat, jacobian};
use crate::numbers::kernels::Vectorized;
use crate::numbers::scalar::{Columns, Cotangent, Float, Real, Scalar};
use crate::numbers::zip::zip;
use smallvec::{SmallVec, smallvec};

/// An ordinary differential equation, `dx/dt = f(x, u)`, whose control is constant during a step.
///
/// Only the sizes and [`rate`](Ode::rate) must be written; the derivative is exact by dual numbers until it is written by
/// hand for speed. [`Integrated`](crate::Integrated) makes it a [`System`](crate::System).
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

    /// Writes `dx/dt`, `state_dim` numbers.
    fn rate<T: Scalar>(&self, x: &[T], u: &[T], rate: &mut [T]);

    /// `x_bar += (∂f/∂x)ᵀ rate_bar`, and `u_bar += (∂f/∂u)ᵀ rate_bar` if it is asked for. Adds; does not overwrite.
    #[inline(always)]
    fn rate_vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], rate_bar: &[C], x_bar: &mut [C], u_bar: Option<&mut [C]>) {
        rate_vjp_by_duals(self, x, u, rate_bar, x_bar, u_bar);
    }

    /// If component `i` is a position, the component that is its velocity: `f_i(x, u) = x_velocity`, exactly. Integrators
    /// for mechanics treat the two differently.
    #[inline(always)]
    fn velocity(&self, _i: usize) -> Option<usize> {
        None
    }

    /// As [`System::cause`](crate::System::cause).
    fn cause<F: Float>(&self, _x: &[F], _u: &[F]) -> Option<Cause> {
        None
    }
}

/// [`Ode::rate_vjp`] of any vector field, exact, from `rate` alone.
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

/// A vector field on one kind of number, of which an integrator need not know which field it is: an integrator is compiled
/// once for a kind of number, and not for every field. Every [`Ode`] is one.
pub trait RateOn<T> {
    /// As [`Ode::rate`].
    fn rate(&self, x: &[T], u: &[T], rate: &mut [T]);
    /// As [`Ode::velocity`].
    fn velocity(&self, i: usize) -> Option<usize>;
}

/// A [`RateOn`] with its derivatives.
pub trait ReverseOn<R, C>: RateOn<R> {
    /// As [`Ode::rate_vjp`].
    fn rate_vjp(&self, x: &[R], u: &[R], rate_bar: &[C], x_bar: &mut [C], u_bar: Option<&mut [C]>);
    /// Writes `∂f_i/∂x`, a row of the Jacobian.
    fn slopes(&self, x: &[R], u: &[R], i: usize, row: &mut [R]);
}

impl<O: Ode, T: Scalar> RateOn<T> for O {
    #[inline(always)]
    fn rate(&self, x: &[T], u: &[T], rate: &mut [T]) {
        Ode::rate(self, x, u, rate);
    }

    #[inline(always)]
    fn velocity(&self, i: usize) -> Option<usize> {
        Ode::velocity(self, i)
    }
}

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
        /// One adjoint, on the stack if it is small.
        type Bars<R> = SmallVec<[Columns<R, 1>; 32]>;
        let Self { ode, x, u, i, row } = self;
        let none = Columns([R::zero()]);
        let (mut rate_bar, mut x_bar): (Bars<R>, Bars<R>) = (smallvec![none; x.len()], smallvec![none; x.len()]);
        rate_bar[i] = Columns([R::one()]);
        ode.rate_vjp(x, u, &rate_bar, &mut x_bar, None);
        for (slope, Columns([bar])) in zip(row.iter_mut(), x_bar) {
            *slope = bar;
        }
    }
}

impl<O: Ode, R: Real, C: Cotangent<R>> ReverseOn<R, C> for O {
    #[inline(always)]
    fn rate_vjp(&self, x: &[R], u: &[R], rate_bar: &[C], x_bar: &mut [C], u_bar: Option<&mut [C]>) {
        Ode::rate_vjp(self, x, u, rate_bar, x_bar, u_bar);
    }

    fn slopes(&self, x: &[R], u: &[R], i: usize, row: &mut [R]) {
        apart::<R>(Slopes { ode: self, x, u, i, row });
    }
}

/// A [`Host`] whose forces make a vector field: with its effects it is an [`Ode`].
///
/// As [`Host`]: what is handed to it may be longer than its own state, by what effects need.
pub trait Flowing: Host {
    /// Writes the rates of its own components under these effects.
    fn rate_with<E: Effect<Self::Body>, T: Scalar>(&self, effects: &E, x: &[T], u: &[T], rate: &mut [T]);

    /// Adds the cotangents of the state, those beyond its own components by effects, and those of the control, if asked for.
    fn rate_reverse<E: Effect<Self::Body>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        x: &[R],
        u: &[R],
        rate_bar: &[C],
        x_bar: &mut [C],
        u_bar: Option<&mut [C]>,
    );

    /// As [`Ode::velocity`].
    fn velocity_of(&self, i: usize) -> Option<usize>;
}

/// State: the host's own; then, if an effect depends on time, the time.
impl<H: Flowing, E: Effect<H::Body>> Ode for With<H, E> {
    fn state_dim(&self) -> usize {
        crate::dynamics::system::System::state_dim(self)
    }

    fn control_dim(&self) -> usize {
        self.system.control_dim()
    }

    #[inline(always)]
    fn rate<T: Scalar>(&self, x: &[T], u: &[T], rate: &mut [T]) {
        let n = self.system.state_dim();
        self.system.rate_with(&self.effects, x, u, &mut rate[..n]);
        rate[n..].fill(T::one());
    }

    #[inline(always)]
    fn rate_vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], rate_bar: &[C], x_bar: &mut [C], u_bar: Option<&mut [C]>) {
        self.system.rate_reverse(&self.effects, x, u, &rate_bar[..self.system.state_dim()], x_bar, u_bar);
    }

    #[inline(always)]
    fn velocity(&self, i: usize) -> Option<usize> {
        if i < self.system.state_dim() { self.system.velocity_of(i) } else { None }
    }

    fn cause<F: Float>(&self, x: &[F], u: &[F]) -> Option<Cause> {
        crate::dynamics::system::System::cause(self, x, u)
    }
}

/// The host alone.
impl<H: Flowing> Ode for H {
    fn state_dim(&self) -> usize {
        Host::state_dim(self)
    }

    fn control_dim(&self) -> usize {
        Host::control_dim(self)
    }

    #[inline(always)]
    fn rate<T: Scalar>(&self, x: &[T], u: &[T], rate: &mut [T]) {
        self.rate_with(&(), x, u, rate);
    }

    #[inline(always)]
    fn rate_vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], rate_bar: &[C], x_bar: &mut [C], u_bar: Option<&mut [C]>) {
        self.rate_reverse(&(), x, u, rate_bar, x_bar, u_bar);
    }

    #[inline(always)]
    fn velocity(&self, i: usize) -> Option<usize> {
        self.velocity_of(i)
    }
}

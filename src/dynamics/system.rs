//! [`System`]: one discrete time step of a physical system, and its Jacobian products.

use crate::dynamics::cause::Cause;
use crate::dynamics::outline;
use crate::numbers::forward_mode::{concat, jacobian};
use crate::numbers::kernels::Vectorized;
use crate::numbers::scalar::{Cotangent, Dual, Float, Real, Scalar};
use crate::numbers::zip::zip;
use smallvec::SmallVec;
use std::ops::Range;

/// One discrete time step of a physical system, `x' = S(x, u)`.
///
/// Implement the dimensions and [`step`](System::step). The Jacobian products default to exact
/// derivatives by dual numbers. Override them with analytic derivatives for speed;
/// [`check::system`](crate::check::system) compares both.
///
/// The default transposed products avoid the heap while `x` and `u` together have at most 16
/// components. Larger systems allocate in every call and should override them.
///
/// A system is immutable. Physical constants are `f64` fields, converted by [`Scalar::lift`].
/// Derivatives are with respect to `x` and `u` only.
///
/// # Shapes
/// `x`, `next`, `x_bar`, `next_bar`, `x_tan` and `next_tan` have
/// [`state_dim`](System::state_dim) entries. `u`, `u_bar` and `u_tan` have
/// [`control_dim`](System::control_dim).
pub trait System: Send + Sync {
    /// Number of state components.
    fn state_dim(&self) -> usize;
    /// Number of control components.
    fn control_dim(&self) -> usize;

    /// Writes the next state `S(x, u)`.
    ///
    /// Mark implementations `#[inline(always)]`: only inlined code is compiled for AVX2.
    fn step<T: Scalar>(&self, x: &[T], u: &[T], next: &mut [T]);

    /// `x_bar = (∂S/∂x)ᵀ next_bar` and `u_bar = (∂S/∂u)ᵀ next_bar`. Overwrites both.
    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C], u_bar: &mut [C]) {
        vjp_by_duals(self, x, u, next_bar, Wrt::Both, x_bar, u_bar);
    }

    /// `x_bar = (∂S/∂x)ᵀ next_bar`. Overwrites `x_bar`.
    #[inline(always)]
    fn vjp_state<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C]) {
        vjp_by_duals(self, x, u, next_bar, Wrt::State, x_bar, &mut []);
    }

    /// `u_bar = (∂S/∂u)ᵀ next_bar`, sufficient for one-step gradients. Overwrites `u_bar`.
    #[inline(always)]
    fn vjp_control<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], u_bar: &mut [C]) {
        vjp_by_duals(self, x, u, next_bar, Wrt::Control, &mut [], u_bar);
    }

    /// Diagnoses a non-finite step, or a non-finite derivative, from a finite state.
    ///
    /// Returns `None` if the cause is unknown. Used only for error messages.
    fn diagnose<F: Float>(&self, _x: &[F], _u: &[F]) -> Option<Cause> {
        None
    }

    /// `next_tan = (∂S/∂x) x_tan`.
    fn jvp_state<F: Float>(&self, x: &[F], u: &[F], x_tan: &[F], next_tan: &mut [F]) {
        jvp_by_duals(self, x, u, Some(x_tan), None, next_tan);
    }

    /// `next_tan = (∂S/∂u) u_tan`.
    fn jvp_control<F: Float>(&self, x: &[F], u: &[F], u_tan: &[F], next_tan: &mut [F]) {
        jvp_by_duals(self, x, u, None, Some(u_tan), next_tan);
    }
}

/// Inputs with respect to which a step is differentiated.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Wrt {
    State,
    Control,
    Both,
}

/// Default transposed Jacobian products: exact, by dual numbers through [`System::step`].
#[inline]
pub(crate) fn vjp_by_duals<S: System + ?Sized, R: Real, C: Cotangent<R>>(
    system: &S,
    x: &[R],
    u: &[R],
    next_bar: &[C],
    wrt: Wrt,
    x_bar: &mut [C],
    u_bar: &mut [C],
) {
    let n = x.len();
    let inputs = match wrt {
        Wrt::State => 0..n,
        Wrt::Control => n..n + u.len(),
        Wrt::Both => 0..n + u.len(),
    };
    step_jacobian(system, x, u, inputs, next_bar.len(), &mut |i, column: &[R]| {
        let mut bar = C::null();
        for (&next_bar, &slope) in zip(next_bar.iter(), column) {
            bar += next_bar * slope;
        }
        if i < n {
            x_bar[i] = bar;
        } else {
            u_bar[i - n] = bar;
        }
    });
}

/// The [`jacobian`] of a step. Outlined; monomorphized once per system and scalar type.
#[inline(never)]
fn step_jacobian<S: System + ?Sized, R: Real>(
    system: &S,
    x: &[R],
    u: &[R],
    inputs: Range<usize>,
    outputs: usize,
    visit: &mut dyn FnMut(usize, &[R]),
) {
    struct Work<'a, S: ?Sized, R> {
        system: &'a S,
        x: &'a [R],
        u: &'a [R],
        inputs: Range<usize>,
        outputs: usize,
        visit: &'a mut dyn FnMut(usize, &[R]),
    }
    impl<S: System + ?Sized, R: Real> Vectorized for Work<'_, S, R> {
        #[inline(always)]
        fn run<const FMA: bool>(self) {
            let Self { system, x, u, inputs, outputs, visit } = self;
            let step = |xu: &[_], next: &mut [_]| system.step(&xu[..x.len()], &xu[x.len()..], next);
            jacobian(&concat(x, u), inputs, outputs, step, visit);
        }
    }
    outline::outline::<R>(Work { system, x, u, inputs, outputs, visit });
}

fn jvp_by_duals<S: System + ?Sized, F: Float>(
    system: &S,
    x: &[F],
    u: &[F],
    x_tan: Option<&[F]>,
    u_tan: Option<&[F]>,
    next_tan: &mut [F],
) {
    let lift = |values: &[F], tangents: Option<&[F]>| -> SmallVec<[Dual<F, 1>; 32]> {
        let tangent = |i: usize| [tangents.map_or(F::zero(), |tangents| tangents[i])];
        values.iter().enumerate().map(|(i, &value)| Dual { value, tangents: tangent(i) }).collect()
    };
    let (x, u) = (lift(x, x_tan), lift(u, u_tan));
    let mut next = x.clone();
    outline::step(system, &x, &u, &mut next);
    for (tan, next) in zip(next_tan.iter_mut(), &next) {
        [*tan] = next.tangents;
    }
}

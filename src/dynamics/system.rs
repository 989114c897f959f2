//! [`System`]: one discrete time step of a physical system, and its Jacobian products.

use crate::dynamics::cause::Cause;
use crate::dynamics::inputs::{Cotangents, Inputs, Tangents};
use crate::dynamics::outline;
use crate::numbers::forward_mode::{Chunk, jacobian};
use crate::numbers::kernels::Vectorized;
use crate::numbers::scalar::{Cotangent, Dual, Real, Scalar};
use crate::numbers::zip::zip;
use smallvec::SmallVec;

/// One discrete time step of a physical system, `x' = S(x, u, p, t)`.
///
/// Implement the dimensions and [`step`](System::step). The Jacobian products default to exact
/// derivatives by dual numbers. Override [`vjp`](System::vjp) with an analytic derivative for
/// speed; [`check::system`](crate::check::system) compares both.
///
/// The default transposed products avoid the heap while `x`, `u` and `p` together have at most 16
/// components. Larger systems allocate in every call and should override them.
///
/// A system is immutable. Physical constants are `f64` fields.
/// Constants that differ between samples, or that are to be differentiated, are parameters.
///
/// # Shapes
/// `x` and `next` have [`state_dim`](System::state_dim) entries, `u` has
/// [`control_dim`](System::control_dim), and `p` at least [`param_dim`](System::param_dim).
/// Cotangents and tangents have the shapes of their values.
///
/// # Choice at run time
/// There is no `Box<dyn System>`, because `step` is generic. Write an enum with one variant per
/// system, which implements `System` by a `match`.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a system",
    note = "implement `physgrad::System`: `state_dim`, `control_dim` and `step`"
)]
pub trait System: Send + Sync {
    /// Number of state components.
    fn state_dim(&self) -> usize;
    /// Number of control components.
    fn control_dim(&self) -> usize;
    /// Number of parameters. Default: 0.
    fn param_dim(&self) -> usize {
        0
    }

    /// Writes the next state `S(x, u, p, t)`.
    ///
    /// Mark implementations `#[inline(always)]`: only inlined code is compiled for AVX2.
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]);

    /// Adds the Jacobian products `(∂S/∂x)ᵀ next_bar`, `(∂S/∂u)ᵀ next_bar` and
    /// `(∂S/∂p)ᵀ next_bar` to those cotangents that are requested.
    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, inputs: Inputs<'_, R>, next_bar: &[C], bars: Cotangents<'_, C>) {
        vjp_by_duals(self, inputs, next_bar, bars);
    }

    /// Writes the Jacobian product `(∂S/∂x) x_tan + (∂S/∂u) u_tan + (∂S/∂p) p_tan`.
    fn jvp<R: Real>(&self, inputs: Inputs<'_, R>, tangents: Tangents<'_, R>, next_tan: &mut [R]) {
        jvp_by_duals(self, inputs, tangents, next_tan);
    }

    /// Diagnoses a non-finite step, or a non-finite derivative, from a finite state.
    ///
    /// Returns `None` if the cause is unknown. Used only for error messages.
    fn diagnose<R: Real>(&self, _inputs: Inputs<'_, R>) -> Option<Cause> {
        None
    }
}

/// Default transposed Jacobian products: exact, by dual numbers through [`System::step`].
#[inline]
pub(crate) fn vjp_by_duals<S: System + ?Sized, R: Real, C: Cotangent<R>>(
    system: &S,
    inputs: Inputs<'_, R>,
    next_bar: &[C],
    bars: Cotangents<'_, C>,
) {
    step_jacobian(system, inputs, next_bar.len(), bars, &mut |bar: &mut C, column: &[R]| {
        let mut sum = C::null();
        for (&next_bar, &slope) in zip(next_bar.iter(), column) {
            sum += next_bar * slope;
        }
        *bar += sum;
    });
}

/// Calls `visit` with each requested cotangent and its column of the Jacobian. Outlined;
/// monomorphized once per system and scalar type.
#[inline(never)]
fn step_jacobian<S: System + ?Sized, R: Real, C>(
    system: &S,
    inputs: Inputs<'_, R>,
    outputs: usize,
    bars: Cotangents<'_, C>,
    visit: &mut dyn FnMut(&mut C, &[R]),
) {
    struct Work<'a, S: ?Sized, R, C> {
        system: &'a S,
        inputs: Inputs<'a, R>,
        outputs: usize,
        bars: Cotangents<'a, C>,
        visit: &'a mut dyn FnMut(&mut C, &[R]),
    }
    impl<S: System + ?Sized, R: Real, C> Vectorized for Work<'_, S, R, C> {
        #[inline(always)]
        fn run<const FMA: bool>(self) {
            let Self { system, inputs, outputs, bars, visit } = self;
            let t = inputs.t;
            each_column(inputs, outputs, bars, |inputs, next: &mut [_]| system.step(inputs.at(t), next), visit);
        }
    }
    outline::outline::<R>(Work { system, inputs, outputs, bars, visit });
}

/// Calls `visit` with each requested cotangent and its column of the Jacobian of `f`, by dual
/// numbers. `f` receives the inputs without their time.
#[inline(always)]
pub(crate) fn each_column<R: Real, C, Time>(
    inputs: Inputs<'_, R, Time>,
    outputs: usize,
    bars: Cotangents<'_, C>,
    f: impl Fn(Inputs<'_, Chunk<R>, ()>, &mut [Chunk<R>]),
    mut visit: impl FnMut(&mut C, &[R]),
) {
    if bars.is_empty() {
        return;
    }
    let Inputs { x, u, p, t: _ } = inputs;
    let (n, m) = (x.len(), x.len() + u.len());
    let all: SmallVec<[R; 16]> = x.iter().chain(u).chain(p).copied().collect();
    let Cotangents { x: mut x_bar, u: mut u_bar, p: mut p_bar } = bars;
    // The inputs from the first to the last requested one.
    let first = if x_bar.is_some() {
        0
    } else if u_bar.is_some() {
        n
    } else {
        m
    };
    let end = if p_bar.is_some() {
        all.len()
    } else if u_bar.is_some() {
        m
    } else {
        n
    };
    let of_all = |all: &[Chunk<R>], next: &mut [Chunk<R>]| f(Inputs { x: &all[..n], u: &all[n..m], p: &all[m..], t: () }, next);
    jacobian(&all, first..end, outputs, of_all, |i, column: &[R]| {
        let (bars, from) = if i < n {
            (&mut x_bar, 0)
        } else if i < m {
            (&mut u_bar, n)
        } else {
            (&mut p_bar, m)
        };
        if let Some(bars) = bars {
            visit(&mut bars[i - from], column);
        }
    });
}

fn jvp_by_duals<S: System + ?Sized, R: Real>(
    system: &S,
    Inputs { x, u, p, t }: Inputs<'_, R>,
    tangents: Tangents<'_, R>,
    next_tan: &mut [R],
) {
    let lift = |values: &[R], tangents: Option<&[R]>| -> SmallVec<[Dual<R, 1>; 32]> {
        let tangent = |i: usize| [tangents.map_or(R::zero(), |tangents| tangents[i])];
        values.iter().enumerate().map(|(i, &value)| Dual { value, tangents: tangent(i) }).collect()
    };
    let (x, u, p) = (lift(x, tangents.x), lift(u, tangents.u), lift(p, tangents.p));
    let mut next = x.clone();
    outline::step(system, Inputs { x: &x, u: &u, p: &p, t }, &mut next);
    for (tan, next) in zip(next_tan.iter_mut(), &next) {
        [*tan] = next.tangents;
    }
}

//! [`System`]: one discrete time step of a physical system, and its Jacobian products.

use crate::dynamics::cause::Cause;
use crate::dynamics::default_vjp::{Add, Function, default_vjp};
use crate::dynamics::inputs::{Cotangents, Inputs, Tangents};
use crate::dynamics::number::{Numbers, Varied};
use crate::dynamics::outline;
use crate::numbers::forward_mode::Chunk;
use crate::numbers::scalar::{Cotangent, Over, Real, Scalar};
use crate::numbers::zip::zip;
use smallvec::SmallVec;

/// One discrete time step of a physical system, `x' = S(x, u, p, t)`.
///
/// Implement the dimensions and [`step`](System::step). The Jacobian products default to exact
/// derivatives. Override [`vjp`](System::vjp) with an analytic derivative for speed;
/// [`check::system`](crate::check::system) compares both.
///
/// The default [`vjp`](System::vjp) uses dual numbers while `x`, `u` and `p` together have at most
/// 16 components, and reverse mode for more. Each thread keeps the heap buffers of reverse mode, so
/// later calls of equal size do not allocate.
///
/// A system is immutable. Physical constants are `f64` fields. Constants that may differ between
/// samples, or be trained, are [`Number`](crate::Number)s or parameters.
///
/// # Shapes
/// `x` and `next` have [`state_dim`](System::state_dim) entries, `u` has
/// [`control_dim`](System::control_dim), and `p` at least [`param_dim`](System::param_dim).
/// Cotangents and tangents have the shapes of their values.
///
/// # Choice at run time
/// There is no `Box<dyn System>`, because `step` is generic. [`DynTask`](crate::DynTask) holds any
/// task. An enum with one variant per system may implement `System` by a `match`.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a system",
    note = "implement `physgrad::System`: `state_dim`, `control_dim` and `step`"
)]
pub trait System: Send + Sync {
    /// Number of state components.
    fn state_dim(&self) -> usize;
    /// Number of control components.
    fn control_dim(&self) -> usize;
    /// Number of parameters. Default: the count of [`numbers`](System::numbers) that vary. A system
    /// that contains another one forwards this method together with [`varied`](System::varied).
    fn param_dim(&self) -> usize {
        self.numbers().varied()
    }
    /// Physical numbers that may vary between samples or be trained. Numbers that vary are the last
    /// entries of `p`. Default: none.
    #[inline(always)]
    fn numbers(&self) -> Numbers<'_> {
        Numbers::default()
    }
    /// Numbers that vary, with their indices in `p`, of length `params`. Default: those of
    /// [`numbers`](System::numbers), at the end of `p`.
    ///
    /// A system that contains another one forwards this method, as it forwards
    /// [`param_dim`](System::param_dim). Otherwise nothing draws the numbers of the inner system,
    /// and rollouts refuse their entries of `p`, which are NaN.
    fn varied(&self, params: usize) -> Vec<Varied> {
        let numbers = self.numbers();
        numbers.placed(params - numbers.varied())
    }

    /// Writes the next state `S(x, u, p, t)`.
    ///
    /// Mark implementations `#[inline(always)]`: only inlined code is compiled for AVX2.
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]);

    /// Adds the Jacobian products `(∂S/∂x)ᵀ next_bar`, `(∂S/∂u)ᵀ next_bar` and `(∂S/∂p)ᵀ next_bar`
    /// to those cotangents that are requested.
    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        step_vjp(self, inputs, next_bar, cotangents);
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

/// [`System::step`] as a function of state, control and parameters.
struct StepFunction<'a, S: ?Sized> {
    system: &'a S,
    t: usize,
}

impl<S: System + ?Sized, R> Function<R, 3> for StepFunction<'_, S> {
    #[inline(always)]
    fn eval<T: Over<R>>(&self, [x, u, p]: [&[T]; 3], next: &mut [T]) {
        self.system.step(Inputs { x, u, p, t: self.t }, next);
    }
}

/// Exact transposed Jacobian products through [`System::step`].
#[inline]
pub(crate) fn step_vjp<S: System + ?Sized, R: Real, C: Cotangent<R>>(
    system: &S,
    inputs: Inputs<'_, R>,
    next_bar: &[C],
    cotangents: Cotangents<'_, C>,
) {
    default_vjp(
        &StepFunction { system, t: inputs.t },
        inputs.lists(),
        next_bar,
        cotangents.lists(),
        Add::Sum,
    );
}

/// Dual numbers whose first tangents are `tangents`, or 0.
pub(in crate::dynamics) fn along<R: Real>(
    values: &[R],
    tangents: Option<&[R]>,
) -> SmallVec<[Chunk<R>; 32]> {
    let dual = |(i, &value): (usize, &R)| {
        let mut number = Chunk::constant(value);
        number.tangents[0] = tangents.map_or(R::zero(), |tangents| tangents[i]);
        number
    };
    values.iter().enumerate().map(dual).collect()
}

/// Default [`System::jvp`]: uses one tangent of the dual numbers that compute Jacobians. A step is
/// therefore compiled for no further scalar.
fn jvp_by_duals<S: System + ?Sized, R: Real>(
    system: &S,
    Inputs { x, u, p, t }: Inputs<'_, R>,
    tangents: Tangents<'_, R>,
    next_tan: &mut [R],
) {
    let (x, u, p) = (along(x, tangents.x), along(u, tangents.u), along(p, tangents.p));
    let mut next = x.clone();
    outline::step(system, Inputs { x: &x, u: &u, p: &p, t }, &mut next);
    for (tan, next) in zip(next_tan.iter_mut(), &next) {
        *tan = next.tangents[0];
    }
}

//! Optional parts of the physics, and systems to whose forces they add.
//!
//! [`Effect`] is the trait to implement for a custom effect. [`ForcedSystem`] is a system whose
//! forces effects can change, and [`Forced`] combines the two.
//!
//! The effects are part of a system's type: `()` for none, a tuple for several. Absent effects
//! compile to nothing: no branch, state, memory or operation.

mod list;
mod named;
mod tuples;
mod without;

use crate::dynamics::cause::Cause;
use crate::dynamics::system::{System, Wrt, vjp_by_duals};
use crate::numbers::forward_mode::jacobian;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, CotangentPack, Float, Real, Scalar};
use crate::numbers::zip::zip;
pub(crate) use list::{AddForces, Vjp, any_effect};
pub use named::Named;
use rand::RngExt;
use std::fmt::Debug;
pub(crate) use without::system_without_effects;

/// Optional part of the physics that adds to the forces of a system, or to its Hamiltonian.
///
/// `B` is the model that effects read: sizes, masses, lengths. The documentation of each system
/// defines its state and its forces.
///
/// Only [`add_forces`](Effect::add_forces) is required. Dual numbers provide the exact derivative
/// by default. An analytic [`vjp`](Effect::vjp) is faster.
/// [`check::system`](crate::check::system) compares the two for a system with the effect.
///
/// ```
/// use physgrad::tasks::CartPoleSystem;
/// use physgrad::{Effect, Scalar, Forced, check};
///
/// /// A spring that pulls the cart to the middle: F = -stiffness x.
/// #[derive(Clone, Debug)]
/// struct Spring { stiffness: f64 }
///
/// impl Effect<CartPoleSystem> for Spring {
///     fn add_forces<T: Scalar>(&self, _model: &CartPoleSystem, x: &[T], forces: &mut [T]) {
///         forces[0] -= x[0] * T::lift(self.stiffness);
///     }
/// }
///
/// let system = Forced { system: CartPoleSystem::default(), effects: Spring { stiffness: 3.0 } };
/// check::system(&system);
/// ```
pub trait Effect<B>: Clone + Debug + Send + Sync {
    /// Adds the forces of this effect to `forces`, at the state `x`.
    ///
    /// Mark implementations `#[inline(always)]`: inlined code is compiled for AVX2 on processors
    /// that have it.
    fn add_forces<T: Scalar>(&self, model: &B, x: &[T], forces: &mut [T]);

    /// Adds the Jacobian product: `x_bar += (∂forces/∂x)ᵀ forces_bar`. Does not overwrite `x_bar`.
    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, model: &B, x: &[R], forces_bar: &[C], x_bar: &mut [C]) {
        effect_vjp_by_duals(self, model, x, forces_bar, x_bar);
    }

    /// Returns whether the forces depend on the state. If none do, the reverse pass skips them.
    #[inline(always)]
    fn state_dependent(&self) -> bool {
        true
    }

    /// Returns the name of this effect if its forces or their derivatives are non-finite at the
    /// finite state `x`. `forces` is the number of forces of the system. The name is that of the
    /// type, or the one given by [`Named`]. Used only for error messages.
    #[doc(hidden)]
    fn diagnose<F: Float>(&self, model: &B, x: &[F], forces: usize) -> Option<&'static str> {
        let name = || std::any::type_name::<Self>().split('<').next().and_then(|path| path.rsplit("::").next());
        if is_finite(self, model, x, forces) { None } else { name() }
    }

    /// Returns the latest start time, in s, if the effect depends on time. Rollouts start at a time
    /// drawn uniformly from 0 to this value. [`Forced`] appends the time to the state as the last
    /// component.
    #[inline(always)]
    fn clock(&self) -> Option<f64> {
        None
    }
}

/// Computes the exact transposed Jacobian product of any effect from `add_forces`, by dual numbers.
#[inline]
pub(crate) fn effect_vjp_by_duals<B, E: Effect<B>, R: Real, C: Cotangent<R>>(
    effect: &E,
    model: &B,
    x: &[R],
    forces_bar: &[C],
    x_bar: &mut [C],
) {
    let add_forces = |x: &[_], forces: &mut [_]| {
        forces.fill(Scalar::zero());
        effect.add_forces(model, x, forces);
    };
    jacobian(x, 0..x.len(), forces_bar.len(), add_forces, |i, column: &[R]| {
        for (&force_bar, &slope) in zip(forces_bar.iter(), column) {
            x_bar[i] += force_bar * slope;
        }
    });
}

/// Returns whether the forces of an effect and their derivatives are finite at a state.
pub(crate) fn is_finite<B, E: Effect<B>, F: Float>(effect: &E, model: &B, x: &[F], forces: usize) -> bool {
    let (mut force, mut x_bar) = (vec![F::zero(); forces], vec![CotangentPack([F::zero()]); x.len()]);
    effect.add_forces(model, x, &mut force);
    effect.vjp(model, x, &vec![CotangentPack([F::one()]); forces], &mut x_bar);
    force.iter().chain(x_bar.iter().map(|bar| &bar.0[0])).all(|number| number.as_().is_finite())
}

/// System to whose forces effects can be added.
///
/// Required: [`forced_step`](ForcedSystem::forced_step), the model, the dimensions and the time
/// step. States may have more than [`state_dim`](ForcedSystem::state_dim) components. The others
/// belong to effects. Implementations pass the whole state to the effects.
pub trait ForcedSystem: Send + Sync {
    /// Model that effects read; often the system itself.
    type Model;

    /// Returns the model that effects read.
    fn model(&self) -> &Self::Model;
    /// Number of state components, without those of effects.
    fn state_dim(&self) -> usize;
    /// Number of control components.
    fn control_dim(&self) -> usize;
    /// Number of forces to which effects add.
    fn force_dim(&self) -> usize;
    /// Time step, s.
    fn dt(&self) -> f64;

    /// Writes the next state, `state_dim` components, under the given effects.
    fn forced_step<E: Effect<Self::Model>, T: Scalar>(&self, effects: &E, x: &[T], u: &[T], next: &mut [T]);

    /// Writes the requested cotangents. Overwrites `u_bar` and the first `state_dim` components of
    /// `x_bar`. Effects add to the remaining components of `x_bar`.
    ///
    /// Defaults to exact derivatives by dual numbers. Override it for speed.
    #[inline(always)]
    fn reverse<E: Effect<Self::Model>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        x: &[R],
        u: &[R],
        next_bar: &[C],
        x_bar: Option<&mut [C]>,
        u_bar: Option<&mut [C]>,
    ) {
        reverse_by_duals(self, effects, x, u, next_bar, x_bar, u_bar);
    }
}

/// Computes [`ForcedSystem::reverse`] exactly from `forced_step`, by dual numbers.
#[inline]
fn reverse_by_duals<H: ForcedSystem + ?Sized, E: Effect<H::Model>, R: Real, C: Cotangent<R>>(
    host: &H,
    effects: &E,
    x: &[R],
    u: &[R],
    next_bar: &[C],
    x_bar: Option<&mut [C]>,
    u_bar: Option<&mut [C]>,
) {
    let (n, steps) = (host.state_dim(), Stepping { host, effects });
    let mut none: [C; 0] = [];
    let (wrt, u_bar) = match (&x_bar, u_bar) {
        (Some(_), Some(u_bar)) => (Wrt::Both, u_bar),
        (None, Some(u_bar)) => (Wrt::Control, u_bar),
        (_, None) => (Wrt::State, &mut none[..]),
    };
    let Some(x_bar) = x_bar else { return vjp_by_duals(&steps, x, u, next_bar, wrt, &mut [], u_bar) };
    // Overwrite the components of the system; add to those of the effects.
    let mut all: smallvec::SmallVec<[C; 33]> = smallvec::smallvec![C::null(); x.len()];
    vjp_by_duals(&steps, x, u, next_bar, wrt, &mut all, u_bar);
    x_bar[..n].copy_from_slice(&all[..n]);
    for (x_bar, &more) in zip(x_bar[n..].iter_mut(), &all[n..]) {
        *x_bar += more;
    }
}

/// Forced system with its effects, for derivatives by dual numbers.
struct Stepping<'a, H: ?Sized, E> {
    host: &'a H,
    effects: &'a E,
}

impl<H: ForcedSystem + ?Sized, E: Effect<H::Model>> System for Stepping<'_, H, E> {
    fn state_dim(&self) -> usize {
        self.host.state_dim()
    }
    fn control_dim(&self) -> usize {
        self.host.control_dim()
    }
    fn step<T: Scalar>(&self, x: &[T], u: &[T], next: &mut [T]) {
        self.host.forced_step(self.effects, x, u, next);
    }
}

/// System with effects.
///
/// State: that of the system. If an effect depends on time, the time in s is appended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Forced<H, E> {
    /// System to whose forces the effects add.
    pub system: H,
    /// Effects: `()` for none, a tuple for several.
    pub effects: E,
}

impl<H: ForcedSystem, E: Effect<H::Model>> System for Forced<H, E> {
    fn state_dim(&self) -> usize {
        self.system.state_dim() + usize::from(self.effects.clock().is_some())
    }

    fn control_dim(&self) -> usize {
        self.system.control_dim()
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, x: &[T], u: &[T], next: &mut [T]) {
        let n = self.system.state_dim();
        self.system.forced_step(&self.effects, x, u, &mut next[..n]);
        if self.effects.clock().is_some() {
            next[n] = x[n] + T::lift(self.system.dt());
        }
    }

    fn diagnose<F: Float>(&self, x: &[F], _u: &[F]) -> Option<Cause> {
        self.effects.diagnose(self.system.model(), x, self.system.force_dim()).map(Cause::Effect)
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C], u_bar: &mut [C]) {
        let n = self.system.state_dim();
        x_bar[n..].copy_from_slice(&next_bar[n..]);
        self.system.reverse(&self.effects, x, u, &next_bar[..n], Some(x_bar), Some(u_bar));
    }

    #[inline(always)]
    fn vjp_state<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C]) {
        let n = self.system.state_dim();
        x_bar[n..].copy_from_slice(&next_bar[n..]);
        self.system.reverse(&self.effects, x, u, &next_bar[..n], Some(x_bar), None);
    }

    #[inline(always)]
    fn vjp_control<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], u_bar: &mut [C]) {
        let n = self.system.state_dim();
        self.system.reverse(&self.effects, x, u, &next_bar[..n], None, Some(u_bar));
    }
}

/// System around a model `B`: `B` alone, with effects, or behind an actuator.
///
/// Tasks for `B` accept any such system. The first components of the state are those of `B`.
pub trait HasModel<B>: System {
    /// Returns the model.
    fn model(&self) -> &B;
    /// Draws the initial values of the state components beyond those of the model, in place in `x`.
    fn start_extra(&self, rng: &mut Rng, x: &mut [f64]);
}

impl<H: ForcedSystem, E: Effect<H::Model>> HasModel<H::Model> for Forced<H, E> {
    #[inline(always)]
    fn model(&self) -> &H::Model {
        self.system.model()
    }

    fn start_extra(&self, rng: &mut Rng, x: &mut [f64]) {
        if let Some(span) = self.effects.clock() {
            x[self.system.state_dim()] = rng.random_range(0.0..=span);
        }
    }
}

//! [`Effect`]: an optional piece of physics, and the systems it acts in.
//!
//! What is in play is part of a system's type: `()` is nothing, a tuple is several effects. An effect that is absent is
//! absent code: no branch, no state, no stored byte, no operation.

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

/// An optional piece of physics that adds to the forces of a system, or to its Hamiltonian.
///
/// `B` is what it knows of the system: sizes, masses, lengths. The system's documentation says what its state and its
/// forces are. Only [`add_forces`](Effect::add_forces) must be written; the derivative is exact by dual numbers until it is written by
/// hand for speed, and [`check::system`](crate::check::system) of a system with the effect compares the two.
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
    /// Adds the effect's own forces to `forces`, at the state `x`.
    ///
    /// Mark it `#[inline(always)]` to have it compiled for AVX2 where there is AVX2.
    fn add_forces<T: Scalar>(&self, model: &B, x: &[T], forces: &mut [T]);

    /// `x_bar += (∂forces/∂x)ᵀ forces_bar`. Adds; does not overwrite.
    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, model: &B, x: &[R], forces_bar: &[C], x_bar: &mut [C]) {
        effect_vjp_by_duals(self, model, x, forces_bar, x_bar);
    }

    /// Whether its forces depend on the state. Where none does, the reverse pass has less to do.
    #[inline(always)]
    fn state_dependent(&self) -> bool {
        true
    }

    /// The name of the effect, if its forces or their derivatives are not finite at this finite state of a host with so many
    /// forces: that of its type, or the one it has by [`Named`]. Messages alone ask for it.
    fn diagnose<F: Float>(&self, model: &B, x: &[F], forces: usize) -> Option<&'static str> {
        let name = || std::any::type_name::<Self>().split('<').next().and_then(|path| path.rsplit("::").next());
        if is_finite(self, model, x, forces) { None } else { name() }
    }

    /// For effects that depend on time: rollouts start at a time drawn from 0 to this, in s. [`Forced`] then appends the
    /// time to the state, as its last component.
    #[inline(always)]
    fn clock(&self) -> Option<f64> {
        None
    }
}

/// The transposed Jacobian product of any effect, exact, from `add_forces` alone.
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

/// Whether the forces of an effect and their derivatives are finite at a state.
pub(crate) fn is_finite<B, E: Effect<B>, F: Float>(effect: &E, model: &B, x: &[F], forces: usize) -> bool {
    let (mut force, mut x_bar) = (vec![F::zero(); forces], vec![CotangentPack([F::zero()]); x.len()]);
    effect.add_forces(model, x, &mut force);
    effect.vjp(model, x, &vec![CotangentPack([F::one()]); forces], &mut x_bar);
    force.iter().chain(x_bar.iter().map(|bar| &bar.0[0])).all(|number| number.as_().is_finite())
}

/// A system to whose forces effects can be added.
///
/// Only [`forced_step`](ForcedSystem::forced_step) and the sizes must be written. The state handed to it may be longer than
/// [`state_dim`](ForcedSystem::state_dim), by what effects need; it goes to the effects as it is.
pub trait ForcedSystem: Send + Sync {
    /// What effects know of it; often the system itself.
    type Model;

    /// What effects know of it.
    fn model(&self) -> &Self::Model;
    /// Number of its own state components.
    fn state_dim(&self) -> usize;
    /// Number of control components.
    fn control_dim(&self) -> usize;
    /// Number of forces, to which effects add.
    fn force_dim(&self) -> usize;
    /// Time step, s.
    fn dt(&self) -> f64;

    /// Writes the next state, `state_dim` numbers, under these effects.
    fn forced_step<E: Effect<Self::Model>, T: Scalar>(&self, effects: &E, x: &[T], u: &[T], next: &mut [T]);

    /// The cotangents that are asked for. `u_bar` and the first `state_dim` of `x_bar` are overwritten; to what is in
    /// `x_bar` beyond them, effects add. Exact by duals until it is written by hand for speed.
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

/// [`ForcedSystem::reverse`] of any host, exact, from `forced_step` alone.
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
    // What is there beyond the host's own components is kept.
    let mut all: smallvec::SmallVec<[C; 33]> = smallvec::smallvec![C::null(); x.len()];
    vjp_by_duals(&steps, x, u, next_bar, wrt, &mut all, u_bar);
    x_bar[..n].copy_from_slice(&all[..n]);
    for (x_bar, &more) in zip(x_bar[n..].iter_mut(), &all[n..]) {
        *x_bar += more;
    }
}

/// A host under its effects, for its derivatives by duals.
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

/// A system with effects.
///
/// State: the system's own; then, if an effect depends on time, the time in s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Forced<H, E> {
    /// The system to whose forces the effects add.
    pub system: H,
    /// `()` for none, a tuple for several.
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

/// A system around a body `B`: the body alone, with effects, behind an actuator. Tasks are written for what is around
/// the body they are about, and look at the first components of the state, which are the body's.
pub trait HasModel<B>: System {
    /// The body.
    fn model(&self) -> &B;
    /// Draws the start of the state components that are not the body's into their places in `x`.
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

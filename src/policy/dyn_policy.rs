//! [`DynPolicy`]: any policy behind a pointer.

use super::{
    Action, AnyPolicy, InputLayer, NetworkLayer, Observed, Policy, PolicyPass, PolicyRecord, Sizes,
    Tensor, TrainedParam,
};
use crate::numbers::instances::{SCALARS, ScalarFunction, fill, scalar_pointer};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Float, Scalar};
use std::any::{Any, type_name};
use std::fmt;
use std::marker::PhantomData;
use std::ops::Range;
use std::sync::Arc;

/// Any [`Policy`], chosen at run time. Results are bitwise equal to those of the policy.
///
/// ```
/// use physgrad::policy::{Bounded, DynPolicy, Gru, Linear};
/// use physgrad::{Trainer, tasks::CartPole};
///
/// let linear = DynPolicy::new(Linear::new(4, 1));
/// for policy in [DynPolicy::new(Gru::new(4, 8, 1)), DynPolicy::new(Bounded::new(linear, [5.0]))] {
///     Trainer::new(CartPole::new(1), policy).epochs(1).run()?;
/// }
/// # Ok::<(), physgrad::TrainError>(())
/// ```
///
/// # Panics
/// [`act`](Policy::act) panics for scalars other than those of rollouts, checks, counts and
/// references. The batched passes, which rollouts call, use the derivatives of the policy itself.
#[derive(Clone)]
pub struct DynPolicy(Arc<dyn Erased>);

impl DynPolicy {
    /// Wraps a policy.
    #[inline(never)] // see `compiled.rs`
    pub fn new<P: Policy + 'static>(policy: P) -> Self {
        Self(Arc::new(policy))
    }

    /// The policy in double precision, for what does not depend on the precision.
    fn double(&self) -> &dyn AnyPolicy<f64> {
        &*self.0
    }

    /// The batched passes in the precision `F`.
    fn passes<F: Float>(&self) -> &dyn AnyPolicy<F> {
        let mut slot: Option<Passes<F>> = None;
        let _found = fill::<Passes<f32>>(&mut slot, || |policy| policy)
            || fill::<Passes<f64>>(&mut slot, || |policy| policy);
        slot.expect("a precision is f32 or f64")(&*self.0)
    }
}

impl fmt::Debug for DynPolicy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0.name())
    }
}

/// Object-safe [`Policy`].
trait Erased: AnyPolicy<f32> + AnyPolicy<f64> {
    fn name(&self) -> &'static str;
    fn as_any(&self) -> &dyn Any;
    /// Writes the pointer of [`Act`] for the scalar of `slot`.
    fn act(&self, slot: &mut dyn Any);
}

impl<P: Policy + 'static> Erased for P {
    fn name(&self) -> &'static str {
        type_name::<P>()
    }
    fn as_any(&self) -> &dyn Any {
        self
    }
    fn act(&self, slot: &mut dyn Any) {
        scalar_pointer::<Act<P>>(slot);
    }
}

/// Pointer to a conversion to one precision.
type Passes<F> = for<'a> fn(&'a (dyn Erased + 'static)) -> &'a dyn AnyPolicy<F>;
/// Pointer to [`Policy::act`]. The first argument is the policy.
type ActOf<T> = fn(&dyn Any, &[T], Observed<'_, T>, Action<'_, T>);

/// [`Policy::act`] of the policy `P`.
struct Act<P>(PhantomData<P>);

impl<P: Policy + 'static> ScalarFunction for Act<P> {
    type Pointer<T: Scalar> = ActOf<T>;

    fn pointer<T: Scalar>() -> Self::Pointer<T> {
        |policy, theta, observed, action| {
            let policy = policy.downcast_ref::<P>();
            let policy = policy.expect("the argument is the policy that wrote the pointer");
            policy.act(theta, observed, action);
        }
    }
}

impl Policy for DynPolicy {
    fn observation_dim(&self) -> usize {
        self.double().observation_dim()
    }

    fn control_dim(&self) -> usize {
        self.double().control_dim()
    }

    fn memory_dim(&self) -> usize {
        self.double().memory_dim()
    }

    fn param_count(&self) -> usize {
        self.double().param_count()
    }

    fn init(&self, rng: &mut Rng, theta: &mut [f64]) {
        self.double().init(rng, theta);
    }

    fn act<T: Scalar>(&self, theta: &[T], observed: Observed<'_, T>, action: Action<'_, T>) {
        let mut slot: Option<ActOf<T>> = None;
        self.0.act(&mut slot);
        let Some(act) = slot else {
            panic!(
                "`DynPolicy` of {}: `act` has no instance for {}. Instances: {SCALARS}. Use one of these, or the policy \
                 without `DynPolicy`",
                self.0.name(),
                type_name::<T>()
            )
        };
        act(self.0.as_any(), theta, observed, action);
    }

    fn trained_params(&self) -> &[TrainedParam] {
        self.double().trained_params()
    }

    fn tensors(&self) -> Vec<Tensor> {
        self.double().tensors()
    }

    fn network(&self) -> Option<Vec<NetworkLayer>> {
        self.double().network()
    }

    fn input_layer(&self) -> Option<InputLayer> {
        self.double().input_layer()
    }

    fn output_layer(&self) -> Option<Range<usize>> {
        self.double().output_layer()
    }

    fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        self.double().control_bounds()
    }

    fn sizes<F: Float>(&self, columns: usize) -> Sizes {
        self.passes::<F>().sizes(columns)
    }

    fn pack<F: Float>(&self, theta: &[F], packed: &mut [F]) {
        self.passes().pack(theta, packed);
    }

    fn forward<F: Float>(&self, pass: PolicyPass<F>, tape: &mut [F], u: &mut [F]) {
        self.passes().forward(pass, tape, u);
    }

    fn backward<F: Float>(
        &self,
        pass: PolicyPass<F>,
        tape: &[F],
        u_bar: &[F],
        tape_bar: &mut [F],
        x_bar: Option<&mut [F]>,
    ) {
        self.passes().backward(pass, tape, u_bar, tape_bar, x_bar);
    }

    fn param_gradient<F: Float>(
        &self,
        pass: PolicyPass<F>,
        record: PolicyRecord<F>,
        scratch: &mut [F],
        theta_bar: &mut [F],
    ) {
        self.passes().param_gradient(pass, record, scratch, theta_bar);
    }
}

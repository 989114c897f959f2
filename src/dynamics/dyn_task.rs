//! [`DynTask`] and [`DynSystem`]: any task, and its system, behind a pointer.

use crate::dynamics::cause::Cause;
use crate::dynamics::inputs::{Cotangents, Inputs, Start, Tangents};
use crate::dynamics::number::{Numbers, Varied};
use crate::dynamics::outline::outline;
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::instances::{
    COST_SCALARS, COTANGENTS, CotangentFunction, DIAGNOSED, OBSERVED_COTANGENTS, REALS,
    RealFunction, SCALARS, ScalarFunction, cotangent_pointer, diagnosis_pointer, fill,
    real_pointer, scalar_pointer, scalar_pointer_of_cost,
};
use crate::numbers::kernels::Vectorized;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Lanes, Real, Scalar};
use std::any::{Any, type_name};
use std::fmt;
use std::marker::PhantomData;
use std::sync::Arc;

/// Any [`Task`], chosen at run time. Results are bitwise equal to those of the task.
///
/// ```
/// use physgrad::tasks::CartPole;
/// use physgrad::{DynTask, Trainer, policy::Mlp};
///
/// let swing_up = CartPole::new(1);
/// for task in [DynTask::new(swing_up), DynTask::new(CartPole { horizon: 20, ..swing_up })] {
///     Trainer::new(task, Mlp::new([4, 8, 1])).epochs(1).run()?;
/// }
/// # Ok::<(), physgrad::TrainError>(())
/// ```
///
/// # Panics
/// Generic methods panic for scalars other than those of rollouts, diagnoses, checks, counts,
/// optimization and references. Default derivatives use other scalars, so a system that contains a
/// [`DynSystem`] needs a [`vjp`](System::vjp) and a [`jvp`](System::jvp) of its own.
#[derive(Clone)]
pub struct DynTask(DynSystem);

/// System of a [`DynTask`].
#[derive(Clone)]
pub struct DynSystem(Arc<dyn Erased>);

impl DynTask {
    /// Wraps a task.
    #[inline(never)] // see `compiled.rs`
    pub fn new<T: Task + 'static>(task: T) -> Self {
        Self(DynSystem(Arc::new(task)))
    }
}

impl fmt::Debug for DynTask {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0.0.name())
    }
}

/// Object-safe [`Task`]. A method with a `slot` writes a function pointer to the slot, for the
/// generic method of equal name. The type of the slot determines the scalar of the function. The
/// slot stays empty if the method has no instance for this scalar.
trait Erased: Send + Sync {
    fn name(&self) -> &'static str;
    fn as_any(&self) -> &dyn Any;
    fn state_dim(&self) -> usize;
    fn control_dim(&self) -> usize;
    /// Number of parameters of the system.
    fn system_params(&self) -> usize;
    fn numbers(&self) -> Numbers<'_>;
    fn varied(&self, params: usize) -> Vec<Varied>;
    fn horizon(&self) -> usize;
    fn param_dim(&self) -> usize;
    fn control_bounds(&self) -> Option<Vec<[f64; 2]>>;
    fn can_end(&self) -> bool;
    fn ended(&self) -> Option<usize>;
    fn observation_dim(&self) -> Option<usize>;
    fn start(&self, rng: &mut Rng, start: Start<'_>);
    fn draw_start(&self, rng: &mut Rng, start: Start<'_>);
    fn step(&self, slot: &mut dyn Any);
    fn vjp(&self, slot: &mut dyn Any);
    fn jvp(&self, slot: &mut dyn Any);
    fn diagnose(&self, slot: &mut dyn Any);
    fn observe(&self, slot: &mut dyn Any);
    fn observe_vjp(&self, slot: &mut dyn Any);
    fn running_cost(&self, slot: &mut dyn Any);
    fn running_cost_gradient(&self, slot: &mut dyn Any);
    fn terminal_cost(&self, slot: &mut dyn Any);
    fn terminal_cost_gradient(&self, slot: &mut dyn Any);
    fn margin(&self, slot: &mut dyn Any);
}

impl<T: Task + 'static> Erased for T {
    fn name(&self) -> &'static str {
        type_name::<T>()
    }
    fn as_any(&self) -> &dyn Any {
        self
    }
    fn state_dim(&self) -> usize {
        self.system().state_dim()
    }
    fn control_dim(&self) -> usize {
        self.system().control_dim()
    }
    fn system_params(&self) -> usize {
        self.system().param_dim()
    }
    fn numbers(&self) -> Numbers<'_> {
        self.system().numbers()
    }
    fn varied(&self, params: usize) -> Vec<Varied> {
        self.system().varied(params)
    }
    fn horizon(&self) -> usize {
        Task::horizon(self)
    }
    fn param_dim(&self) -> usize {
        Task::param_dim(self)
    }
    fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        Task::control_bounds(self)
    }
    fn can_end(&self) -> bool {
        Task::can_end(self)
    }
    fn ended(&self) -> Option<usize> {
        Task::ended(self)
    }
    fn observation_dim(&self) -> Option<usize> {
        Task::observation_dim(self)
    }
    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        Task::start(self, rng, start);
    }
    fn draw_start(&self, rng: &mut Rng, start: Start<'_>) {
        Task::draw_start(self, rng, start);
    }
    fn step(&self, slot: &mut dyn Any) {
        scalar_pointer::<Step<T>>(slot);
    }
    fn vjp(&self, slot: &mut dyn Any) {
        cotangent_pointer::<Vjp<T>>(slot);
    }
    fn jvp(&self, slot: &mut dyn Any) {
        let _found = fill(slot, Jvp::<T>::pointer::<f64>)
            || fill(slot, Jvp::<T>::pointer::<Lanes<f32, 8>>)
            || fill(slot, Jvp::<T>::pointer::<Lanes<f64, 8>>);
    }
    fn diagnose(&self, slot: &mut dyn Any) {
        diagnosis_pointer::<Diagnose<T>>(slot);
    }
    fn observe(&self, slot: &mut dyn Any) {
        scalar_pointer::<Observe<T>>(slot);
    }
    fn observe_vjp(&self, slot: &mut dyn Any) {
        cotangent_pointer::<ObserveVjp<T>>(slot);
        fill(slot, ObserveVjp::<T>::pointer::<f64, f64>);
    }
    fn running_cost(&self, slot: &mut dyn Any) {
        scalar_pointer_of_cost::<RunningCost<T>>(slot);
    }
    fn running_cost_gradient(&self, slot: &mut dyn Any) {
        real_pointer::<RunningCostGradient<T>>(slot);
    }
    fn terminal_cost(&self, slot: &mut dyn Any) {
        scalar_pointer_of_cost::<TerminalCost<T>>(slot);
    }
    fn terminal_cost_gradient(&self, slot: &mut dyn Any) {
        real_pointer::<TerminalCostGradient<T>>(slot);
    }
    fn margin(&self, slot: &mut dyn Any) {
        scalar_pointer::<Margin<T>>(slot);
    }
}

/// Defines an outlined generic function of a task, and the type of pointers to it. The first
/// argument of the function is the task.
macro_rules! function {
    (
        $name:ident, $pointer:ident: $family:ident [$($bounds:tt)+] [$($params:ident),+],
        |$task:ident: T $(, $argument:ident: $type:ty)+| $body:expr
    ) => {
        type $pointer<$($params),+> = for<'a> fn(&'a dyn Any $(, $type)+);

        struct $name<T>(PhantomData<T>);

        impl<T: Task + 'static> $family for $name<T> {
            type Pointer<$($bounds)+> = $pointer<$($params),+>;

            fn pointer<$($bounds)+>() -> Self::Pointer<$($params),+> {
                struct Work<'a, T, $($params),+> {
                    $task: &'a T,
                    $($argument: $type,)+
                }
                impl<T: Task, $($bounds)+> Vectorized for Work<'_, T, $($params),+> {
                    #[inline(always)]
                    fn run<const FMA: bool>(self) {
                        let Self { $task, $($argument),+ } = self;
                        $body
                    }
                }
                |task, $($argument),+| {
                    let $task = task.downcast_ref::<T>().expect("the argument is the task that wrote the pointer");
                    outline::<R>(Work { $task, $($argument),+ });
                }
            }
        }
    };
}

function!(Step, StepOf: ScalarFunction[R: Scalar][R], |task: T, inputs: Inputs<'a, R>, next: &'a mut [R]| {
    task.system().step(inputs, next);
});
function!(
    Vjp, VjpOf: CotangentFunction[R: Real, C: Cotangent<R>][R, C],
    |task: T, inputs: Inputs<'a, R>, next_bar: &'a [C], cotangents: Cotangents<'a, C>| {
        task.system().vjp(inputs, next_bar, cotangents);
    }
);
function!(
    Jvp, JvpOf: RealFunction[R: Real][R],
    |task: T, inputs: Inputs<'a, R>, tangents: Tangents<'a, R>, next_tan: &'a mut [R]| {
        task.system().jvp(inputs, tangents, next_tan);
    }
);
function!(Diagnose, DiagnoseOf: RealFunction[R: Real][R], |task: T, inputs: Inputs<'a, R>, cause: &'a mut Option<Cause>| {
    *cause = task.system().diagnose(inputs);
});
function!(Observe, ObserveOf: ScalarFunction[R: Scalar][R], |task: T, inputs: Inputs<'a, R>, y: &'a mut [R]| {
    task.observe(inputs, y);
});
function!(
    ObserveVjp, ObserveVjpOf: CotangentFunction[R: Real, C: Cotangent<R>][R, C],
    |task: T, inputs: Inputs<'a, R>, y_bar: &'a [C], cotangents: Cotangents<'a, C>| {
        task.observe_vjp(inputs, y_bar, cotangents);
    }
);
function!(
    RunningCost, RunningCostOf: ScalarFunction[R: Scalar][R],
    |task: T, inputs: Inputs<'a, R>, next: &'a [R], cost: &'a mut R| {
        *cost = task.running_cost(inputs, next);
    }
);
function!(
    RunningCostGradient, RunningCostGradientOf: RealFunction[R: Real][R],
    |task: T, inputs: Inputs<'a, R>, next: &'a [R], cotangents: Cotangents<'a, R>, next_bar: &'a mut [R]| {
        task.running_cost_gradient(inputs, next, cotangents, next_bar);
    }
);
function!(
    TerminalCost, TerminalCostOf: ScalarFunction[R: Scalar][R],
    |task: T, x: &'a [R], p: &'a [R], cost: &'a mut R| {
        *cost = task.terminal_cost(x, p);
    }
);
function!(
    Margin, MarginOf: ScalarFunction[R: Scalar][R],
    |task: T, x: &'a [R], p: &'a [R], margin: &'a mut R| {
        *margin = task.margin(x, p);
    }
);
function!(
    TerminalCostGradient, TerminalCostGradientOf: RealFunction[R: Real][R],
    |task: T, x: &'a [R], p: &'a [R], x_bar: &'a mut [R], p_bar: Option<&'a mut [R]>| {
        task.terminal_cost_gradient(x, p, x_bar, p_bar);
    }
);

/// Functions of a task that run in rollouts, reverse passes, optimization and identification, and
/// the steps of checks. See `compiled.rs`.
#[cfg(all(not(test), feature = "compiled"))]
pub(crate) fn frequent<T: Task + 'static>() -> Vec<*const ()> {
    use crate::numbers::scalar::CotangentPack;

    fn of_scalar<T: Task + 'static, R: Real>() -> [*const (); 7] {
        [
            Step::<T>::pointer::<R>() as *const (),
            Jvp::<T>::pointer::<R>() as *const (),
            Observe::<T>::pointer::<R>() as *const (),
            RunningCost::<T>::pointer::<R>() as *const (),
            RunningCostGradient::<T>::pointer::<R>() as *const (),
            TerminalCost::<T>::pointer::<R>() as *const (),
            TerminalCostGradient::<T>::pointer::<R>() as *const (),
        ]
    }
    fn of_cotangent<T: Task + 'static, R: Real, const K: usize>() -> *const () {
        Vjp::<T>::pointer::<R, CotangentPack<R, K>>() as *const ()
    }
    fn of_lanes<T: Task + 'static, R: Real>() -> [*const (); 4] {
        [
            of_cotangent::<T, R, 1>(),
            of_cotangent::<T, R, 2>(),
            ObserveVjp::<T>::pointer::<R, CotangentPack<R, 1>>() as *const (),
            ObserveVjp::<T>::pointer::<R, CotangentPack<R, 2>>() as *const (),
        ]
    }
    [
        &of_scalar::<T, f64>()[..],
        &of_scalar::<T, Lanes<f32, 8>>(),
        &of_scalar::<T, Lanes<f64, 8>>(),
        &[of_cotangent::<T, f64, 1>(), Step::<T>::pointer::<num_dual::Dual64>() as *const ()],
        &of_lanes::<T, Lanes<f32, 8>>(),
        &of_lanes::<T, Lanes<f64, 8>>(),
    ]
    .concat()
}

/// Calls a generic function of the task in `$object`. `$scalar` is the requested type. `$set`
/// describes the available types, for the panic message.
macro_rules! call {
    ($object:expr, $method:ident: $pointer:ty [$scalar:ty] in $set:expr, $($argument:expr),+) => {{
        let mut slot: Option<$pointer> = None;
        $object.$method(&mut slot);
        let Some(pointer) = slot else { missing($object.name(), stringify!($method), type_name::<$scalar>(), $set) };
        pointer($object.as_any(), $($argument),+)
    }};
}

/// Panics: a task behind a pointer has no instance of a method for this scalar.
#[cold]
fn missing(task: &str, method: &str, scalar: &str, set: &str) -> ! {
    panic!(
        "`DynTask` of {task}: `{method}` has no instance for {scalar}, only for {set}. Use one of these, or call `{method}` of \
         the task without `DynTask`. A system around a `DynSystem` needs a `vjp` and a `jvp` of its own, because default derivatives use \
         other scalars"
    )
}

impl System for DynSystem {
    fn state_dim(&self) -> usize {
        self.0.state_dim()
    }

    fn control_dim(&self) -> usize {
        self.0.control_dim()
    }

    fn param_dim(&self) -> usize {
        self.0.system_params()
    }

    fn numbers(&self) -> Numbers<'_> {
        self.0.numbers()
    }

    fn varied(&self, params: usize) -> Vec<Varied> {
        self.0.varied(params)
    }

    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        call!(self.0, step: StepOf<T> [T] in SCALARS, inputs, next);
    }

    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        call!(self.0, vjp: VjpOf<R, C> [(R, C)] in COTANGENTS, inputs, next_bar, cotangents);
    }

    fn jvp<R: Real>(&self, inputs: Inputs<'_, R>, tangents: Tangents<'_, R>, next_tan: &mut [R]) {
        call!(self.0, jvp: JvpOf<R> [R] in "`f64` and `Lanes<F, 8>`", inputs, tangents, next_tan);
    }

    fn diagnose<R: Real>(&self, inputs: Inputs<'_, R>) -> Option<Cause> {
        let mut cause = None;
        call!(self.0, diagnose: DiagnoseOf<R> [R] in DIAGNOSED, inputs, &mut cause);
        cause
    }
}

impl Task for DynTask {
    type System = DynSystem;

    fn system(&self) -> &DynSystem {
        &self.0
    }

    fn horizon(&self) -> usize {
        self.0.0.horizon()
    }

    fn param_dim(&self) -> usize {
        self.0.0.param_dim()
    }

    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        self.0.0.start(rng, start);
    }

    fn draw_start(&self, rng: &mut Rng, start: Start<'_>) {
        self.0.0.draw_start(rng, start);
    }

    fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        self.0.0.control_bounds()
    }

    fn can_end(&self) -> bool {
        self.0.0.can_end()
    }

    fn margin<T: Scalar>(&self, x: &[T], p: &[T]) -> T {
        let mut margin = T::zero();
        call!(self.0.0, margin: MarginOf<T> [T] in SCALARS, x, p, &mut margin);
        margin
    }

    fn ended(&self) -> Option<usize> {
        self.0.0.ended()
    }

    fn observation_dim(&self) -> Option<usize> {
        self.0.0.observation_dim()
    }

    fn observe<T: Scalar>(&self, inputs: Inputs<'_, T>, y: &mut [T]) {
        call!(self.0.0, observe: ObserveOf<T> [T] in SCALARS, inputs, y);
    }

    fn observe_vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        y_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        call!(self.0.0, observe_vjp: ObserveVjpOf<R, C> [(R, C)] in OBSERVED_COTANGENTS, inputs, y_bar, cotangents);
    }

    fn running_cost<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &[T]) -> T {
        let mut cost = T::zero();
        call!(self.0.0, running_cost: RunningCostOf<T> [T] in COST_SCALARS, inputs, next, &mut cost);
        cost
    }

    fn running_cost_gradient<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        next: &[R],
        cotangents: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        call!(self.0.0, running_cost_gradient: RunningCostGradientOf<R> [R] in REALS, inputs, next, cotangents, next_bar);
    }

    fn terminal_cost<T: Scalar>(&self, x: &[T], p: &[T]) -> T {
        let mut cost = T::zero();
        call!(self.0.0, terminal_cost: TerminalCostOf<T> [T] in COST_SCALARS, x, p, &mut cost);
        cost
    }

    fn terminal_cost_gradient<R: Real>(
        &self,
        x: &[R],
        p: &[R],
        x_bar: &mut [R],
        p_bar: Option<&mut [R]>,
    ) {
        call!(self.0.0, terminal_cost_gradient: TerminalCostGradientOf<R> [R] in REALS, x, p, x_bar, p_bar);
    }
}

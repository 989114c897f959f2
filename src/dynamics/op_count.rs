//! [`OpCount`] and [`TaskOpCount`]: operation counts of systems and tasks.

use crate::dynamics::inputs::{Cotangents, Inputs};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::scalar::{Counted, Ops};

/// Operation counts of one step of one sample, and of its VJPs with one cotangent.
///
/// Exact and independent of the machine: the step is evaluated on [`Counted`] numbers. Operations
/// on the `f64` constants of a system are not counted.
///
/// Systems do not branch on values, so the counts are independent of the state. The integrators
/// [`Adaptive`](crate::integrator::Adaptive),
/// [`ImplicitMidpoint`](crate::integrator::ImplicitMidpoint) and
/// [`Sdirk2`](crate::integrator::Sdirk2) are exceptions. Their iterations are counted at one fixed
/// state.
///
/// ```
/// use physgrad::tasks::{CartDamping, CartPoleSystem};
/// use physgrad::{Forced, count::OpCount};
///
/// let system = CartPoleSystem::default();
/// let alone = OpCount::of(&system);
/// let damped = OpCount::of(&Forced { system, effects: CartDamping::default() });
/// assert_eq!(OpCount::of(&Forced { system, effects: () }), alone);
/// assert_eq!((damped.step - alone.step).to_string(), "1 add, 1 multiply");
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OpCount {
    /// [`System::step`].
    pub step: Ops,
    /// [`System::vjp`] with respect to state and control. Evaluated by the [`Flow`](crate::Flow)s R
    /// and M, and by any two flows together.
    pub vjp: Ops,
    /// [`System::vjp`] with respect to the control alone. Evaluated by a single flow N or S.
    pub vjp_control: Ops,
}

impl OpCount {
    /// Counts the operations of `system`.
    #[inline(never)]
    pub fn of<S: System>(system: &S) -> Self {
        let (n, m) = (system.state_dim(), system.control_dim());
        let (x, u, next_bar) = (numbers(n), numbers(m), numbers(n));
        let p = numbers(system.param_dim());
        let inputs = Inputs { x: &x, u: &u, p: &p, t: 0 };
        let (mut next, mut x_bar, mut u_bar) = (numbers(n), numbers(n), numbers(m));
        let vjp = |cotangents: Cotangents<'_, Counted>| {
            Ops::of(|| system.vjp(inputs, &next_bar, cotangents)).0
        };
        Self {
            step: Ops::of(|| system.step(inputs, &mut next)).0,
            vjp: vjp(Cotangents::of(&mut x_bar, &mut u_bar)),
            vjp_control: vjp(Cotangents { u: Some(&mut u_bar), ..Cotangents::default() }),
        }
    }
}

/// Operation counts of the system, the costs and the observation of one sample, and of their
/// derivatives. Costs and observation are differentiated with respect to all inputs.
///
/// Counting is exact, as in [`OpCount`].
///
/// ```
/// use physgrad::count::TaskOpCount;
/// use physgrad::tasks::CartPole;
///
/// let counts = TaskOpCount::of(&CartPole::new(2));
/// assert_eq!(counts.running_cost.total(), 0);
/// assert_eq!(counts.terminal_cost.to_string(), "3 add, 1 multiply, 2 transcendental");
/// assert_eq!(counts.terminal_cost_gradient.to_string(), "2 add, 2 multiply, 2 transcendental");
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TaskOpCount {
    /// [`Task::system`].
    pub system: OpCount,
    /// [`Task::running_cost`], once per step.
    pub running_cost: Ops,
    /// [`Task::running_cost_gradient`], once per step.
    pub running_cost_gradient: Ops,
    /// [`Task::terminal_cost`], once per rollout.
    pub terminal_cost: Ops,
    /// [`Task::terminal_cost_gradient`], once per rollout.
    pub terminal_cost_gradient: Ops,
    /// [`Task::observe`], once per step. Zero if the policy observes the state.
    pub observe: Ops,
    /// [`Task::observe_vjp`] with one cotangent, once per step. Zero if the policy observes the
    /// state.
    pub observe_vjp: Ops,
}

impl TaskOpCount {
    /// Counts the operations of `task`.
    #[inline(never)]
    pub fn of<T: Task>(task: &T) -> Self {
        let (n, m) = (task.system().state_dim(), task.system().control_dim());
        let (x, u, p, next) = (numbers(n), numbers(m), numbers(task.param_dim()), numbers(n));
        let inputs = Inputs { x: &x, u: &u, p: &p, t: 0 };
        let (mut x_bar, mut u_bar, mut p_bar, mut next_bar) =
            (numbers(n), numbers(m), numbers(p.len()), numbers(n));
        let mut counts = Self {
            system: OpCount::of(task.system()),
            running_cost: Ops::of(|| task.running_cost(inputs, &next)).0,
            terminal_cost: Ops::of(|| task.terminal_cost(&x, &p)).0,
            terminal_cost_gradient: Ops::of(|| {
                task.terminal_cost_gradient(&x, &p, &mut x_bar, Some(&mut p_bar))
            })
            .0,
            ..Self::default()
        };
        let cotangents =
            Cotangents { x: Some(&mut x_bar), u: Some(&mut u_bar), p: Some(&mut p_bar) };
        counts.running_cost_gradient =
            Ops::of(|| task.running_cost_gradient(inputs, &next, cotangents, &mut next_bar)).0;
        if let Some(dim) = task.observation_dim() {
            let (mut y, inputs) = (numbers(dim), Inputs { u: &[], ..inputs });
            counts.observe = Ops::of(|| task.observe(inputs, &mut y)).0;
            let cotangents = Cotangents { x: Some(&mut x_bar), u: None, p: Some(&mut p_bar) };
            counts.observe_vjp = Ops::of(|| task.observe_vjp(inputs, &y, cotangents)).0;
        }
        counts
    }
}

/// Arbitrary values of moderate size.
fn numbers(len: usize) -> Vec<Counted> {
    (0..len).map(|i| Counted(0.1 + 0.01 * i as f64)).collect()
}

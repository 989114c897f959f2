//! [`Ending`]: a task whose episodes end where its margin is negative.

use crate::dynamics::cause::Cause;
use crate::dynamics::dyn_task::DynTask;
use crate::dynamics::forward::forward;
use crate::dynamics::inputs::{Cotangents, Inputs, Start, Tangents, add};
use crate::dynamics::number::Varied;
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use smallvec::{SmallVec, smallvec};

/// Number of state components up to which steps do not allocate.
const STACK: usize = 32;

/// A task whose episodes end at the first state with a negative [`margin`](Task::margin).
///
/// From there on the state stays and the running costs are 0. The step that ends the episode adds the
/// terminal cost of the state in which it ends; an episode that does not end pays it at the horizon.
///
/// The state has one more component: 0 while the episode runs, afterwards the number of steps that it
/// lasted, counted from step 0 of the rollout. Nothing is differentiable by it: whether an episode ends
/// has no derivative, as in all methods that differentiate rollouts.
///
/// ```
/// use physgrad::{DynTask, Rollout, episode::Ending, Weights, policy::Linear, prelude::*};
///
/// /// x_{t+1} = x_t + 1, until x exceeds 2.5.
/// struct Count;
/// impl System for Count {
///     fn state_dim(&self) -> usize { 1 }
///     fn control_dim(&self) -> usize { 1 }
///     fn step<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, next: &mut [T]) { next[0] = x[0] + 1.0 }
/// }
/// impl Task for Count {
///     type System = Self;
///     fn system(&self) -> &Self { self }
///     fn horizon(&self) -> usize { 10 }
///     fn start(&self, _: &mut Rng, _: Start<'_>) {}
///     fn running_cost<T: Scalar>(&self, _: Inputs<'_, T>, _: &[T]) -> T { T::one() }
///     fn can_end(&self) -> bool { true }
///     fn margin<T: Scalar>(&self, x: &[T], _: &[T]) -> T { -x[0] + 2.5 }
/// }
///
/// let task = Ending::new(DynTask::new(Count));
/// let policy = Linear::new(1, 1);
/// let mut rollout = Rollout::<f64>::new(&task, &policy, 1);
/// rollout.start(&[0.0, 0.0]);
/// rollout.run(&task, &policy, &Weights::new(&policy, vec![0.0]))?;
/// // Three steps, each with a cost of 1; the state stays.
/// assert_eq!((rollout.cost(0), rollout.state(10, 0, 0), rollout.state(10, 0, 1)), (3.0, 3.0, 3.0));
/// # Ok::<(), physgrad::Divergence>(())
/// ```
#[derive(Clone)]
pub struct Ending {
    task: DynTask,
    /// Number of state components of the task.
    states: usize,
}

impl Ending {
    /// The task with the end of its episodes.
    ///
    /// # Panics
    /// If [`Task::can_end`] is false.
    #[track_caller]
    pub fn new(task: DynTask) -> Self {
        assert!(task.can_end(), "episodes of a task end only where `can_end` returns true");
        Self { states: task.system().state_dim(), task }
    }

    /// Inputs of the task.
    #[inline(always)]
    fn inner<'a, T: Scalar>(&self, inputs: Inputs<'a, T>) -> Inputs<'a, T> {
        inputs.with_x(&inputs.x[..self.states])
    }

    /// Cotangents of the inputs of the task.
    #[inline(always)]
    fn inner_cotangents<'a, C>(&self, cotangents: &'a mut Cotangents<'_, C>) -> Cotangents<'a, C> {
        let Cotangents { x, u, p } = cotangents.reborrow();
        Cotangents { x: x.map(|x| &mut x[..self.states]), u, p }
    }

    /// `yes` while the episode with this state runs, else `no`.
    #[inline(always)]
    fn while_running<T: Scalar>(&self, x: &[T], yes: T, no: T) -> T {
        T::select_lt(x[self.states], T::from(0.5), yes, no)
    }

    /// 1 while the episode with this state runs, else 0.
    #[inline(always)]
    fn running<T: Scalar>(&self, x: &[T]) -> T {
        self.while_running(x, T::one(), T::zero())
    }
}

impl System for Ending {
    fn state_dim(&self) -> usize {
        self.states + 1
    }

    fn control_dim(&self) -> usize {
        self.task.system().control_dim()
    }

    fn param_dim(&self) -> usize {
        self.task.system().param_dim()
    }

    fn varied(&self, params: usize) -> Vec<Varied> {
        self.task.system().varied(params)
    }

    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        let Inputs { x, p, t, .. } = inputs;
        let (next, ended) = next.split_at_mut(self.states);
        self.task.system().step(self.inner(inputs), next);
        for (next, &x_i) in next.iter_mut().zip(x) {
            *next = self.while_running(x, *next, x_i);
        }
        let steps = T::from((t + 1) as f64);
        let now = T::select_lt(self.task.margin(next, p), T::zero(), steps, T::zero());
        ended[0] = self.while_running(x, now, x[self.states]).detach();
    }

    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        let running = self.running(inputs.x);
        let n = self.states;
        let moved: SmallVec<[C; STACK]> = next_bar[..n].iter().map(|&bar| bar * running).collect();
        let lengths = [n, inputs.u.len(), inputs.p.len()];
        let mut bars: SmallVec<[C; 4 * STACK]> = smallvec![C::null(); lengths.iter().sum()];
        let (x, rest) = bars.split_at_mut(n);
        let (u, p) = rest.split_at_mut(lengths[1]);
        let Cotangents { x: x_bar, u: u_bar, p: p_bar } = self.inner_cotangents(&mut cotangents);
        let own = Cotangents {
            x: x_bar.is_some().then_some(&mut *x),
            u: u_bar.is_some().then_some(&mut *u),
            p: p_bar.is_some().then_some(&mut *p),
        };
        self.task.system().vjp(self.inner(inputs), &moved, own);
        // The derivatives of a step that is not taken may be infinite.
        bars.iter_mut().for_each(|bar| *bar = bar.along(running, R::one()));
        if let Some(x_bar) = x_bar {
            let stays = -running + 1.0;
            for ((x_bar, &bar), &own) in x_bar.iter_mut().zip(next_bar).zip(&bars[..n]) {
                *x_bar += own;
                *x_bar += bar * stays;
            }
        }
        if let Some(u_bar) = u_bar {
            add(u_bar, &bars[n..n + lengths[1]]);
        }
        if let Some(p_bar) = p_bar {
            add(p_bar, &bars[n + lengths[1]..]);
        }
    }

    fn jvp<R: Real>(&self, inputs: Inputs<'_, R>, tangents: Tangents<'_, R>, next_tan: &mut [R]) {
        let (next_tan, ended_tan) = next_tan.split_at_mut(self.states);
        let x_tan = tangents.x.map(|x| &x[..self.states]);
        self.task.system().jvp(self.inner(inputs), Tangents { x: x_tan, ..tangents }, next_tan);
        for (i, next_tan) in next_tan.iter_mut().enumerate() {
            let stays = x_tan.map_or(R::zero(), |x_tan| x_tan[i]);
            *next_tan = self.while_running(inputs.x, *next_tan, stays);
        }
        ended_tan[0] = R::zero();
    }

    fn diagnose<R: Real>(&self, inputs: Inputs<'_, R>) -> Option<Cause> {
        self.task.system().diagnose(self.inner(inputs))
    }
}

impl Task for Ending {
    type System = Self;

    fn system(&self) -> &Self {
        self
    }

    forward!(Task of task: horizon, param_dim, control_bounds);

    fn start(&self, rng: &mut Rng, Start { x, p }: Start<'_>) {
        self.task.start(rng, Start { x: &mut x[..self.states], p });
    }

    fn ended(&self) -> Option<usize> {
        Some(self.states)
    }

    fn observation_dim(&self) -> Option<usize> {
        Some(self.task.observation_dim().unwrap_or(self.states))
    }

    fn observe<T: Scalar>(&self, inputs: Inputs<'_, T>, y: &mut [T]) {
        match self.task.observation_dim() {
            None => y.copy_from_slice(&inputs.x[..self.states]),
            Some(_) => {
                self.task.observe(self.inner(inputs), y);
                // Behind the end, an observation may be no number.
                for y in y {
                    let size = y.detach().abs();
                    let finite = T::select_lt(size, T::from(f64::INFINITY), y.detach(), T::zero());
                    *y = self.while_running(inputs.x, *y, finite);
                }
            }
        }
    }

    fn observe_vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        y_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        let cotangents = self.inner_cotangents(&mut cotangents);
        match self.task.observation_dim() {
            None => {
                if let Some(x_bar) = cotangents.x {
                    add(x_bar, y_bar);
                }
            }
            Some(_) => {
                let (n, params) = (self.states, inputs.p.len());
                let mut own: SmallVec<[C; 2 * STACK]> = smallvec![C::null(); n + params];
                let (x, p) = own.split_at_mut(n);
                let Cotangents { x: x_bar, p: p_bar, .. } = cotangents;
                let of_params = p_bar.is_some().then_some(p);
                let bars = Cotangents { x: Some(x), u: None, p: of_params };
                self.task.observe_vjp(self.inner(inputs), y_bar, bars);
                let running = self.running(inputs.x);
                own.iter_mut().for_each(|bar| *bar = bar.along(running, R::one()));
                for (out, bars) in [x_bar, p_bar].into_iter().zip([&own[..n], &own[n..]]) {
                    if let Some(out) = out {
                        add(out, bars);
                    }
                }
            }
        }
    }

    fn running_cost<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &[T]) -> T {
        let cost = self.task.running_cost(self.inner(inputs), &next[..self.states]);
        let at_end = self.task.terminal_cost(&next[..self.states], inputs.p);
        let ends = self.while_running(next, T::zero(), at_end);
        self.while_running(inputs.x, cost + ends, T::zero())
    }

    fn running_cost_gradient<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        next: &[R],
        mut cotangents: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        let (n, m, params) = (self.states, inputs.u.len(), inputs.p.len());
        let mut bars: SmallVec<[R; 4 * STACK]> = smallvec![R::null(); 2 * n + m + params];
        let (x, rest) = bars.split_at_mut(n);
        let (after, rest) = rest.split_at_mut(n);
        let (u, p) = rest.split_at_mut(m);
        let running = self.running(inputs.x);
        let ends = running * (-self.running(next) + 1.0);
        // The terminal cost of a step that ends the episode, then the running cost.
        self.task.terminal_cost_gradient(&next[..n], inputs.p, after, Some(&mut *p));
        after.iter_mut().chain(&mut *p).for_each(|bar| *bar = bar.along(ends, R::one()));
        let mut own: SmallVec<[R; 4 * STACK]> = smallvec![R::null(); 2 * n + m + params];
        let (own_x, rest) = own.split_at_mut(n);
        let (own_next, rest) = rest.split_at_mut(n);
        let (own_u, own_p) = rest.split_at_mut(m);
        let of_cost = Cotangents {
            x: Some(&mut *own_x),
            u: Some(&mut *own_u),
            p: (!own_p.is_empty()).then_some(&mut *own_p),
        };
        self.task.running_cost_gradient(self.inner(inputs), &next[..n], of_cost, own_next);
        for (bar, &own) in
            [(&mut *x, &*own_x), (&mut *after, &*own_next), (&mut *u, &*own_u), (&mut *p, &*own_p)]
                .into_iter()
                .flat_map(|(bars, own)| bars.iter_mut().zip(own))
        {
            *bar += own.along(running, R::one());
        }
        let Cotangents { x: x_bar, u: u_bar, p: p_bar } = self.inner_cotangents(&mut cotangents);
        for (out, bars) in [x_bar, u_bar, p_bar].into_iter().zip([&*x, &*u, &*p]) {
            if let Some(out) = out {
                add(out, bars);
            }
        }
        add(&mut next_bar[..n], after);
    }

    fn terminal_cost<T: Scalar>(&self, x: &[T], p: &[T]) -> T {
        self.while_running(x, self.task.terminal_cost(&x[..self.states], p), T::zero())
    }

    fn terminal_cost_gradient<R: Real>(
        &self,
        x: &[R],
        p: &[R],
        x_bar: &mut [R],
        p_bar: Option<&mut [R]>,
    ) {
        let mut bars: SmallVec<[R; 2 * STACK]> = smallvec![R::null(); self.states + p.len()];
        let (own_x, own_p) = bars.split_at_mut(self.states);
        let of_params = (!own_p.is_empty()).then_some(&mut *own_p);
        self.task.terminal_cost_gradient(&x[..self.states], p, own_x, of_params);
        let running = self.running(x);
        own_x.iter_mut().chain(&mut *own_p).for_each(|bar| *bar = bar.along(running, R::one()));
        add(&mut x_bar[..self.states], own_x);
        if let Some(p_bar) = p_bar {
            add(p_bar, own_p);
        }
    }
}

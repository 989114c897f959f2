//! [`Window`]: a part of an episode as a task, with the value of its last state.

use super::episodes::Windows;
use crate::dynamics::cause::Cause;
use crate::dynamics::default_vjp::{Add, Function, default_vjp};
use crate::dynamics::dyn_task::DynTask;
use crate::dynamics::forward::forward;
use crate::dynamics::inputs::{Cotangents, Inputs, Start, Tangents, add};
use crate::dynamics::number::{Noise, Number, Varied};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, CotangentPack, Over, Real, Scalar};
use crate::policy::{Action, Mlp, Observed, Policy as _};
use smallvec::{SmallVec, smallvec};

/// Number of controls up to which steps do not allocate.
const STACK: usize = 8;

/// `steps` steps of a task from step `origin` on, with noise on the controls. Costs of step t of the
/// window have the factor γ^t. The terminal cost is the value of the last state, if there is a value
/// function, and otherwise that of the task where the window ends at its horizon.
///
/// The numbers of the noise follow the parameters of the task.
#[derive(Clone, Debug)]
pub(crate) struct Window {
    task: DynTask,
    steps: usize,
    pub(super) origin: usize,
    discount: f64,
    /// Standard deviation of the noise on each control. Empty for none.
    noise: Vec<f64>,
    /// Bounds of each control, which the noise keeps. Empty for none.
    bounds: Vec<[f64; 2]>,
    /// Number of parameters of the task.
    params: usize,
    pub(super) value: Option<Value>,
}

/// A value function: a network of the observation, in units of mean and deviation.
#[derive(Clone, Debug)]
pub(super) struct Value {
    pub(super) network: Mlp,
    pub(super) theta: Vec<f64>,
    /// Mean and standard deviation of the values, which the network gives in these units.
    pub(super) units: [f64; 2],
}

impl Value {
    /// The value of an observation.
    fn of<T: Scalar>(&self, y: &[T]) -> T {
        let theta: Vec<T> = self.theta.iter().map(|&theta| T::from(theta)).collect();
        let mut value = [T::zero()];
        let observed = Observed { y, memory: &[], t: 0 };
        self.network.act(&theta, observed, Action { u: &mut value, memory: &mut [] });
        let [mean, deviation] = self.units;
        value[0] * deviation + mean
    }
}

impl<R> Function<R, 1> for Value {
    #[inline(always)]
    fn eval<T: Over<R>>(&self, [y]: [&[T]; 1], value: &mut [T]) {
        value[0] = self.of(y);
    }
}

impl Window {
    /// The first `steps` steps of a task, for a policy with these bounds.
    pub(super) fn new(
        settings: &Windows,
        bounds: Option<Vec<[f64; 2]>>,
        value: Option<Value>,
    ) -> Self {
        let Windows { ref task, steps, discount, ref noise, .. } = *settings;
        let noise = if noise.iter().any(|&noise| noise > 0.0) { noise.clone() } else { Vec::new() };
        let (task, params) = (task.clone(), task.param_dim());
        let bounds = bounds.unwrap_or_default();
        Self { steps, origin: 0, discount, noise, bounds, params, value, task }
    }

    /// Factor of the costs of step t of the window.
    fn weight(&self, t: usize) -> f64 {
        self.discount.powi(t as i32)
    }

    /// Number of noise entries at the end of the parameters.
    fn noises(&self) -> usize {
        self.noise.len()
    }

    /// Calls a function with the inputs of the task: the control with its noise.
    #[inline(always)]
    fn inside<T: Scalar, O>(
        &self,
        Inputs { x, u, p, t }: Inputs<'_, T>,
        call: impl FnOnce(Inputs<'_, T>) -> O,
    ) -> O {
        let (p, noise) = p.split_at(self.params);
        let t = self.origin + t;
        if noise.is_empty() || u.is_empty() {
            return call(Inputs { x, u, p, t });
        }
        let mut u: SmallVec<[T; STACK]> =
            u.iter().zip(noise).map(|(&u, &noise)| u + noise).collect();
        for (u, &[low, high]) in u.iter_mut().zip(&self.bounds) {
            *u = u.clamp(low, high);
        }
        call(Inputs { x, u: &u, p, t })
    }

    /// Derivatives of the controls `u` of the task by those of the policy: 0 at a bound, else 1.
    fn slopes<R: Real>(&self, u: &[R]) -> impl Iterator<Item = R> {
        let slope = |(&u, &[low, high]): (&R, &[f64; 2])| {
            let below = R::select_lt(u, R::from(high), R::one(), R::zero());
            R::select_lt(R::from(low), u, below, R::zero())
        };
        u.iter().zip(&self.bounds).map(slope)
    }

    /// Calls a function with the cotangents of the inputs of the task, whose control is `bounded`, and
    /// adds that of the control to the cotangents of the noise.
    #[inline(always)]
    fn inside_bars<R: Real, C: Cotangent<R>>(
        &self,
        bounded: &[R],
        Cotangents { x, u, p }: Cotangents<'_, C>,
        call: impl FnOnce(Cotangents<'_, C>),
    ) {
        let (p, noise) = p.map(|p| p.split_at_mut(self.params)).unzip();
        if self.noise.is_empty() {
            return call(Cotangents { x, u, p });
        }
        let mut own: SmallVec<[C; STACK]> = smallvec![C::null(); self.noises()];
        call(Cotangents { x, u: Some(&mut own), p });
        for (own, slope) in own.iter_mut().zip(self.slopes(bounded)) {
            *own = own.along(slope, R::one());
        }
        for bars in [noise, u].into_iter().flatten() {
            add(bars, &own);
        }
    }

    /// The observation of the last state.
    fn last_observation<T: Scalar>(&self, x: &[T], p: &[T]) -> Vec<T> {
        let inputs = Inputs { x, u: &[], p, t: self.steps };
        let mut y = vec![T::zero(); self.observed()];
        match self.task.observation_dim() {
            None => y.copy_from_slice(x),
            Some(_) => self.inside(inputs, |inputs| self.task.observe(inputs, &mut y)),
        }
        y
    }

    /// Number of observed components.
    fn observed(&self) -> usize {
        self.task.observation_dim().unwrap_or(self.state_dim())
    }

    /// 1 while the episode with this state runs, else 0: the end of an episode has paid its cost.
    fn running<T: Scalar>(&self, x: &[T]) -> T {
        let Some(ended) = self.task.ended() else { return T::one() };
        T::select_lt(x[ended], T::from(0.5), T::one(), T::zero())
    }

    fn is_last(&self) -> bool {
        self.origin + self.steps >= self.task.horizon()
    }
}

impl System for Window {
    fn state_dim(&self) -> usize {
        self.task.system().state_dim()
    }

    fn control_dim(&self) -> usize {
        self.task.system().control_dim()
    }

    fn param_dim(&self) -> usize {
        self.params + self.noises()
    }

    fn varied(&self, _params: usize) -> Vec<Varied> {
        let mut varied = self.task.system().varied(self.params);
        let noise = |(i, &deviation): (usize, &f64)| Varied {
            index: self.params + i,
            name: format!("window.noise[{i}]"),
            number: Number::Noise(Noise { mean: 0.0, deviation, hold: 1 }),
        };
        varied.extend(self.noise.iter().enumerate().map(noise));
        varied
    }

    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        self.inside(inputs, |inputs| self.task.system().step(inputs, next));
    }

    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        self.inside(inputs, |inputs| {
            self.inside_bars(inputs.u, cotangents, |bars| {
                self.task.system().vjp(inputs, next_bar, bars);
            });
        });
    }

    fn jvp<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        Tangents { x, u, p }: Tangents<'_, R>,
        next_tan: &mut [R],
    ) {
        let (own, noise) = p.map(|p| p.split_at(self.params)).unzip();
        let noise = noise.unwrap_or_default();
        let mut tangent: SmallVec<[R; STACK]> = smallvec![R::zero(); self.control_dim()];
        for tangents in [u, Some(noise)].into_iter().flatten() {
            tangent.iter_mut().zip(tangents).for_each(|(sum, &u)| *sum += u);
        }
        self.inside(inputs, |inputs| {
            if !self.noise.is_empty() {
                tangent.iter_mut().zip(self.slopes(inputs.u)).for_each(|(u, slope)| *u *= slope);
            }
            let tangents = Tangents { x, u: Some(&tangent), p: own };
            self.task.system().jvp(inputs, tangents, next_tan);
        });
    }

    fn diagnose<R: Real>(&self, inputs: Inputs<'_, R>) -> Option<Cause> {
        self.inside(inputs, |inputs| self.task.system().diagnose(inputs))
    }
}

impl Task for Window {
    type System = Self;

    fn system(&self) -> &Self {
        self
    }

    forward!(Task of task: control_bounds, ended);

    fn horizon(&self) -> usize {
        self.steps
    }

    fn param_dim(&self) -> usize {
        System::param_dim(self)
    }

    fn start(&self, rng: &mut Rng, Start { x, p }: Start<'_>) {
        self.task.start(rng, Start { x, p: &mut p[..self.params] });
    }

    fn first_step(&self) -> usize {
        self.origin
    }

    fn observation_dim(&self) -> Option<usize> {
        self.task.observation_dim()
    }

    fn observe<T: Scalar>(&self, inputs: Inputs<'_, T>, y: &mut [T]) {
        self.inside(inputs, |inputs| self.task.observe(inputs, y));
    }

    fn observe_vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        y_bar: &[C],
        Cotangents { x, p, .. }: Cotangents<'_, C>,
    ) {
        let p = p.map(|p| &mut p[..self.params]);
        let bars = Cotangents { x, u: None, p };
        self.inside(inputs, |inputs| self.task.observe_vjp(inputs, y_bar, bars));
    }

    fn running_cost<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &[T]) -> T {
        let cost = self.inside(inputs, |inputs| self.task.running_cost(inputs, next));
        cost * self.weight(inputs.t)
    }

    fn running_cost_gradient<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        next: &[R],
        Cotangents { x, u, p }: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        let lengths = [next.len(), inputs.x.len(), inputs.u.len(), inputs.p.len()];
        let mut bars: SmallVec<[R; 16 * STACK]> = smallvec![R::null(); lengths.iter().sum()];
        let (of_next, rest) = bars.split_at_mut(lengths[0]);
        let (of_x, rest) = rest.split_at_mut(lengths[1]);
        let (of_u, of_p) = rest.split_at_mut(lengths[2]);
        let own = Cotangents {
            x: Some(&mut *of_x),
            u: Some(&mut *of_u),
            p: p.is_some().then_some(&mut *of_p),
        };
        self.inside(inputs, |inputs| {
            self.inside_bars(inputs.u, own, |own| {
                self.task.running_cost_gradient(inputs, next, own, of_next);
            });
        });
        let weight = R::from(self.weight(inputs.t));
        let all = [(Some(next_bar), &*of_next), (x, &*of_x), (u, &*of_u), (p, &*of_p)];
        for (outputs, bars) in all.into_iter().filter_map(|(outputs, bars)| Some((outputs?, bars)))
        {
            outputs.iter_mut().zip(bars).for_each(|(output, &bar)| *output += bar * weight);
        }
    }

    fn terminal_cost<T: Scalar>(&self, x: &[T], p: &[T]) -> T {
        match &self.value {
            Some(value) => {
                let value = value.of(&self.last_observation(x, p));
                value * self.running(x) * self.weight(self.steps)
            }
            None if self.is_last() => {
                self.task.terminal_cost(x, &p[..self.params]) * self.weight(self.steps)
            }
            None => T::zero(),
        }
    }

    fn terminal_cost_gradient<R: Real>(
        &self,
        x: &[R],
        p: &[R],
        x_bar: &mut [R],
        p_bar: Option<&mut [R]>,
    ) {
        let p_bar = p_bar.map(|p_bar| &mut p_bar[..self.params]);
        let weight = R::from(self.weight(self.steps));
        let mut bars = vec![CotangentPack([R::zero()]); x.len() + self.params];
        let (of_x, of_p) = bars.split_at_mut(x.len());
        match &self.value {
            None if self.is_last() => {
                let (mut own_x, mut own_p) =
                    (vec![R::zero(); x.len()], vec![R::zero(); self.params]);
                let params = (self.params > 0).then_some(&mut own_p[..]);
                self.task.terminal_cost_gradient(x, &p[..self.params], &mut own_x, params);
                let own = own_x.into_iter().chain(own_p);
                bars.iter_mut()
                    .zip(own)
                    .for_each(|(bar, own)| *bar = CotangentPack([own * weight]));
            }
            None => {}
            Some(value) => {
                let y = self.last_observation(x, p);
                let mut y_bar = vec![CotangentPack([R::zero()]); y.len()];
                let slope = [CotangentPack([self.running(x) * weight])];
                default_vjp(value, [&y], &slope, [Some(&mut y_bar)], Add::Sum);
                if self.task.observation_dim().is_none() {
                    of_x.copy_from_slice(&y_bar);
                } else {
                    let params = p_bar.is_some().then_some(of_p);
                    let cotangents = Cotangents { x: Some(of_x), u: None, p: params };
                    let inputs = Inputs { x, u: &[], p, t: self.steps };
                    self.inside(inputs, |inputs| {
                        self.task.observe_vjp(inputs, &y_bar, cotangents);
                    });
                }
            }
        }
        let outputs = x_bar.iter_mut().chain(p_bar.into_iter().flatten());
        outputs.zip(&bars).for_each(|(output, bar)| *output += bar.0[0]);
    }
}

//! [`Sensor`]: maps the observation of a task to what the policy sees. [`Sensed`] is a task with a
//! sensor.

use crate::dynamics::cause::Cause;
use crate::dynamics::dyn_task::DynTask;
use crate::dynamics::forward::forward;
use crate::dynamics::inputs::{Cotangents, Inputs, Start, Tangents};
use crate::dynamics::number::{Noise, Number, Numbers, Varied};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};
use num_dual::Dual64;
use smallvec::{SmallVec, smallvec};
use std::borrow::Cow;

/// Number of observed components up to which steps do not allocate. States of a sensor and inputs of
/// the task have a limit four times as large.
const STACK: usize = 8;
type Observed<T> = SmallVec<[T; STACK]>;

/// What a sensor does to every component of the observation, in this order: lag, bias, noise,
/// sampling, delay. The default does nothing.
///
/// The first measurement is that of the initial state, as if the system had rested there: the lag
/// begins at its value, and a delay repeats it.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensor {
    /// Time constant of a first-order lag, in units of time steps. 0 for none. The lag is exact for an
    /// observation that is linear between two steps.
    pub lag: f64,
    /// Constant error of each component. Empty for none.
    pub bias: Vec<Number>,
    /// Standard deviation of normal noise of each component, drawn for each step. Empty for none.
    pub noise: Vec<f64>,
    /// Steps between two measurements, at least 1. The sensor holds the last one.
    pub sampling: usize,
    /// Delay in steps.
    pub delay: usize,
}

impl Default for Sensor {
    fn default() -> Self {
        Self { lag: 0.0, bias: Vec::new(), noise: Vec::new(), sampling: 1, delay: 0 }
    }
}

/// A task whose policy sees its observation through a [`Sensor`]. Costs do not.
///
/// Components of the sensor follow those of the task in the state, and its numbers those of the task
/// in the parameters: biases that are not fixed, then noise.
#[derive(Clone)]
pub struct Sensed {
    task: DynTask,
    sensor: Sensor,
    /// Weight of a measurement in the lagged value of its step, and in the memory for the next step.
    /// Both are 1 without lag.
    shares: [f64; 2],
    /// Bias of every component, then noise of every component.
    numbers: Vec<(Cow<'static, str>, Number)>,
    /// Sizes of the inner task: state, observation, parameters.
    states: usize,
    observed: usize,
    params: usize,
}

/// A sensor that does not fit its task.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("has {found} numbers, but the task has {observed} observed components")]
pub struct SensorError {
    /// The list, `bias` or `noise`.
    pub list: &'static str,
    found: usize,
    observed: usize,
}

impl Sensed {
    /// The task with this sensor.
    ///
    /// # Errors
    /// Biases or noise are neither absent nor one number per observed component.
    ///
    /// # Panics
    /// If the time constant is negative, or the sampling is 0.
    pub fn new(task: DynTask, sensor: Sensor) -> Result<Self, SensorError> {
        let Sensor { lag, sampling, .. } = sensor;
        assert!(lag >= 0.0 && sampling > 0, "a lag is not negative, and a sampling at least 1");
        let states = task.system().state_dim();
        let observed = task.observation_dim().unwrap_or(states);
        for (list, found) in [("bias", sensor.bias.len()), ("noise", sensor.noise.len())] {
            if found != 0 && found != observed {
                return Err(SensorError { list, found, observed });
            }
        }
        let bias = |i: usize| sensor.bias.get(i).copied().unwrap_or(Number::Fixed(0.0));
        let noise = |i: usize| match sensor.noise.get(i) {
            Some(&deviation) if deviation > 0.0 => {
                Number::Noise(Noise { mean: 0.0, deviation, hold: 1 })
            }
            _ => Number::Fixed(0.0),
        };
        let biases = (0..observed).map(|i| (format!("sensor.bias[{i}]").into(), bias(i)));
        let noises = (0..observed).map(|i| (format!("sensor.noise[{i}]").into(), noise(i)));
        Ok(Self {
            shares: lag_shares(lag),
            numbers: biases.chain(noises).collect(),
            params: task.param_dim(),
            task,
            sensor,
            states,
            observed,
        })
    }

    /// Number of components of the sensor in the state.
    fn memory(&self) -> usize {
        let Sensor { lag, sampling, delay, .. } = self.sensor;
        self.observed * (usize::from(lag > 0.0) + usize::from(sampling > 1) + delay)
    }

    /// Inputs of the inner task.
    #[inline(always)]
    fn inner<'a, T: Scalar>(&self, inputs: Inputs<'a, T>) -> Inputs<'a, T> {
        Inputs { x: &inputs.x[..self.states], p: &inputs.p[..self.params], ..inputs }
    }

    /// Cotangents of the inputs of the inner task.
    #[inline(always)]
    fn inner_cotangents<'a, C>(&self, cotangents: &'a mut Cotangents<'_, C>) -> Cotangents<'a, C> {
        let Cotangents { x, u, p } = cotangents.reborrow();
        Cotangents { x: x.map(|x| &mut x[..self.states]), u, p: p.map(|p| &mut p[..self.params]) }
    }

    /// Splits components of the sensor into those of lag, sampling and delay.
    fn split(&self, lens: usize) -> [std::ops::Range<usize>; 3] {
        let Sensor { lag, sampling, .. } = self.sensor;
        let lagged = if lag > 0.0 { self.observed } else { 0 };
        let held = lagged + if sampling > 1 { self.observed } else { 0 };
        [0..lagged, lagged..held, held..lens]
    }

    /// Observation of the inner task.
    #[inline(always)]
    fn raw<T: Scalar>(&self, inputs: Inputs<'_, T>) -> Observed<T> {
        let mut y: Observed<T> = smallvec![T::zero(); self.observed];
        match self.task.observation_dim() {
            None => y.copy_from_slice(&inputs.x[..self.states]),
            Some(_) => self.task.observe(Inputs { u: &[], ..self.inner(inputs) }, &mut y),
        }
        y
    }

    /// Writes what the policy sees, and the next components of the sensor unless `next` is empty,
    /// for the observation `y`.
    fn forward<T: Scalar>(
        &self,
        Inputs { x, p, t, .. }: Inputs<'_, T>,
        y: &[T],
        next: &mut [T],
        out: &mut [T],
    ) {
        let memory = &x[self.states..];
        let [lagged, held, line] = self.split(memory.len());
        let mut errors: SmallVec<[T; 2 * STACK]> = smallvec![T::zero(); 2 * self.observed];
        Numbers::all(&self.numbers).write(&p[self.params..], &mut errors);
        let [share, rest] = self.shares.map(T::from);
        for (i, &y) in y.iter().enumerate() {
            let is_lagged = !lagged.is_empty() && t > 0;
            let lag = if is_lagged { memory[i] + (y - memory[i]) * share } else { y };
            let measured = lag + errors[i] + errors[self.observed + i];
            let is_held = !held.is_empty() && !t.is_multiple_of(self.sensor.sampling);
            let now = if is_held { memory[held.start + i] } else { measured };
            let late = self.sensor.delay > 0 && t > 0;
            out[i] = if late { memory[line.start + i] } else { now };
            if next.is_empty() {
                continue;
            }
            if !lagged.is_empty() {
                next[i] = lag + (y - lag) * rest;
            }
            if !held.is_empty() {
                next[held.start + i] = now;
            }
            let places = line.clone().skip(i).step_by(self.observed);
            for place in places {
                let before = place + self.observed;
                next[place] = if t > 0 && before < line.end { memory[before] } else { now };
            }
        }
    }

    /// Transpose of [`forward`](Self::forward). Adds to the cotangents of the sensor's components and
    /// of its numbers, and returns that of the observation. `next_bar` or `out_bar` may be empty.
    fn backward<R: Real, C: Cotangent<R>>(
        &self,
        t: usize,
        next_bar: &[C],
        out_bar: &[C],
        cotangents: &mut Cotangents<'_, C>,
    ) -> Observed<C> {
        let [lagged, held, line] = self.split(self.memory());
        let mut memory_bar = cotangents.x.as_deref_mut().map(|x_bar| &mut x_bar[self.states..]);
        let mut p_bar = cotangents.p.as_deref_mut().map(|p_bar| &mut p_bar[self.params..]);
        let [share, next_share] = self.shares.map(R::from);
        let [kept, next_kept] = self.shares.map(|share| R::from(1.0 - share));
        let mut add = |place: usize, bar: C| {
            if let Some(memory_bar) = &mut memory_bar {
                memory_bar[place] += bar;
            }
        };
        let mut entry = [0, 0];
        entry[1] = self.numbers[..self.observed].iter().filter(|(_, n)| !n.is_fixed()).count();
        let mut y_bar: Observed<C> = smallvec![C::null(); self.observed];
        for (i, y_bar) in y_bar.iter_mut().enumerate() {
            let mut now = C::null();
            if let Some(&out) = out_bar.get(i) {
                if self.sensor.delay > 0 && t > 0 { add(line.start + i, out) } else { now += out }
            }
            let next = |place: usize| next_bar.get(place).copied();
            for place in line.clone().skip(i).step_by(self.observed) {
                let Some(bar) = next(place) else { continue };
                let before = place + self.observed;
                if t > 0 && before < line.end { add(before, bar) } else { now += bar }
            }
            if !held.is_empty() {
                next(held.start + i).into_iter().for_each(|bar| now += bar);
            }
            let mut measured = now;
            if !held.is_empty() && !t.is_multiple_of(self.sensor.sampling) {
                add(held.start + i, now);
                measured = C::null();
            }
            for (entry, number) in entry.iter_mut().zip([i, self.observed + i]) {
                if self.numbers[number].1.is_fixed() {
                    continue;
                }
                if let Some(p_bar) = &mut p_bar {
                    p_bar[*entry] += measured;
                }
                *entry += 1;
            }
            let mut lag = measured;
            if let Some(bar) = next(i).filter(|_| !lagged.is_empty()) {
                lag += bar * next_kept;
                *y_bar += bar * next_share;
            }
            if !lagged.is_empty() && t > 0 {
                add(i, lag * kept);
                *y_bar += lag * share;
            } else {
                *y_bar += lag;
            }
        }
        y_bar
    }

    /// Adds the cotangents of the inputs of the inner task through its observation.
    #[inline(always)]
    fn raw_vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        y_bar: &[C],
        cotangents: &mut Cotangents<'_, C>,
    ) {
        let cotangents = self.inner_cotangents(cotangents);
        match self.task.observation_dim() {
            None => {
                if let Some(x_bar) = cotangents.x {
                    crate::dynamics::inputs::add(x_bar, y_bar);
                }
            }
            Some(_) => {
                let inputs = Inputs { u: &[], ..self.inner(inputs) };
                let cotangents = Cotangents { u: None, ..cotangents };
                self.task.observe_vjp(inputs, y_bar, cotangents);
            }
        }
    }
}

/// Weights of a lag with this time constant in steps. With `a = exp(-1/lag)`, the exact solution for a
/// linear observation is `f' = a f + (k - a) y + (1 - k) y'` with `k = (1 - a) lag`. The memory between
/// the steps is `(a f + (k - a) y) / k`.
fn lag_shares(lag: f64) -> [f64; 2] {
    if lag == 0.0 {
        return [1.0; 2];
    }
    let step = 1.0 / lag;
    [1.0 + (-step).exp_m1() / step, 1.0 - step / step.exp_m1()]
}

impl System for Sensed {
    fn state_dim(&self) -> usize {
        self.states + self.memory()
    }

    fn control_dim(&self) -> usize {
        self.task.system().control_dim()
    }

    fn param_dim(&self) -> usize {
        self.params + Numbers::all(&self.numbers).varied()
    }

    fn varied(&self, params: usize) -> Vec<Varied> {
        let numbers = Numbers::all(&self.numbers);
        let inner = params - numbers.varied();
        let mut varied = self.task.system().varied(inner);
        varied.extend(numbers.placed(inner));
        varied
    }

    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        let (next, memory) = next.split_at_mut(self.states);
        self.task.system().step(self.inner(inputs), next);
        if !memory.is_empty() {
            let y = self.raw(inputs);
            let mut out = y.clone();
            self.forward(inputs, &y, memory, &mut out);
        }
    }

    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        let (next_bar, memory_bar) = next_bar.split_at(self.states);
        let inner = self.inner_cotangents(&mut cotangents);
        self.task.system().vjp(self.inner(inputs), next_bar, inner);
        if !memory_bar.is_empty() {
            let y_bar = self.backward(inputs.t, memory_bar, &[], &mut cotangents);
            self.raw_vjp(inputs, &y_bar, &mut cotangents);
        }
    }

    /// Tangents of the sensor are computed in f64, one lane at a time.
    fn jvp<R: Real>(&self, inputs: Inputs<'_, R>, tangents: Tangents<'_, R>, next_tan: &mut [R]) {
        let (next_tan, memory_tan) = next_tan.split_at_mut(self.states);
        let inner = Tangents {
            x: tangents.x.map(|x| &x[..self.states]),
            u: tangents.u,
            p: tangents.p.map(|p| &p[..self.params]),
        };
        self.task.system().jvp(self.inner(inputs), inner, next_tan);
        if memory_tan.is_empty() {
            return;
        }
        let mut memory = vec![Dual64::from_re(0.0); memory_tan.len()];
        for lane in 0..R::LANES {
            let number = |value: R| value.lane(lane).to_f64();
            let dual = |(i, &value): (usize, &R), tangents: Option<&[R]>| {
                Dual64::new(number(value), tangents.map_or(0.0, |tangents| number(tangents[i])))
            };
            let along = |values: &[R], tangents: Option<&[R]>| -> Vec<Dual64> {
                values.iter().enumerate().map(|value| dual(value, tangents)).collect()
            };
            let (x, p) = (along(inputs.x, tangents.x), along(inputs.p, tangents.p));
            let inputs = Inputs { x: &x, u: &[], p: &p, t: inputs.t };
            let y = self.raw(inputs);
            let mut out = y.clone();
            self.forward(inputs, &y, &mut memory, &mut out);
            for (tan, next) in memory_tan.iter_mut().zip(&memory) {
                tan.set_lane(lane, R::Real::from_f64(next.eps));
            }
        }
    }

    fn diagnose<R: Real>(&self, inputs: Inputs<'_, R>) -> Option<Cause> {
        self.task.system().diagnose(self.inner(inputs))
    }
}

impl Task for Sensed {
    type System = Self;

    fn system(&self) -> &Self {
        self
    }

    forward!(Task of task: horizon, control_bounds, ended);

    fn param_dim(&self) -> usize {
        System::param_dim(self)
    }

    fn start(&self, rng: &mut Rng, Start { x, p }: Start<'_>) {
        self.task.start(rng, Start { x: &mut x[..self.states], p: &mut p[..self.params] });
    }

    fn observation_dim(&self) -> Option<usize> {
        Some(self.observed)
    }

    fn observe<T: Scalar>(&self, inputs: Inputs<'_, T>, y: &mut [T]) {
        self.forward(inputs, &self.raw(inputs), &mut [], y);
    }

    fn observe_vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        y_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        let y_bar = self.backward(inputs.t, &[], y_bar, &mut cotangents);
        self.raw_vjp(inputs, &y_bar, &mut cotangents);
    }

    fn running_cost<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &[T]) -> T {
        self.task.running_cost(self.inner(inputs), &next[..self.states])
    }

    fn running_cost_gradient<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        next: &[R],
        mut cotangents: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        let (next, next_bar) = (&next[..self.states], &mut next_bar[..self.states]);
        let inner = self.inner_cotangents(&mut cotangents);
        self.task.running_cost_gradient(self.inner(inputs), next, inner, next_bar);
    }

    fn terminal_cost<T: Scalar>(&self, x: &[T], p: &[T]) -> T {
        self.task.terminal_cost(&x[..self.states], &p[..self.params])
    }

    fn terminal_cost_gradient<R: Real>(
        &self,
        x: &[R],
        p: &[R],
        x_bar: &mut [R],
        p_bar: Option<&mut [R]>,
    ) {
        let p_bar = p_bar.map(|p_bar| &mut p_bar[..self.params]);
        let (x, p) = (&x[..self.states], &p[..self.params]);
        self.task.terminal_cost_gradient(x, p, &mut x_bar[..self.states], p_bar);
    }
}

//! Kinks and jumps of the step, the observation and the costs in states of rollouts.

use super::visited::{Sample, Visited};
use crate::dynamics::inputs::Inputs;
use crate::dynamics::outline::step;
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::engine::any::AnyTask;
use crate::numbers::rng::{Purpose, stream};
use crate::numbers::text::rough;
use crate::policy::{Policy, Weights};
use num_dual::Dual64;
use rand::RngExt;
use std::cell::{OnceCell, RefCell};
use std::collections::BTreeMap;
use std::fmt;

/// Largest number of segments between consecutive states that are examined.
const SEGMENTS: usize = 1000;
/// Halvings of a segment around a possible kink.
const HALVINGS: usize = 24;
/// Error of cubic interpolation, relative to the largest slope, above which a segment may contain a
/// kink.
const SUSPICIOUS: f64 = 1e-3;
/// Change of a slope, or of a value, relative to the largest slope, that counts as a kink or jump.
const SHARP: f64 = 0.01;
/// Half of the length of the segments around single states, relative to the size of the states.
const AROUND: f64 = 1e-3;

/// Argument of the step or of a cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KinkInput {
    /// Component of the state.
    State(usize),
    /// Component of the control.
    Control(usize),
    /// Component of the next state, an argument of the running cost.
    Next(usize),
}

/// A kink or a jump that [`kinks`] found.
#[derive(Clone, Debug, PartialEq)]
pub struct Kink {
    /// Function and component, for instance `step: next[1]` or `running_cost`.
    pub function: String,
    /// Argument that crosses the kink, the one with the largest change if there are several.
    pub input: KinkInput,
    /// Value of the argument at the kink.
    pub value: f64,
    /// True if the value of the function jumps, false if only its derivative does.
    pub is_jump: bool,
    /// Derivative by the argument on both sides of the kink, or values on both sides of the jump.
    pub sides: [f64; 2],
    /// Index of the first rollout in which it was found.
    pub sample: usize,
    /// Step in that rollout.
    pub step: usize,
    /// Number of segments in which it was found.
    pub found: usize,
}

impl fmt::Display for KinkInput {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::State(i) => write!(f, "state component {i}"),
            Self::Control(i) => write!(f, "control {i}"),
            Self::Next(i) => write!(f, "next state component {i}"),
        }
    }
}

impl fmt::Display for Kink {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.describe(f, &self.input.to_string())
    }
}

impl Kink {
    /// Writes the description with a name for the argument.
    ///
    /// # Errors
    /// Those of `f`.
    pub fn describe(&self, f: &mut impl fmt::Write, input: &str) -> fmt::Result {
        let Self { function, value, is_jump, sides, sample, step, found, .. } = self;
        let ([before, after], value) = (sides.map(rough), rough(*value));
        let (what, change) =
            if *is_jump { ("jumps", "its value") } else { ("has a kink", "its derivative") };
        write!(
            f,
            "{function} {what} at {input} = {value}, first in rollout {sample}, step {step} ({found} times in all): {change} \
             changes from {before} to {after}"
        )
    }
}

/// Finds kinks and jumps of the step, of the observation and of the costs at the states of rollouts
/// from `starts`, and between consecutive states. Returns each function and argument once.
///
/// `starts` concatenates the initial states of the samples, each followed by its parameters. The
/// rollouts end before a non-finite number. All gradients use the derivative on one side of a kink,
/// and omit jumps. Rollouts that only cross a kink are unaffected. Rollouts that rest on a kink, such
/// as a saturated limit or friction at rest, have gradients of one side only.
///
/// On each segment between two states, the function compares the values and derivatives in the
/// middle with those of a cubic polynomial through the ends. Where they differ, it halves the
/// segment 24 times. The derivative of a smooth function then becomes equal at both ends. Short
/// segments around single states find kinks at which a rollout rests. A smoothed kink is reported
/// if it is narrower than about 1e-6 of a segment.
/// ```
/// use physgrad::{Weights, check, policy::Constant, tasks::Bowl};
///
/// let policy = Constant::new(2, 2);
/// let weights = Weights::new(&policy, vec![0.3, 0.1]);
/// assert!(check::kinks(&Bowl::default(), &policy, &weights, &[0.0, 0.0, 0.2, -0.1]).is_empty());
/// ```
///
/// # Panics
/// If the shapes of task and policy differ, or if `starts` is empty or not a whole number of
/// samples.
#[inline(never)]
pub fn kinks<T: Task, P: Policy>(
    task: &T,
    policy: &P,
    weights: &Weights<f64>,
    starts: &[f64],
) -> Vec<Kink> {
    let visited = Visited::of(task, policy, weights, starts);
    let shape = Shape {
        n: AnyTask::<f64>::state_dim(task),
        m: AnyTask::<f64>::control_dim(task),
        observed: task.observation_dim().unwrap_or(0),
    };
    of_any(task, shape, &visited.samples)
}

/// Numbers of components.
#[derive(Clone, Copy)]
struct Shape {
    n: usize,
    m: usize,
    observed: usize,
}

impl Shape {
    /// Name of output `i` of [`Functions::eval`].
    fn function(self, i: usize) -> String {
        let Self { n, observed, .. } = self;
        match i {
            _ if i < n => format!("step: next[{i}]"),
            _ if i < n + observed => format!("observe: y[{}]", i - n),
            _ if i == n + observed => "running_cost".into(),
            _ => "terminal_cost".into(),
        }
    }

    /// Argument `k` of [`Functions::eval`].
    fn input(self, k: usize) -> KinkInput {
        let Self { n, m, .. } = self;
        match k {
            _ if k < n => KinkInput::State(k),
            _ if k < n + m => KinkInput::Control(k - n),
            _ => KinkInput::Next(k - n - m),
        }
    }
}

/// Next state, observation, running cost and terminal cost as functions of state, control and next
/// state, concatenated in `z`.
trait Functions {
    fn eval(&self, z: &[Dual64], p: &[Dual64], t: usize) -> Vec<Dual64>;
}

impl<T: Task> Functions for T {
    fn eval(&self, z: &[Dual64], p: &[Dual64], t: usize) -> Vec<Dual64> {
        let (n, m) = (self.system().state_dim(), self.system().control_dim());
        let zero = Dual64::from_re(0.0);
        let mut z = z.to_vec();
        // The functions of a running episode: its end has no derivative anyway.
        if let Some(ended) = self.ended() {
            (z[ended], z[n + m + ended]) = (zero, zero);
        }
        let (x, rest) = z.split_at(n);
        let (u, next) = rest.split_at(m);
        let inputs = Inputs { x, u, p, t };
        let mut values = vec![zero; n];
        step(self.system(), inputs, &mut values);
        self.ended().into_iter().for_each(|ended| values[ended] = zero);
        if let Some(observed) = self.observation_dim() {
            let mut y = vec![zero; observed];
            self.observe(inputs.with_u(&[]), &mut y);
            values.extend(y);
        }
        values.extend([self.running_cost(inputs, next), self.terminal_cost(x, p)]);
        values
    }
}

/// A straight line of arguments, with the parameters and the step of a rollout.
struct Segment<'a> {
    functions: &'a dyn Functions,
    from: Vec<f64>,
    to: Vec<f64>,
    p: Vec<Dual64>,
    sample: usize,
    t: usize,
    /// Outputs at the shares that were evaluated, by their bits: most outputs ask for the same ones.
    known: RefCell<BTreeMap<u64, Vec<Dual64>>>,
    /// Rounding errors of the outputs, see [`Self::rounding`].
    rounding: OnceCell<Vec<f64>>,
}

/// Share of the segment, value and slope of one output.
#[derive(Clone, Copy)]
struct Point {
    s: f64,
    value: f64,
    slope: f64,
}

impl Segment<'_> {
    /// Arguments at the share `s` of the segment.
    fn at(&self, s: f64) -> Vec<f64> {
        self.from.iter().zip(&self.to).map(|(from, to)| from + s * (to - from)).collect()
    }

    /// All outputs at `z`, with their derivatives along `tangent`.
    fn eval(&self, z: &[f64], tangent: &dyn Fn(usize) -> f64) -> Vec<Dual64> {
        let z: Vec<Dual64> =
            z.iter().enumerate().map(|(k, &z)| Dual64::new(z, tangent(k))).collect();
        self.functions.eval(&z, &self.p, self.t)
    }

    /// An output at the share `s`, with its derivative by `s`.
    fn point(&self, s: f64, output: usize) -> Point {
        let mut known = self.known.borrow_mut();
        let along = || self.eval(&self.at(s), &|k| self.to[k] - self.from[k]);
        let Dual64 { re: value, eps: slope, .. } =
            known.entry(s.to_bits()).or_insert_with(along)[output];
        Point { s, value, slope }
    }

    /// Kinks and jumps of the outputs, as output, argument and description.
    fn kinks(&self, shape: Shape, outputs: std::ops::Range<usize>) -> Vec<(usize, usize, Kink)> {
        if self.from == self.to {
            return Vec::new();
        }
        let of = |i: usize| {
            let [a, m, b] = [0.0, 0.5, 1.0].map(|s| self.point(s, i));
            // Value and slope in the middle of the cubic polynomial through both ends.
            let by_value = m.value - (0.5 * (a.value + b.value) + 0.125 * (a.slope - b.slope));
            let by_slope = m.slope - (1.5 * (b.value - a.value) - 0.25 * (a.slope + b.slope));
            let slopes = [a.slope, m.slope, b.slope, b.value - a.value];
            let largest =
                slopes.into_iter().fold(0.0, |largest: f64, slope| largest.max(slope.abs()));
            let values = 1e-12 * (a.value.abs() + b.value.abs());
            // False for NaN.
            let is_suspicious = |rounding: f64| {
                by_value.abs().max(by_slope.abs()) > SUSPICIOUS * largest + rounding
            };
            if !is_suspicious(values) {
                return None;
            }
            let rounding = values + self.rounding.get_or_init(|| self.rounding())[i];
            if is_suspicious(rounding) {
                self.locate(shape, i, [a, b], largest, rounding)
            } else {
                None
            }
        };
        outputs.filter_map(of).collect()
    }

    /// Rounding errors of the outputs by those of their arguments, times a margin. Terms that depend
    /// on them may cancel, so they may exceed the outputs themselves.
    fn rounding(&self) -> Vec<f64> {
        let at = |z: &[f64]| {
            let mut errors = Vec::new();
            for k in 0..z.len() {
                let slopes = self.eval(z, &|j| f64::from(u8::from(j == k)));
                errors.resize(slopes.len(), 0.0);
                let by_argument = slopes.iter().map(|slope| 1e-12 * (z[k] * slope.eps).abs());
                errors.iter_mut().zip(by_argument).for_each(|(error, by)| *error += by);
            }
            errors
        };
        at(&self.from).into_iter().zip(at(&self.to)).map(|(from, to)| from.max(to)).collect()
    }

    /// Halves the segment around the largest change of the slope of an output. None if the change
    /// vanishes.
    fn locate(
        &self,
        shape: Shape,
        i: usize,
        [mut a, mut b]: [Point; 2],
        largest: f64,
        rounding: f64,
    ) -> Option<(usize, usize, Kink)> {
        let jump = |a: Point, b: Point| {
            (b.value - a.value - 0.5 * (b.s - a.s) * (a.slope + b.slope)).abs()
        };
        let change = |a: Point, b: Point| (b.slope - a.slope).abs() * (b.s - a.s) + jump(a, b);
        for _ in 0..HALVINGS {
            let middle = self.point(0.5 * (a.s + b.s), i);
            if !(middle.value.is_finite() && middle.slope.is_finite()) {
                return None;
            }
            (a, b) = if change(a, middle) > change(middle, b) { (a, middle) } else { (middle, b) };
            if change(a, b) < 0.5 * SHARP * largest * (b.s - a.s) {
                return None;
            }
        }
        let largest = largest.max(a.slope.abs()).max(b.slope.abs());
        let is_jump =
            jump(a, b) > (SHARP * largest).max(1000.0 * rounding).max(10.0 * largest * (b.s - a.s));
        if !is_jump && (b.slope - a.slope).abs() <= SHARP * largest {
            return None;
        }
        let [before, after] = [a, b].map(|point| self.at(point.s));
        let length = |k: usize| (self.to[k] - self.from[k]).abs();
        let slopes = |k: usize| {
            [&before, &after].map(|z| self.eval(z, &|j| f64::from(u8::from(j == k)))[i].eps)
        };
        let weight = |&k: &usize| {
            if is_jump {
                let mut moved = before.clone();
                moved[k] = after[k];
                (self.eval(&moved, &|_| 0.0)[i].re - a.value).abs()
            } else {
                let [left, right] = slopes(k);
                (right - left).abs() * length(k)
            }
        };
        let moving = (0..before.len()).filter(|&k| length(k) > 0.0);
        let k = moving.map(|k| (weight(&k), k)).max_by(|a, b| a.0.total_cmp(&b.0))?.1;
        let kink = Kink {
            function: shape.function(i),
            input: shape.input(k),
            value: 0.5 * (before[k] + after[k]),
            is_jump,
            sides: if is_jump { [a.value, b.value] } else { slopes(k) },
            sample: self.sample,
            step: self.t,
            found: 1,
        };
        Some((i, k, kink))
    }
}

fn of_any(functions: &dyn Functions, shape: Shape, samples: &[Sample]) -> Vec<Kink> {
    let mut rng = stream(0, Purpose::Check, 5);
    let point =
        |sample: &Sample, t: usize| [&sample.x[t][..], &sample.u[t], &sample.x[t + 1]].concat();
    let steps: usize = samples.iter().map(|sample| sample.u.len()).sum();
    let stride = steps.div_ceil(SEGMENTS).max(1);
    let costs = shape.n + shape.observed;
    let mut found: Vec<(usize, usize, Kink)> = Vec::new();
    let mut search =
        |from: Vec<f64>, to: Vec<f64>, sample: usize, t: usize, outputs: std::ops::Range<usize>| {
            let p = samples[sample].p_at(t).iter().map(|&p| Dual64::from_re(p)).collect();
            let (known, rounding) = (RefCell::default(), OnceCell::new());
            let segment = Segment { functions, from, to, p, sample, t, known, rounding };
            for (output, input, kink) in segment.kinks(shape, outputs) {
                match found.iter_mut().find(|(o, i, _)| (*o, *i) == (output, input)) {
                    Some((.., known)) => known.found += 1,
                    None => found.push((output, input, kink)),
                }
            }
        };
    // Size of each argument: its root mean square, or 1 for arguments that are always 0.
    let mut sizes = vec![0.0; 2 * shape.n + shape.m];
    for (sample, t) in
        samples.iter().flat_map(|sample| (0..sample.u.len()).map(move |t| (sample, t)))
    {
        sizes.iter_mut().zip(point(sample, t)).for_each(|(size, z)| *size += z * z / steps as f64);
    }
    sizes.iter_mut().for_each(|size: &mut f64| *size = if *size > 0.0 { size.sqrt() } else { 1.0 });
    for (index, sample) in samples.iter().enumerate() {
        let last = sample.u.len().saturating_sub(1);
        for t in (0..sample.u.len()).step_by(stride) {
            let here = point(sample, t);
            search(here.clone(), point(sample, (t + stride).min(last)), index, t, 0..costs + 1);
            let mut away = |z: f64, size: f64| {
                let distance = AROUND * size * rng.random_range(0.5..1.5);
                if rng.random() { z + distance } else { z - distance }
            };
            let to: Vec<f64> = here.iter().zip(&sizes).map(|(&z, &size)| away(z, size)).collect();
            let from = here.iter().zip(&to).map(|(z, to)| 2.0 * z - to).collect();
            search(from, to, index, t, 0..costs + 1);
        }
        // Terminal costs apply to last states only: between those of two rollouts.
        let other = &samples[(index + 1) % samples.len()];
        if let (Some(from), Some(to)) = (sample.x.last(), other.x.last()) {
            let ends = |x: &[f64]| [x, &vec![0.0; shape.m], x].concat();
            search(ends(from), ends(to), index, sample.u.len(), costs + 1..costs + 2);
        }
    }
    found.into_iter().map(|(.., kink)| kink).collect()
}

//! Steps, observations and costs of many samples, and their derivatives, on row-major arrays.
//!
//! One row is one sample. All arrays of a call have equally many rows, which are contiguous. The
//! functions evaluate eight rows at a time in SIMD lanes. With the feature `parallel`, threads
//! share large arrays. The results of a row are bitwise those of a rollout of this sample, except
//! for the signs of zero cotangents.
//!
//! [`Inputs::t`](crate::Inputs) is the number of the step, equal for all rows. `p` is empty for a
//! task without parameters. Outputs are overwritten. An empty slice in place of a cotangent
//! requests nothing. Three cotangents are required: `x_bar` of [`observe_vjp`] and
//! [`terminal_cost_vjp`], and `next_bar` of [`running_cost_vjp`].
//! ```
//! use physgrad::{Inputs, initial_states, rng::Purpose, tasks::CartPole, engine::rows};
//!
//! let task = CartPole::new(1);
//! let x: Vec<f32> = initial_states(&task, 0, Purpose::Train, 100);
//! let u = vec![0.5; 100];
//! let mut next = vec![0.0; x.len()];
//! rows::step(&task, Inputs::new(&x, &u), &mut next);
//!
//! // The gradients of the sum of all next positions, with respect to states and controls.
//! let next_bar: Vec<f32> = (0..x.len()).map(|i| if i % 4 == 0 { 1.0 } else { 0.0 }).collect();
//! let (mut x_bar, mut u_bar) = (vec![0.0; x.len()], vec![0.0; 100]);
//! rows::step_vjp(&task, Inputs::new(&x, &u), &next_bar, [&mut x_bar, &mut u_bar, &mut []]);
//! ```
//!
//! # Panics
//! All functions panic if the length of an array is not that of its rows.

use crate::dynamics::inputs::{Cotangents, Inputs, Tangents};
use crate::dynamics::outline::One;
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::engine::parallel::for_each;
use crate::numbers::scalar::{CotangentPack, Float, LANES, Lane, Scalar};
use crate::numbers::zip::zip;
use smallvec::SmallVec;
use std::ops::Range;

/// Number of rows in one unit of parallel work. Calls with at most as many rows use no other thread.
// A multiple of `LANES`, large enough to outweigh waking a thread.
pub const CHUNK: usize = 512;

/// Writes the next states, `[row][state]`.
#[inline(never)]
pub fn step<F: Float, T: Task>(task: &T, inputs: Inputs<'_, F>, next: &mut [F]) {
    let rows = rows(task, &inputs);
    check("next", next, rows, task.system().state_dim());
    for_blocks(rows, [inputs.x, inputs.u, inputs.p], [next], |[x, u, p], [next]| {
        task.system().step(Inputs { x, u, p, t: inputs.t }, next);
    });
}

/// Writes the products of `next_bar` with the transposed Jacobians of the step: cotangents of
/// `[x, u, p]`.
#[inline(never)]
pub fn step_vjp<F: Float, T: Task>(
    task: &T,
    inputs: Inputs<'_, F>,
    next_bar: &[F],
    cotangents: [&mut [F]; 3],
) {
    let rows = rows(task, &inputs);
    check("next_bar", next_bar, rows, task.system().state_dim());
    check_cotangents(task, rows, &cotangents);
    for_blocks(
        rows,
        [inputs.x, inputs.u, inputs.p, next_bar],
        cotangents,
        |[x, u, p, next_bar], bars| {
            let mut packs = [pack(bars[0]), pack(bars[1]), pack(bars[2])];
            let [x_bar, u_bar, p_bar] = packs.each_mut().map(|pack| requested(pack));
            let cotangents = Cotangents { x: x_bar, u: u_bar, p: p_bar };
            task.system().vjp(Inputs { x, u, p, t: inputs.t }, &pack(next_bar), cotangents);
            for (bar, pack) in bars.into_iter().zip(&packs) {
                unpack(pack, bar);
            }
        },
    );
}

/// Writes the sum of the products of the Jacobians of the step with the tangents. `None` is a zero
/// tangent.
#[inline(never)]
pub fn step_jvp<F: Float, T: Task>(
    task: &T,
    inputs: Inputs<'_, F>,
    tangents: Tangents<'_, F>,
    next_tan: &mut [F],
) {
    let rows = rows(task, &inputs);
    let system = task.system();
    check("next_tan", next_tan, rows, system.state_dim());
    let directions = [
        (tangents.x, system.state_dim()),
        (tangents.u, system.control_dim()),
        (tangents.p, task.param_dim()),
    ];
    let [x_tan, u_tan, p_tan] = directions.map(|(tangent, dim)| {
        tangent.inspect(|tangent| check("tangent", tangent, rows, dim));
        tangent.unwrap_or(&[])
    });
    let arrays = [inputs.x, inputs.u, inputs.p, x_tan, u_tan, p_tan];
    for_blocks(rows, arrays, [next_tan], |[x, u, p, x_tan, u_tan, p_tan], [next_tan]| {
        let [x_tan, u_tan, p_tan] =
            [x_tan, u_tan, p_tan].map(|tangent| (!tangent.is_empty()).then_some(tangent));
        system.jvp(
            Inputs { x, u, p, t: inputs.t },
            Tangents { x: x_tan, u: u_tan, p: p_tan },
            next_tan,
        );
    });
}

/// Writes the observations, `[row][component]`. Ignores the controls, which may be empty.
#[inline(never)]
pub fn observe<F: Float, T: Task>(task: &T, inputs: Inputs<'_, F>, y: &mut [F]) {
    let rows = rows_without_controls(task, &inputs);
    check("y", y, rows, observed_dim(task));
    if task.observation_dim().is_none() {
        return y.copy_from_slice(inputs.x);
    }
    for_blocks(rows, [inputs.x, inputs.p], [y], |[x, p], [y]| {
        task.observe(Inputs { x, u: &[], p, t: inputs.t }, y)
    });
}

/// Writes the products of `y_bar` with the transposed Jacobians of the observation: cotangents of
/// `[x, p]`.
#[inline(never)]
pub fn observe_vjp<F: Float, T: Task>(
    task: &T,
    inputs: Inputs<'_, F>,
    y_bar: &[F],
    [x_bar, p_bar]: [&mut [F]; 2],
) {
    let rows = rows_without_controls(task, &inputs);
    check("y_bar", y_bar, rows, observed_dim(task));
    check("x_bar", x_bar, rows, task.system().state_dim());
    check_requested("p_bar", p_bar, rows, task.param_dim());
    if task.observation_dim().is_none() {
        p_bar.fill(F::zero());
        return x_bar.copy_from_slice(y_bar);
    }
    for_blocks(rows, [inputs.x, inputs.p, y_bar], [x_bar, p_bar], |[x, p, y_bar], bars| {
        let mut packs = [pack(bars[0]), pack(bars[1])];
        let [x_bar, p_bar] = packs.each_mut().map(|pack| requested(pack));
        task.observe_vjp(
            Inputs { x, u: &[], p, t: inputs.t },
            &pack(y_bar),
            Cotangents { x: x_bar, u: None, p: p_bar },
        );
        for (bar, pack) in bars.into_iter().zip(&packs) {
            unpack(pack, bar);
        }
    });
}

/// Writes to `cost` the running cost of each row, for the step that ends in `next`.
#[inline(never)]
pub fn running_cost<F: Float, T: Task>(
    task: &T,
    inputs: Inputs<'_, F>,
    next: &[F],
    cost: &mut [F],
) {
    let rows = rows(task, &inputs);
    check("next", next, rows, task.system().state_dim());
    check("cost", cost, rows, 1);
    for_blocks(rows, [inputs.x, inputs.u, inputs.p, next], [cost], |[x, u, p, next], [cost]| {
        cost[0] = task.running_cost(Inputs { x, u, p, t: inputs.t }, next);
    });
}

/// Writes the gradients of the running costs, multiplied by `cost_bar` of each row: cotangents of
/// `[x, u, next, p]`.
#[inline(never)]
pub fn running_cost_vjp<F: Float, T: Task>(
    task: &T,
    inputs: Inputs<'_, F>,
    next: &[F],
    cost_bar: &[F],
    [x_bar, u_bar, next_bar, p_bar]: [&mut [F]; 4],
) {
    let rows = rows(task, &inputs);
    let n = task.system().state_dim();
    check("next", next, rows, n);
    check("cost_bar", cost_bar, rows, 1);
    check("next_bar", next_bar, rows, n);
    check_cotangents(task, rows, &[&mut *x_bar, &mut *u_bar, &mut *p_bar]);
    let arrays = [inputs.x, inputs.u, inputs.p, next, cost_bar];
    for_blocks(
        rows,
        arrays,
        [x_bar, u_bar, next_bar, p_bar],
        |[x, u, p, next, cost_bar], [x_bar, u_bar, next_bar, p_bar]| {
            let cotangents =
                Cotangents { x: requested(x_bar), u: requested(u_bar), p: requested(p_bar) };
            task.running_cost_gradient(Inputs { x, u, p, t: inputs.t }, next, cotangents, next_bar);
            for bar in [x_bar, u_bar, next_bar, p_bar] {
                scale(bar, cost_bar[0]);
            }
        },
    );
}

/// Writes the terminal cost of each row.
#[inline(never)]
pub fn terminal_cost<F: Float, T: Task>(task: &T, x: &[F], p: &[F], cost: &mut [F]) {
    let rows = rows_without_controls(task, &Inputs { x, u: &[], p, t: 0 });
    check("cost", cost, rows, 1);
    for_blocks(rows, [x, p], [cost], |[x, p], [cost]| cost[0] = task.terminal_cost(x, p));
}

/// Writes the gradients of the terminal costs, multiplied by `cost_bar` of each row: cotangents of
/// `[x, p]`.
#[inline(never)]
pub fn terminal_cost_vjp<F: Float, T: Task>(
    task: &T,
    x: &[F],
    p: &[F],
    cost_bar: &[F],
    [x_bar, p_bar]: [&mut [F]; 2],
) {
    let rows = rows_without_controls(task, &Inputs { x, u: &[], p, t: 0 });
    check("cost_bar", cost_bar, rows, 1);
    check("x_bar", x_bar, rows, task.system().state_dim());
    check_requested("p_bar", p_bar, rows, task.param_dim());
    for_blocks(rows, [x, p, cost_bar], [x_bar, p_bar], |[x, p, cost_bar], [x_bar, p_bar]| {
        task.terminal_cost_gradient(x, p, x_bar, requested(p_bar));
        for bar in [x_bar, p_bar] {
            scale(bar, cost_bar[0]);
        }
    });
}

/// Writes the next states, their observations, and the running costs of the steps: [`step`],
/// [`observe`] and [`running_cost`] in one call. The observation is that of step t + 1, with the
/// parameters `p` of this step.
#[inline(never)]
pub fn transition<F: Float, T: Task>(
    task: &T,
    inputs: Inputs<'_, F>,
    [next, y, cost]: [&mut [F]; 3],
) {
    let rows = rows(task, &inputs);
    check_transition(task, rows, [&*next, y, cost]);
    for_blocks(
        rows,
        [inputs.x, inputs.u, inputs.p],
        [next, y, cost],
        |[x, u, p], [next, y, cost]| {
            let inputs = Inputs { x, u, p, t: inputs.t };
            task.system().step(inputs, next);
            cost[0] = task.running_cost(inputs, next);
            match task.observation_dim() {
                None => y.copy_from_slice(next),
                Some(_) => task.observe(Inputs { x: next, u: &[], p, t: inputs.t + 1 }, y),
            }
        },
    );
}

/// Writes the products of the cotangents of [`transition`], those of the next states, the
/// observations and the costs, with its transposed Jacobian: cotangents of `[x, u, p]`. `next` are
/// the next states of these inputs.
#[inline(never)]
pub fn transition_vjp<F: Float, T: Task>(
    task: &T,
    inputs: Inputs<'_, F>,
    next: &[F],
    [next_bar, y_bar, cost_bar]: [&[F]; 3],
    cotangents: [&mut [F]; 3],
) {
    let rows = rows(task, &inputs);
    check("next", next, rows, task.system().state_dim());
    check_transition(task, rows, [next_bar, y_bar, cost_bar]);
    check_cotangents(task, rows, &cotangents);
    for_blocks(
        rows,
        [inputs.x, inputs.u, inputs.p, next, next_bar, y_bar, cost_bar],
        cotangents,
        |[x, u, p, next, next_bar, y_bar, cost_bar], mut bars| {
            let inputs = Inputs { x, u, p, t: inputs.t };
            let mut by_cost: SmallVec<[Lane<F>; 32]> = SmallVec::new();
            by_cost.resize(next.len(), Lane::zero());
            let [x_bar, u_bar, p_bar] = bars.each_mut().map(|bar| requested(bar));
            let cotangents = Cotangents { x: x_bar, u: u_bar, p: p_bar };
            task.running_cost_gradient(inputs, next, cotangents, &mut by_cost);
            bars.iter_mut().for_each(|bar| scale(bar, cost_bar[0]));
            scale(&mut by_cost, cost_bar[0]);
            by_cost.iter_mut().zip(next_bar).for_each(|(sum, &bar)| *sum += bar);
            let mut next_bar = pack(&by_cost);
            let mut packs = bars.each_ref().map(|bar| pack(bar));
            let [x_bar, u_bar, p_bar] = packs.each_mut().map(|pack| requested(pack));
            let seen = Inputs { x: next, u: &[], p, t: inputs.t + 1 };
            let p_bar = add_observed(task, seen, y_bar, &mut next_bar, p_bar);
            let cotangents = Cotangents { x: x_bar, u: u_bar, p: p_bar };
            task.system().vjp(inputs, &next_bar, cotangents);
            for (bar, pack) in bars.into_iter().zip(&packs) {
                unpack(pack, bar);
            }
        },
    );
}

/// Adds the products of `y_bar` with the transposed Jacobians of the observation. Returns `p_bar`.
fn add_observed<'a, F: Float>(
    task: &impl Task,
    inputs: Inputs<'_, Lane<F>>,
    y_bar: &[Lane<F>],
    x_bar: &mut [One<Lane<F>>],
    mut p_bar: Option<&'a mut [One<Lane<F>>]>,
) -> Option<&'a mut [One<Lane<F>>]> {
    if task.observation_dim().is_some() {
        let cotangents = Cotangents { x: Some(x_bar), u: None, p: p_bar.as_deref_mut() };
        task.observe_vjp(inputs, &pack(y_bar), cotangents);
    } else {
        zip(x_bar.iter_mut(), y_bar).for_each(|(sum, &bar)| sum.0[0] += bar);
    }
    p_bar
}

#[track_caller]
fn check_transition<F>(task: &impl Task, rows: usize, [next, y, cost]: [impl AsRef<[F]>; 3]) {
    check("the array of next states", next.as_ref(), rows, task.system().state_dim());
    check("the array of observations", y.as_ref(), rows, observed_dim(task));
    check("the array of costs", cost.as_ref(), rows, 1);
}

/// Number of rows of the inputs.
#[track_caller]
fn rows<F>(task: &impl Task, inputs: &Inputs<'_, F>) -> usize {
    let rows = rows_without_controls(task, inputs);
    check("u", inputs.u, rows, task.system().control_dim());
    rows
}

/// Number of rows of the states and parameters.
#[track_caller]
fn rows_without_controls<F>(task: &impl Task, inputs: &Inputs<'_, F>) -> usize {
    let n = task.system().state_dim();
    let rows = inputs.x.len() / n;
    check("x", inputs.x, rows, n);
    check("p", inputs.p, rows, task.param_dim());
    rows
}

fn observed_dim(task: &impl Task) -> usize {
    task.observation_dim().unwrap_or(task.system().state_dim())
}

#[track_caller]
fn check<F>(name: &str, array: &[F], rows: usize, dim: usize) {
    assert_eq!(
        array.len(),
        rows * dim,
        "`{name}` has {} numbers; expected {rows} rows of {dim} numbers",
        array.len()
    );
}

/// Checks an array that may be empty.
#[track_caller]
fn check_requested<F>(name: &str, array: &[F], rows: usize, dim: usize) {
    if !array.is_empty() {
        check(name, array, rows, dim);
    }
}

#[track_caller]
fn check_cotangents<F>(task: &impl Task, rows: usize, [x, u, p]: &[&mut [F]; 3]) {
    check_requested("x_bar", x, rows, task.system().state_dim());
    check_requested("u_bar", u, rows, task.system().control_dim());
    check_requested("p_bar", p, rows, task.param_dim());
}

/// The buffer, unless it is empty.
fn requested<T>(buffer: &mut [T]) -> Option<&mut [T]> {
    (!buffer.is_empty()).then_some(buffer)
}

type Packs<F> = SmallVec<[One<Lane<F>>; 32]>;

fn pack<F: Float>(values: &[Lane<F>]) -> Packs<F> {
    let mut packs = Packs::<F>::new();
    packs.resize(values.len(), CotangentPack([Lane::zero()]));
    for (pack, &value) in zip(packs.iter_mut(), values) {
        *pack = CotangentPack([value]);
    }
    packs
}

fn unpack<F: Float>(packs: &Packs<F>, values: &mut [Lane<F>]) {
    for (value, CotangentPack([pack])) in zip(values.iter_mut(), packs.iter()) {
        *value = *pack;
    }
}

fn scale<F: Float>(values: &mut [Lane<F>], factor: Lane<F>) {
    values.iter_mut().for_each(|value| *value *= factor);
}

/// Calls `work` for each block of [`LANES`] rows, with the lanes of the inputs and outputs. Outputs
/// are 0 before each call.
fn for_blocks<F: Float, const I: usize, const O: usize>(
    rows: usize,
    inputs: [&[F]; I],
    outputs: [&mut [F]; O],
    work: impl Fn([&[Lane<F>]; I], [&mut [Lane<F>]; O]) + Sync,
) {
    if rows == 0 {
        return;
    }
    let (widths, output_widths) = (
        inputs.map(|array| array.len() / rows),
        outputs.each_ref().map(|array| array.len() / rows),
    );
    let mut rest = outputs;
    let mut chunks: SmallVec<[_; 1]> = (0..rows)
        .step_by(CHUNK)
        .map(|first| {
            let count = CHUNK.min(rows - first);
            let inputs: [_; I] =
                std::array::from_fn(|i| &inputs[i][first * widths[i]..][..count * widths[i]]);
            let outputs: [_; O] = std::array::from_fn(|i| {
                let (now, later) =
                    std::mem::take(&mut rest[i]).split_at_mut(count * output_widths[i]);
                rest[i] = later;
                now
            });
            (count, inputs, outputs)
        })
        .collect();
    for_each(&mut chunks, &|_, (count, inputs, outputs)| blocks(*count, *inputs, outputs, &work));
}

/// [`for_blocks`] of one thread.
fn blocks<F: Float, const I: usize, const O: usize>(
    rows: usize,
    inputs: [&[F]; I],
    outputs: &mut [&mut [F]; O],
    work: &impl Fn([&[Lane<F>]; I], [&mut [Lane<F>]; O]),
) {
    let lanes = |len: usize| vec![Lane::<F>::zero(); len / rows];
    let mut input_lanes = inputs.map(|array| lanes(array.len()));
    let mut output_lanes = outputs.each_ref().map(|array| lanes(array.len()));
    for first in (0..rows).step_by(LANES) {
        for i in 0..I {
            // Unused lanes repeat the last row, so they add no non-finite numbers.
            let row = |lane: usize| (first + lane).min(rows - 1);
            gather(inputs[i], row, &mut input_lanes[i]);
        }
        output_lanes.iter_mut().for_each(|lanes| lanes.fill(Lane::zero()));
        work(
            input_lanes.each_ref().map(Vec::as_slice),
            output_lanes.each_mut().map(Vec::as_mut_slice),
        );
        for i in 0..O {
            scatter(&output_lanes[i], first..rows.min(first + LANES), outputs[i]);
        }
    }
}

/// Copies rows of an array to lanes. `row` is the index of the row of a lane.
#[inline(always)]
fn gather<F: Float>(array: &[F], row: impl Fn(usize) -> usize, lanes: &mut [Lane<F>]) {
    let width = lanes.len();
    for lane in 0..LANES {
        for (number, &value) in zip(lanes.iter_mut(), &array[row(lane) * width..][..width]) {
            number.0[lane] = value;
        }
    }
}

/// Copies lanes to rows of an array.
#[inline(always)]
fn scatter<F: Float>(lanes: &[Lane<F>], rows: Range<usize>, array: &mut [F]) {
    let width = lanes.len();
    for lane in 0..rows.len() {
        let row = &mut array[(rows.start + lane) * width..][..width];
        for (value, number) in zip(row.iter_mut(), lanes) {
            *value = number.0[lane];
        }
    }
}

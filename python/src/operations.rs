//! [`Operation`]: functions of a task, and their derivatives, on arrays of another framework.
//!
//! Frameworks whose compiled functions contain no Python objects refer to a task by a number, its
//! [`handle`]. Tasks stay in memory, because a compiled function may outlive all other references.

use crate::arrays::{Argument, Number, is_f32, with_precision};
use crate::errors::{caught, invalid, value_error};
use crate::policy::Policy;
use crate::task::Task;
use anyhow::{Result, anyhow, bail, ensure};
use numpy::{PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use physgrad::engine::{open_loop, rows};
use physgrad::train::Trajectories;
use physgrad::{Flow, Inputs};
use physgrad_cli::api::ClosedLoop;
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::sync::{Arc, PoisonError, RwLock};

/// A task, and a policy that acts in it.
pub struct Called {
    task: Task,
    closed: Option<ClosedLoop>,
    /// Paths of the derivatives of a rollout.
    flow: Flow,
}

static CALLED: RwLock<BTreeMap<u64, Arc<Called>>> = RwLock::new(BTreeMap::new());

/// The task with this handle.
pub fn called(handle: u64) -> Option<Arc<Called>> {
    CALLED.read().unwrap_or_else(PoisonError::into_inner).get(&handle).cloned()
}

/// Handle of this task, and of the rollouts of this policy along a flow, "R", "M", "N" or "S": a hash
/// of their settings, so that a graph of another process never computes another task.
#[pyfunction]
#[pyo3(signature = (task, policy=None, flow="R"))]
pub fn handle(task: &Task, policy: Option<&Policy>, flow: &str) -> PyResult<u64> {
    let paths = match flow {
        "R" => Flow::REGULAR,
        "M" => Flow::MODIFIED,
        "N" => Flow::NETWORK,
        "S" => Flow::STOPPED,
        _ => {
            return Err(invalid(format!(
                "`flow` is {flow:?}; allowed: \"R\", \"M\", \"N\", \"S\""
            )));
        }
    };
    crate::threads::ready()?;
    let policy = policy.map(|policy| policy.lock().clone());
    let mut hasher = DefaultHasher::new();
    (flow, task.scene.text()).hash(&mut hasher);
    policy.as_ref().map(|policy| policy.scene().text()).hash(&mut hasher);
    // A nonnegative integer of 64 bits with a sign.
    let handle = hasher.finish() >> 1;
    if called(handle).is_some() {
        return Ok(handle);
    }
    let closed = policy.map(|policy| policy.closed(&task.scene)).transpose();
    let closed = closed.map_err(value_error)?;
    let new = Called { task: Task::new(task.scene.clone()), closed, flow: paths };
    CALLED.write().unwrap_or_else(PoisonError::into_inner).insert(handle, Arc::new(new));
    Ok(handle)
}

/// An operation. Its inputs and outputs are those of the function of this name of `Task`, with `p` at
/// their end; the inputs of a derivative end with the cotangents of the outputs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Operation {
    Step,
    StepVjp,
    Observe,
    ObserveVjp,
    RunningCost,
    RunningCostVjp,
    TerminalCost,
    TerminalCostVjp,
    /// x, u, p → next, y, cost.
    Transition,
    /// x, u, p, next, and the cotangents of the outputs → cotangents of x, u, p.
    TransitionVjp,
    /// controls, starts → states.
    States,
    /// controls, starts, states, cotangents of states → cotangents of controls, starts.
    StatesVjp,
    /// θ, starts → states, controls.
    Rollout,
    /// θ, starts, cotangents of states and controls → cotangents of θ, starts.
    RolloutVjp,
}

impl Operation {
    /// All operations, with their names.
    pub const ALL: [(Self, &str); 14] = [
        (Self::Step, "step"),
        (Self::StepVjp, "step_vjp"),
        (Self::Observe, "observe"),
        (Self::ObserveVjp, "observe_vjp"),
        (Self::RunningCost, "running_cost"),
        (Self::RunningCostVjp, "running_cost_vjp"),
        (Self::TerminalCost, "terminal_cost"),
        (Self::TerminalCostVjp, "terminal_cost_vjp"),
        (Self::Transition, "transition"),
        (Self::TransitionVjp, "transition_vjp"),
        (Self::States, "states"),
        (Self::StatesVjp, "states_vjp"),
        (Self::Rollout, "rollout"),
        (Self::RolloutVjp, "rollout_vjp"),
    ];

    /// The operation at this index of [`ALL`](Self::ALL).
    pub fn of_code(code: i64) -> Option<Self> {
        Self::ALL.get(usize::try_from(code).ok()?).map(|(operation, _)| *operation)
    }
}

/// Names of all operations. Their indices are the codes in calls.
#[pyfunction]
pub fn operation_names() -> Vec<&'static str> {
    Operation::ALL.iter().map(|(_, name)| *name).collect()
}

/// Runs the operation of this name on arrays of one dtype. Writes to the arrays `outputs`. `t` is the
/// step number of all rows.
#[pyfunction]
pub fn operation<'py>(
    py: Python<'py>,
    handle: u64,
    name: &str,
    t: i64,
    inputs: Vec<Bound<'py, PyAny>>,
    outputs: Vec<Bound<'py, PyAny>>,
) -> PyResult<()> {
    let operation = Operation::ALL.iter().find(|(_, known)| *known == name);
    let (Some((operation, _)), Some(called)) = (operation, called(handle)) else {
        return Err(invalid(format!(
            "this process does not know the task of `{name}`; create the function from the task before a graph of another process \
             runs"
        )));
    };
    with_precision!(is_f32(&inputs), F => {
        let read = |array: &Bound<'py, PyAny>| Argument::<F>::read("an input", array, &|_| Ok(()));
        let inputs = inputs.iter().map(read).collect::<PyResult<Vec<_>>>()?;
        let mut outputs = outputs
            .iter()
            .map(|array| {
                let array = array.cast::<PyArrayDyn<F>>()?;
                if !array.is_c_contiguous() {
                    return Err(invalid("an output is not contiguous in the order of C"));
                }
                Ok(array.try_readwrite()?)
            })
            .collect::<PyResult<Vec<_>>>()?;
        let inputs: Vec<Array<'_, F>> = inputs
            .iter()
            .map(|input: &Argument<'_, F>| Array { dims: input.shape().to_vec(), numbers: input.slice() })
            .collect();
        let mut outputs = outputs
            .iter_mut()
            .map(|output| Ok(output.as_slice_mut()?))
            .collect::<PyResult<Vec<&mut [F]>>>()?;
        let steps = (&[t][..], &[][..]);
        let done = py.detach(|| caught(|| run(&called, *operation, steps, &inputs, &mut outputs)))?;
        done.map_err(value_error)
    })
}

/// An input. The last dimension, or the last two of a trajectory, belong to one sample.
#[derive(Clone)]
pub struct Array<'a, F> {
    pub dims: Vec<usize>,
    pub numbers: &'a [F],
}

/// Runs an operation. `steps` are the step numbers and their dimensions, which broadcast to the
/// leading dimensions of the inputs.
///
/// # Errors
/// Sizes do not fit the task, a parameter is out of range, or a rollout diverges.
pub fn run<F: Number>(
    called: &Called,
    operation: Operation,
    (steps, dims): (&[i64], &[usize]),
    inputs: &[Array<'_, F>],
    outputs: &mut [&mut [F]],
) -> Result<()> {
    match operation {
        Operation::States | Operation::StatesVjp => {
            return states(called, operation, inputs, outputs);
        }
        Operation::Rollout | Operation::RolloutVjp => {
            return rollout(called, operation, inputs, outputs);
        }
        _ => {}
    }
    let widths = called.widths(operation);
    ensure!(
        [inputs.len(), outputs.len()] == [widths.0.len(), widths.1.len()],
        "the call has {} inputs and {} outputs",
        inputs.len(),
        outputs.len()
    );
    let lead = &inputs[0].dims[..inputs[0].dims.len().saturating_sub(1)];
    let count: usize = lead.iter().product();
    let lengths = inputs.iter().map(|input| input.numbers.len());
    let lengths = lengths.chain(outputs.iter().map(|output| output.len()));
    for (length, width) in lengths.zip(widths.0.iter().chain(&widths.1)) {
        ensure!(
            length == count * width,
            "an array has {length} numbers, not {count} rows of {width}"
        );
    }
    let at = |row: usize| step_of(row, lead, steps, dims);
    let mut first = 0;
    // One call for rows with equal step numbers.
    while first < count {
        let t = at(first)?;
        let end = match steps {
            [_] => count,
            _ => (first + 1..count).find(|&row| at(row).ok() != Some(t)).unwrap_or(count),
        };
        let now: Vec<&[F]> = inputs
            .iter()
            .zip(&widths.0)
            .map(|(input, width)| &input.numbers[first * width..end * width])
            .collect();
        let out: Vec<&mut [F]> = outputs
            .iter_mut()
            .zip(&widths.1)
            .map(|(output, width)| &mut output[first * width..end * width])
            .collect();
        call_rows(called, operation, t, &now, out)?;
        first = end;
    }
    Ok(())
}

/// Step number of a row.
fn step_of(row: usize, lead: &[usize], steps: &[i64], dims: &[usize]) -> Result<usize> {
    let index = match steps.len() {
        1 => 0,
        _ => {
            ensure!(
                dims.len() == lead.len(),
                "`t` has {} dimensions, not {}",
                dims.len(),
                lead.len()
            );
            let (mut rest, mut index, mut stride) = (row, 0, 1);
            for (&size, &own) in lead.iter().zip(dims).rev() {
                let at = rest % size;
                rest /= size;
                if own != 1 {
                    ensure!(own == size, "`t` does not broadcast to the batch dimensions");
                    index += at * stride;
                    stride *= own;
                }
            }
            index
        }
    };
    let t = *steps.get(index).ok_or_else(|| anyhow!("`t` is empty"))?;
    usize::try_from(t).map_err(|_| anyhow!("`t` is {t}; allowed: step numbers from 0"))
}

impl Called {
    /// Numbers per row of the inputs and outputs.
    fn widths(&self, operation: Operation) -> (Vec<usize>, Vec<usize>) {
        let [n, m, params] = self.task.scene.dims();
        let y = self.task.observed();
        let (inputs, outputs): (&[usize], &[usize]) = match operation {
            Operation::Step => (&[n, m, params], &[n]),
            Operation::StepVjp => (&[n, m, params, n], &[n, m, params]),
            Operation::Observe => (&[n, params], &[y]),
            Operation::ObserveVjp => (&[n, params, y], &[n, params]),
            Operation::RunningCost => (&[n, m, n, params], &[1]),
            Operation::RunningCostVjp => (&[n, m, n, params, 1], &[n, m, n, params]),
            Operation::TerminalCost => (&[n, params], &[1]),
            Operation::TerminalCostVjp => (&[n, params, 1], &[n, params]),
            Operation::Transition => (&[n, m, params], &[n, y, 1]),
            Operation::TransitionVjp => (&[n, m, params, n, n, y, 1], &[n, m, params]),
            Operation::States
            | Operation::StatesVjp
            | Operation::Rollout
            | Operation::RolloutVjp => (&[], &[]),
        };
        (inputs.to_vec(), outputs.to_vec())
    }
}

/// An operation of rows with equal step numbers.
fn call_rows<F: Number>(
    called: &Called,
    operation: Operation,
    t: usize,
    inputs: &[&[F]],
    outputs: Vec<&mut [F]>,
) -> Result<()> {
    let (task, checked) = (called.task.dyn_task(), |p: &[F]| called.task.checked_rows(p));
    /// The outputs, whose number is checked.
    fn all<F, const K: usize>(outputs: Vec<&mut [F]>) -> [&mut [F]; K] {
        outputs.try_into().ok().expect("the number of outputs is checked")
    }
    match (operation, inputs) {
        (Operation::Step, &[x, u, p]) => {
            checked(p)?;
            let [next] = all(outputs);
            rows::step(task, Inputs { x, u, p, t }, next);
        }
        (Operation::StepVjp, &[x, u, p, next_bar]) => {
            rows::step_vjp(task, Inputs { x, u, p, t }, next_bar, all(outputs));
        }
        (Operation::Observe, &[x, p]) => {
            checked(p)?;
            let [y] = all(outputs);
            rows::observe(task, Inputs { x, u: &[], p, t }, y);
        }
        (Operation::ObserveVjp, &[x, p, y_bar]) => {
            rows::observe_vjp(task, Inputs { x, u: &[], p, t }, y_bar, all(outputs));
        }
        (Operation::RunningCost, &[x, u, next, p]) => {
            checked(p)?;
            let [cost] = all(outputs);
            rows::running_cost(task, Inputs { x, u, p, t }, next, cost);
        }
        (Operation::RunningCostVjp, &[x, u, next, p, cost_bar]) => {
            rows::running_cost_vjp(task, Inputs { x, u, p, t }, next, cost_bar, all(outputs));
        }
        (Operation::TerminalCost, &[x, p]) => {
            checked(p)?;
            let [cost] = all(outputs);
            rows::terminal_cost(task, x, p, cost);
        }
        (Operation::TerminalCostVjp, &[x, p, cost_bar]) => {
            rows::terminal_cost_vjp(task, x, p, cost_bar, all(outputs));
        }
        (Operation::Transition, &[x, u, p]) => {
            checked(p)?;
            rows::transition(task, Inputs { x, u, p, t }, all(outputs));
        }
        (Operation::TransitionVjp, &[x, u, p, next, next_bar, y_bar, cost_bar]) => {
            let bars = [next_bar, y_bar, cost_bar];
            rows::transition_vjp(task, Inputs { x, u, p, t }, next, bars, all(outputs));
        }
        _ => bail!("{operation:?} has other inputs"),
    }
    Ok(())
}

/// States of given controls, or their derivatives.
fn states<F: Number>(
    called: &Called,
    operation: Operation,
    inputs: &[Array<'_, F>],
    outputs: &mut [&mut [F]],
) -> Result<()> {
    let (task, width) = (called.task.dyn_task(), called.task.width);
    let [n, m, _] = called.task.scene.dims();
    let [controls, starts, rest @ ..] = inputs else { bail!("{operation:?} has other inputs") };
    let steps = match controls.dims[..] {
        [.., steps, last] if last == m => steps,
        _ => bail!("`u` has the shape {:?}; expected (..., steps, {m})", controls.dims),
    };
    let samples = starts.numbers.len() / width;
    ensure!(
        starts.numbers.len() == samples * width && controls.numbers.len() == samples * steps * m,
        "`u` has {} numbers, which are not those of {samples} samples",
        controls.numbers.len()
    );
    match (operation, rest, outputs) {
        (Operation::States, [], [states]) if states.len() == samples * (steps + 1) * n => {
            called.task.checked_starts(starts.numbers)?;
            states.copy_from_slice(&open_loop::states(
                task,
                starts.numbers,
                controls.numbers,
                steps,
            ));
        }
        (Operation::StatesVjp, [states, states_bar], [controls_bar, starts_bar])
            if [states, states_bar]
                .iter()
                .all(|states| states.numbers.len() == samples * (steps + 1) * n) =>
        {
            let (starts, controls) = (starts.numbers, controls.numbers);
            let [by_starts, by_controls] =
                open_loop::states_vjp(task, starts, controls, states.numbers, states_bar.numbers);
            controls_bar.copy_from_slice(&by_controls);
            starts_bar.copy_from_slice(&by_starts);
        }
        _ => bail!("{operation:?} has other inputs"),
    }
    Ok(())
}

/// Rollouts of a policy, or their derivatives. There is one vector θ for all rows, or one for each
/// group of rows.
fn rollout<F: Number>(
    called: &Called,
    operation: Operation,
    inputs: &[Array<'_, F>],
    outputs: &mut [&mut [F]],
) -> Result<()> {
    let closed = called.closed.as_ref().ok_or_else(|| anyhow!("the function has no policy"))?;
    let [theta, starts, rest @ ..] = inputs else { bail!("{operation:?} has other inputs") };
    let params = closed.param_count();
    ensure!(
        theta.dims.last() == Some(&params),
        "`theta` has the shape {:?}, but the policy has {params} parameters",
        theta.dims
    );
    let groups = theta.dims[..theta.dims.len() - 1].iter().product::<usize>();
    let samples = starts.numbers.len() / called.task.width;
    ensure!(
        groups > 0
            && samples.is_multiple_of(groups)
            && starts.numbers.len() == samples * called.task.width,
        "{samples} initial states cannot be divided into {groups} groups, one for each `theta`"
    );
    let part = |numbers: &[F], group: usize| {
        let each = numbers.len() / groups;
        group * each..(group + 1) * each
    };
    if operation == Operation::Rollout {
        called.task.checked_starts(starts.numbers)?;
    }
    for group in 0..groups {
        let theta = theta.numbers[part(theta.numbers, group)].to_vec();
        let of = |array: &Array<'_, F>| array.numbers[part(array.numbers, group)].to_vec();
        let (first, second) = match (operation, rest) {
            (Operation::Rollout, []) => {
                let found = closed.rollout(theta, &of(starts))?;
                (found.states, found.controls)
            }
            (Operation::RolloutVjp, [states_bar, controls_bar]) => {
                let bars = Trajectories { states: of(states_bar), controls: of(controls_bar) };
                closed.rollout_vjp(theta, &of(starts), &bars, called.flow)?
            }
            _ => bail!("{operation:?} has other inputs"),
        };
        let [out_1, out_2] = outputs else { bail!("{operation:?} has two outputs") };
        for (out, numbers) in [(out_1, first), (out_2, second)] {
            let range = part(out, group);
            ensure!(range.len() == numbers.len(), "an output has {} numbers", range.len());
            out[range].copy_from_slice(&numbers);
        }
    }
    Ok(())
}

//! [`Task`]: a scene, and its steps, observations and costs on arrays.

use crate::arrays::{Argument, Number, array, is_f32, with_precision};
use crate::errors::{check_regular, fits, invalid, value_error};
use crate::interrupt::in_parts;
use crate::rows::Rows;
use crate::settings::{keywords, table_to_python};
use crate::whole;
use anyhow::{Context as _, bail};
use numpy::{PyArrayDyn, PyArrayMethods as _};
use physgrad::engine::rows;
use physgrad::number::NoiseNumbers;
use physgrad::rng::Purpose;
use physgrad::{DynTask, Float as _, Inputs, System as _, Tangents, Task as _};
use physgrad_cli::api::Scene;
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict as _, PyBytes, PyDict, PyString, PyTuple};
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::path::Path;
use std::sync::OnceLock;

/// Settings outside of all sections that functions accept as keyword arguments.
pub const TOP: [&str; 7] = ["horizon", "precision", "field", "epochs", "seed", "tags", "log"];

/// A task: system, horizon, costs and the distribution of initial states. `physgrad.task` creates
/// it.
///
/// Array methods accept B samples at once, one per row. They compute in f32 if all arguments are
/// arrays of float32, and otherwise in f64. They copy lists, non-contiguous arrays, and arrays of
/// another dtype. `t` is the number of the step, equal for all rows. `p` has the parameters of each sample,
/// (B, param_dim), and may be omitted if param_dim is 0. Units are those of the task; see
/// `physgrad tasks NAME`.
#[pyclass(frozen, module = "physgrad")]
pub struct Task {
    pub scene: Scene,
    task: DynTask,
    n: usize,
    m: usize,
    params: usize,
    /// Length of a row of initial states.
    pub width: usize,
    noise: NoiseNumbers,
    /// Parameters without negative values, and whether each may be 0.
    ranges: OnceLock<Vec<(usize, bool)>>,
}

impl Task {
    pub fn new(scene: Scene) -> Self {
        let [n, m, params] = scene.dims();
        let task = scene.task();
        let noise = NoiseNumbers::of(&task.system().varied(params));
        let width = n + params + noise.key_dim();
        Self { task, scene, n, m, params, width, noise, ranges: OnceLock::new() }
    }

    /// Refuses initial states with parameters outside of the ranges of their settings, such as a mass
    /// of 0.
    pub fn check_starts<F: Number>(&self, starts: &[F]) -> PyResult<()> {
        self.checked_starts(starts).map_err(value_error)
    }

    /// [`check_starts`](Self::check_starts) without the GIL.
    pub fn checked_starts<F: Number>(&self, starts: &[F]) -> anyhow::Result<()> {
        self.checked_params(starts, self.width, self.n)?;
        if self.noise.is_empty() {
            return Ok(());
        }
        let keys = starts.chunks(self.width).map(|start| start[self.width - 1].to_f64());
        let is_key = |key: f64| (0.0..16_777_216.0).contains(&key) && key.fract() == 0.0;
        match keys.enumerate().find(|(_, key)| !is_key(*key)) {
            Some((row, key)) => bail!(
                "row {row} ends with {key}; expected the key of its noise, a whole number below 2^24, as in `task.starts`"
            ),
            None => Ok(()),
        }
    }

    /// Refuses rows of parameters outside of their ranges.
    pub fn checked_rows<F: Number>(&self, p: &[F]) -> anyhow::Result<()> {
        self.checked_params(p, self.params, 0)
    }

    /// Refuses parameters outside of their ranges. They begin at the index `first` of each row, of
    /// this width.
    fn checked_params<F: Number>(
        &self,
        rows: &[F],
        width: usize,
        first: usize,
    ) -> anyhow::Result<()> {
        if self.params == 0 {
            return Ok(());
        }
        let ranges = self.ranges.get_or_init(|| self.scene.signed_params());
        if ranges.is_empty() {
            return Ok(());
        }
        for (row, numbers) in rows.chunks(width).enumerate() {
            let p = &numbers[first..][..self.params];
            let is_bad = |&(i, allows_zero): &(usize, bool)| {
                p[i] < F::zero() || (p[i] == F::zero() && !allows_zero)
            };
            if ranges.iter().any(is_bad) {
                let p: Vec<f64> = p.iter().map(|p| p.to_f64()).collect();
                self.scene.check_params(&p).with_context(|| format!("row {row}"))?;
            }
        }
        Ok(())
    }

    /// The task of the library.
    pub fn dyn_task(&self) -> &DynTask {
        &self.task
    }

    fn identity(&self) -> (String, Option<&[u8]>) {
        (self.scene.text(), self.scene.initial_policy())
    }

    /// Number of components that a policy observes.
    pub fn observed(&self) -> usize {
        self.task.observation_dim().unwrap_or(self.n)
    }

    /// The inputs of all rows: x, u if given, and p.
    fn rows<'py, F: Number>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        u: Option<&Bound<'py, PyAny>>,
        p: Option<&Bound<'py, PyAny>>,
        t: usize,
    ) -> PyResult<Rows<'py, F>> {
        let (x, count) = Argument::first("x", x, self.n)?;
        let u = u.map(|u| Argument::matrix("u", u, count, self.m)).transpose()?;
        let p = match p {
            Some(p) => {
                let p = Argument::<F>::matrix("p", p, count, self.params)?;
                self.checked_rows(p.slice()).map_err(value_error)?;
                p
            }
            None if self.params == 0 => {
                Argument::matrix("p", array::<F>(py, Vec::new(), &[count, 0])?.as_any(), count, 0)?
            }
            None => {
                let names = self.scene.param_names().join(", ");
                let (params, name) = (self.params, self.scene.name());
                return Err(invalid(format!(
                    "{name} has {params} parameters ({names}); pass `p` of shape ({count}, {params})"
                )));
            }
        };
        Ok(Rows { count, x, u, p, t })
    }
}

/// Names of all tasks, each of which is also the name of a preset.
#[pyfunction]
pub fn task_names() -> Vec<&'static str> {
    physgrad_cli::api::task_names()
}

/// Names of the presets that `task` opens, each with a line about it, as a dict.
#[pyfunction]
pub fn presets(py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
    physgrad_cli::api::presets().into_py_dict(py)
}

#[pymethods]
impl Task {
    /// Opens a preset or a scene file. See `physgrad.task`.
    #[new]
    #[pyo3(signature = (name, **settings))]
    fn open(py: Python<'_>, name: &str, settings: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let settings = keywords(settings, "system", &TOP)?;
        if !Path::new(name).is_dir() {
            check_regular(Path::new(name))?;
        }
        py.detach(|| Scene::open(name, settings)).map(Self::new).map_err(value_error)
    }

    /// The task with this name and these settings: `equations`, which `physgrad.system` makes from
    /// functions, or `bodies`.
    #[staticmethod]
    #[pyo3(name = "_of", signature = (task, **settings))]
    fn of(py: Python<'_>, task: &str, settings: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let settings = keywords(settings, "system", &TOP)?;
        let scene = py.detach(|| Scene::of_task(task, settings));
        scene.map(Self::new).map_err(value_error)
    }

    /// Copy with other settings, given as in `physgrad.task`. A dict changes only its keys, and None
    /// removes an effect or a part of the actuator, as in `effects={"bumpers": None}`.
    #[pyo3(signature = (**settings))]
    fn replace(&self, py: Python<'_>, settings: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let settings = keywords(settings, "system", &TOP)?;
        let settings: Vec<_> =
            settings.into_iter().map(|(key, value)| (self.scene.key(key), value)).collect();
        py.detach(|| self.scene.with(settings)).map(Self::new).map_err(value_error)
    }

    /// The task of a pickle.
    #[staticmethod]
    #[pyo3(name = "_of_text", signature = (text, initial_policy=None))]
    fn of_text(py: Python<'_>, text: &str, initial_policy: Option<Vec<u8>>) -> PyResult<Self> {
        let scene = py.detach(|| Scene::of_text(text, initial_policy.as_deref()));
        scene.map(Self::new).map_err(value_error)
    }

    /// Pickles and copies are made from the settings.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let restore = py.get_type::<Self>().getattr("_of_text")?;
        let policy = self.scene.initial_policy().map(|policy| PyBytes::new(py, policy));
        let arguments = PyTuple::new(
            py,
            [
                PyString::new(py, &self.scene.text()).into_any(),
                policy.into_pyobject(py)?.into_any(),
            ],
        )?;
        PyTuple::new(py, [restore, arguments.into_any()])
    }

    /// Tasks are equal if their settings are.
    fn __eq__(&self, other: &Self) -> bool {
        self.identity() == other.identity()
    }

    fn __hash__(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        self.identity().hash(&mut hasher);
        hasher.finish()
    }

    fn __repr__(&self) -> String {
        let (name, horizon) = (self.scene.name(), self.scene.horizon());
        format!("<physgrad.Task {name}: {} states, {} controls, {horizon} steps>", self.n, self.m)
    }

    /// Name of the task.
    #[getter]
    fn name(&self) -> &'static str {
        self.scene.name()
    }

    /// Number n of components of the state.
    #[getter]
    fn state_dim(&self) -> usize {
        self.n
    }

    /// Index of the state component that is not 0 after the end of an episode, by the condition
    /// `loss.end`; it then has the number of steps. None if episodes end at the horizon only.
    #[getter]
    fn ended(&self) -> Option<usize> {
        physgrad::Task::ended(&self.task)
    }

    /// Number m of components of the control.
    #[getter]
    fn control_dim(&self) -> usize {
        self.m
    }

    /// Number of parameters of a sample.
    #[getter]
    fn param_dim(&self) -> usize {
        self.params
    }

    /// Number of components that a policy observes.
    #[getter]
    fn observation_dim(&self) -> usize {
        self.observed()
    }

    /// Smallest and largest value of each control that the task is meant for, in its units: a list
    /// of m pairs, or None without bounds. `actuator.limit.bound` replaces those of the task.
    #[getter]
    fn control_bounds(&self) -> Option<Vec<(f64, f64)>> {
        let bounds = self.scene.control_bounds()?;
        Some(bounds.into_iter().map(|[low, high]| (low, high)).collect())
    }

    /// Length of a row of `starts`: state_dim + param_dim, and 1 more if the task has noise.
    #[getter]
    fn start_dim(&self) -> usize {
        self.width
    }

    /// Number T of steps of a rollout.
    #[getter]
    fn horizon(&self) -> usize {
        self.scene.horizon()
    }

    /// Time step, in the unit of time of the task: s, except for `quantum`.
    #[getter]
    fn dt(&self) -> f64 {
        self.scene.dt()
    }

    /// Precision of trainings: "float32" or "float64".
    #[getter]
    fn dtype(&self) -> &'static str {
        if self.scene.is_f64() { "float64" } else { "float32" }
    }

    /// Names of the components of the state.
    #[getter]
    fn state_names(&self) -> Vec<String> {
        self.scene.state_names()
    }

    /// Names of the components of the control.
    #[getter]
    fn control_names(&self) -> Vec<String> {
        self.scene.control_names()
    }

    /// Names of the parameters of a sample.
    #[getter]
    fn param_names(&self) -> Vec<String> {
        self.scene.param_names()
    }

    /// Names of the components that a policy observes.
    #[getter]
    fn observation_names(&self) -> Vec<String> {
        self.scene.observation_names()
    }

    /// Name, parts, numbers and remarks of a model in a file; see `physgrad.Model`.
    #[getter]
    #[pyo3(name = "_model")]
    fn model<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyTuple>>> {
        let Some((model, numbers)) = self.scene.model() else { return Ok(None) };
        let parts = model.parts.into_py_dict(py)?.into_any();
        let name = PyString::new(py, &model.name).into_any();
        let remarks = model.remarks.into_pyobject(py)?.into_any();
        PyTuple::new(py, [name, parts, table_to_python(py, &numbers)?, remarks]).map(Some)
    }

    /// All settings of the scene, defaults included, as nested dicts, which refuse changes, and
    /// tuples. `replace` returns a task with other settings.
    #[getter]
    fn settings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        table_to_python(py, &self.scene.settings())
    }

    /// Draws initial states, (count, start_dim).
    ///
    /// A row has the state x, then the parameters p: `x, p = starts[:, :n], starts[:, n:]`. If the
    /// task has noise, the last number of a row is its key, and `params_at` gives p. Row i
    /// depends only on the task, `seed`, `split` and i. `split` selects the random streams: "new"
    /// for states that no training uses, "train" and "test" for the data sets of a training with
    /// this seed. `dtype` is "float32" or "float64", by default that of the task. Raises
    /// `MemoryError` if the states do not fit into memory.
    #[pyo3(signature = (count, seed=0, split="new", dtype=None))]
    fn starts<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = whole::count)] count: usize,
        #[pyo3(from_py_with = whole::seed)] seed: u64,
        split: &str,
        dtype: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let purpose = match split {
            "new" => Purpose::Evaluate,
            "train" => Purpose::Train,
            "test" => Purpose::Test,
            _ => {
                return Err(invalid(format!(
                    "`split` is {split:?}; allowed: \"new\", \"train\", \"test\""
                )));
            }
        };
        let is_f32 = match dtype {
            None => !self.scene.is_f64(),
            Some(dtype) => {
                let found = py.import("numpy")?.call_method1("dtype", (dtype,));
                let name = found.and_then(|found| found.getattr("name")?.extract::<String>());
                match name.as_deref() {
                    Ok("float32") => true,
                    Ok("float64") => false,
                    _ => {
                        let given = name.unwrap_or_else(|_| dtype.to_string());
                        return Err(invalid(format!(
                            "`dtype` is {given}; allowed: float32, float64"
                        )));
                    }
                }
            }
        };
        with_precision!(is_f32, F => {
            fits("the initial states", &[count, self.width], size_of::<F>())?;
            let mut starts = Vec::<F>::with_capacity(count * self.width);
            in_parts(py, count, 1024, |samples| self.scene.append_starts(seed, purpose, samples, &mut starts))?;
            Ok(array(py, starts, &[count, self.width])?.into_any())
        })
    }

    /// Parameters, (B, param_dim), of the rollouts from initial states `starts`, (B, start_dim), at
    /// step `t`, from 0.
    ///
    /// They are the columns of `starts` after the state. Only noise differs between steps: it has
    /// the values that it has at this step of a rollout.
    #[pyo3(signature = (starts, t=0))]
    fn params_at<'py>(
        &self,
        py: Python<'py>,
        starts: &Bound<'py, PyAny>,
        #[pyo3(from_py_with = whole::t)] t: usize,
    ) -> PyResult<Bound<'py, PyAny>> {
        with_precision!(is_f32([starts]), F => {
            let (starts, count) = Argument::<F>::first("starts", starts, self.width)?;
            self.check_starts(starts.slice())?;
            let mut params = Vec::with_capacity(count * self.params);
            for start in starts.slice().chunks(self.width) {
                let first = params.len();
                params.extend_from_slice(&start[self.n..][..self.params]);
                let key = start[self.width - 1].to_f64();
                self.noise.at(key, t, |i, value| params[first + i] = F::from_f64(value));
            }
            Ok(array(py, params, &[count, self.params])?.into_any())
        })
    }

    /// Next states, (B, n), of states `x`, (B, n), and controls `u`, (B, m).
    #[pyo3(signature = (x, u, p=None, t=0))]
    fn step<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        u: &Bound<'py, PyAny>,
        p: Option<&Bound<'py, PyAny>>,
        #[pyo3(from_py_with = whole::t)] t: usize,
    ) -> PyResult<Bound<'py, PyAny>> {
        with_precision!(is_f32([x, u].into_iter().chain(p)), F => {
            let given = self.rows::<F>(py, x, Some(u), p, t)?;
            given.matrix(py, self.n, |inputs, _, next| rows::step(&self.task, inputs, next))
        })
    }

    /// Products of `next_bar`, (B, n), with the transposed Jacobians of `step`.
    ///
    /// Returns `(x_bar, u_bar, p_bar)`, of the shapes of x, u and p.
    #[pyo3(signature = (x, u, next_bar, p=None, t=0))]
    fn step_vjp<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        u: &Bound<'py, PyAny>,
        next_bar: &Bound<'py, PyAny>,
        p: Option<&Bound<'py, PyAny>>,
        #[pyo3(from_py_with = whole::t)] t: usize,
    ) -> PyResult<Bound<'py, PyTuple>> {
        with_precision!(is_f32([x, u, next_bar].into_iter().chain(p)), F => {
            let given = self.rows::<F>(py, x, Some(u), p, t)?;
            let next_bar = Argument::<F>::matrix("next_bar", next_bar, given.count, self.n)?;
            let next_bar = next_bar.per_row();
            given.matrices(py, [self.n, self.m, self.params], |inputs, rows, bars| {
                rows::step_vjp(&self.task, inputs, next_bar.of(rows), bars);
            })
        })
    }

    /// Products of the Jacobians of `step` with tangents: (B, n).
    ///
    /// `x_tan`, `u_tan` and `p_tan` have the shapes of x, u and p. None is a zero tangent.
    #[pyo3(signature = (x, u, x_tan=None, u_tan=None, p=None, p_tan=None, t=0))]
    fn step_jvp<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        u: &Bound<'py, PyAny>,
        x_tan: Option<&Bound<'py, PyAny>>,
        u_tan: Option<&Bound<'py, PyAny>>,
        p: Option<&Bound<'py, PyAny>>,
        p_tan: Option<&Bound<'py, PyAny>>,
        #[pyo3(from_py_with = whole::t)] t: usize,
    ) -> PyResult<Bound<'py, PyAny>> {
        with_precision!(is_f32([Some(x), Some(u), p, x_tan, u_tan, p_tan].into_iter().flatten()), F => {
            let given = self.rows::<F>(py, x, Some(u), p, t)?;
            let read = |name, tangent: Option<&Bound<'py, PyAny>>, width| {
                tangent.map(|tangent| Argument::<F>::matrix(name, tangent, given.count, width)).transpose()
            };
            let tangents = [read("x_tan", x_tan, self.n)?, read("u_tan", u_tan, self.m)?, read("p_tan", p_tan, self.params)?];
            let tangents = tangents.each_ref().map(|tangent| tangent.as_ref().map(Argument::per_row));
            given.matrix(py, self.n, |inputs, rows, next_tan| {
                let [x, u, p] = tangents.map(|tangent| tangent.map(|tangent| tangent.of(rows)));
                rows::step_jvp(&self.task, inputs, Tangents { x, u, p }, next_tan);
            })
        })
    }

    /// Observations, (B, observation_dim), of states `x`, (B, n).
    #[pyo3(signature = (x, p=None, t=0))]
    fn observe<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        p: Option<&Bound<'py, PyAny>>,
        #[pyo3(from_py_with = whole::t)] t: usize,
    ) -> PyResult<Bound<'py, PyAny>> {
        with_precision!(is_f32([x].into_iter().chain(p)), F => {
            let given = self.rows::<F>(py, x, None, p, t)?;
            given.matrix(py, self.observed(), |inputs, _, y| rows::observe(&self.task, inputs, y))
        })
    }

    /// Products of `y_bar`, (B, observation_dim), with the transposed Jacobians of `observe`.
    ///
    /// Returns `(x_bar, p_bar)`, of the shapes of x and p.
    #[pyo3(signature = (x, y_bar, p=None, t=0))]
    fn observe_vjp<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        y_bar: &Bound<'py, PyAny>,
        p: Option<&Bound<'py, PyAny>>,
        #[pyo3(from_py_with = whole::t)] t: usize,
    ) -> PyResult<Bound<'py, PyTuple>> {
        with_precision!(is_f32([x, y_bar].into_iter().chain(p)), F => {
            let given = self.rows::<F>(py, x, None, p, t)?;
            let y_bar = Argument::<F>::matrix("y_bar", y_bar, given.count, self.observed())?;
            let y_bar = y_bar.per_row();
            given.matrices(py, [self.n, self.params], |inputs, rows, bars| {
                rows::observe_vjp(&self.task, inputs, y_bar.of(rows), bars);
            })
        })
    }

    /// Running costs, (B,), of steps from `x`, (B, n), with `u`, (B, m), to `next`, (B, n).
    #[pyo3(signature = (x, u, next, p=None, t=0))]
    fn running_cost<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        u: &Bound<'py, PyAny>,
        next: &Bound<'py, PyAny>,
        p: Option<&Bound<'py, PyAny>>,
        #[pyo3(from_py_with = whole::t)] t: usize,
    ) -> PyResult<Bound<'py, PyAny>> {
        with_precision!(is_f32([x, u, next].into_iter().chain(p)), F => {
            let given = self.rows::<F>(py, x, Some(u), p, t)?;
            let next = Argument::<F>::matrix("next", next, given.count, self.n)?;
            let next = next.per_row();
            given.vector(py, |inputs, rows, cost| rows::running_cost(&self.task, inputs, next.of(rows), cost))
        })
    }

    /// Gradients of the running costs, multiplied by `cost_bar`, (B,).
    ///
    /// Returns `(x_bar, u_bar, next_bar, p_bar)`, of the shapes of x, u, next and p.
    #[pyo3(signature = (x, u, next, cost_bar, p=None, t=0))]
    fn running_cost_vjp<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        u: &Bound<'py, PyAny>,
        next: &Bound<'py, PyAny>,
        cost_bar: &Bound<'py, PyAny>,
        p: Option<&Bound<'py, PyAny>>,
        #[pyo3(from_py_with = whole::t)] t: usize,
    ) -> PyResult<Bound<'py, PyTuple>> {
        with_precision!(is_f32([x, u, next, cost_bar].into_iter().chain(p)), F => {
            let given = self.rows::<F>(py, x, Some(u), p, t)?;
            let next = Argument::<F>::matrix("next", next, given.count, self.n)?;
            let cost_bar = Argument::<F>::vector("cost_bar", cost_bar, given.count)?;
            let (next, cost_bar) = (next.per_row(), cost_bar.per_row());
            given.matrices(py, [self.n, self.m, self.n, self.params], |inputs, rows, bars| {
                rows::running_cost_vjp(&self.task, inputs, next.of(rows), cost_bar.of(rows), bars);
            })
        })
    }

    /// Terminal costs, (B,), of the last states `x`, (B, n).
    #[pyo3(signature = (x, p=None))]
    fn terminal_cost<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        p: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        with_precision!(is_f32([x].into_iter().chain(p)), F => {
            let given = self.rows::<F>(py, x, None, p, 0)?;
            given.vector(py, |Inputs { x, p, .. }, _, cost| rows::terminal_cost(&self.task, x, p, cost))
        })
    }

    /// Gradients of the terminal costs, multiplied by `cost_bar`, (B,).
    ///
    /// Returns `(x_bar, p_bar)`, of the shapes of x and p.
    #[pyo3(signature = (x, cost_bar, p=None))]
    fn terminal_cost_vjp<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        cost_bar: &Bound<'py, PyAny>,
        p: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyTuple>> {
        with_precision!(is_f32([x, cost_bar].into_iter().chain(p)), F => {
            let given = self.rows::<F>(py, x, None, p, 0)?;
            let cost_bar = Argument::<F>::vector("cost_bar", cost_bar, given.count)?;
            let cost_bar = cost_bar.per_row();
            given.matrices(py, [self.n, self.params], |Inputs { x, p, .. }, rows, bars| {
                rows::terminal_cost_vjp(&self.task, x, p, cost_bar.of(rows), bars);
            })
        })
    }

    /// Next states, their observations and the running costs, of states `x`, (B, n), and controls
    /// `u`, (B, m): `step`, `observe` and `running_cost` in one call.
    ///
    /// Returns `(next, y, cost)`, of shapes (B, n), (B, observation_dim) and (B,). The observation
    /// is that of step t + 1, with the parameters `p` of this step.
    #[pyo3(signature = (x, u, p=None, t=0))]
    fn transition<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        u: &Bound<'py, PyAny>,
        p: Option<&Bound<'py, PyAny>>,
        #[pyo3(from_py_with = whole::t)] t: usize,
    ) -> PyResult<Bound<'py, PyTuple>> {
        with_precision!(is_f32([x, u].into_iter().chain(p)), F => {
            let given = self.rows::<F>(py, x, Some(u), p, t)?;
            let found = given.matrices(py, [self.n, self.observed(), 1], |inputs, _, outputs| {
                rows::transition(&self.task, inputs, outputs);
            })?;
            let cost = found.get_item(2)?.cast::<PyArrayDyn<F>>()?.reshape([given.count])?;
            PyTuple::new(py, [found.get_item(0)?, found.get_item(1)?, cost.into_any()])
        })
    }

    /// The products of `next_bar`, (B, n), `y_bar`, (B, observation_dim), and `cost_bar`, (B,), with
    /// the transposed Jacobian of `transition`. `next` are its next states.
    ///
    /// Returns `(x_bar, u_bar, p_bar)`, of the shapes of x, u and p.
    #[pyo3(signature = (x, u, next, next_bar, y_bar, cost_bar, p=None, t=0))]
    fn transition_vjp<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        u: &Bound<'py, PyAny>,
        next: &Bound<'py, PyAny>,
        next_bar: &Bound<'py, PyAny>,
        y_bar: &Bound<'py, PyAny>,
        cost_bar: &Bound<'py, PyAny>,
        p: Option<&Bound<'py, PyAny>>,
        #[pyo3(from_py_with = whole::t)] t: usize,
    ) -> PyResult<Bound<'py, PyTuple>> {
        with_precision!(is_f32([x, u, next, next_bar, y_bar, cost_bar].into_iter().chain(p)), F => {
            let given = self.rows::<F>(py, x, Some(u), p, t)?;
            let next = Argument::<F>::matrix("next", next, given.count, self.n)?;
            let next_bar = Argument::<F>::matrix("next_bar", next_bar, given.count, self.n)?;
            let y_bar = Argument::<F>::matrix("y_bar", y_bar, given.count, self.observed())?;
            let cost_bar = Argument::<F>::vector("cost_bar", cost_bar, given.count)?;
            let next = next.per_row();
            let outputs = [next_bar.per_row(), y_bar.per_row(), cost_bar.per_row()];
            given.matrices(py, [self.n, self.m, self.params], |inputs, rows, bars| {
                let outputs = outputs.map(|bar| bar.of(rows));
                rows::transition_vjp(&self.task, inputs, next.of(rows), outputs, bars);
            })
        })
    }
}

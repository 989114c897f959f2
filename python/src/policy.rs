//! [`Policy`]: a policy with its parameters.

use crate::arrays::{Argument, any_shape, array, is_f32, read_only, with_precision};
use crate::errors::{check_regular, fits, invalid, runtime_error, value_error, wrong_type};
use crate::interrupt::{in_parts, interruptible};
use crate::lists::List;
use crate::settings::keywords;
use crate::task::{TOP, Task};
use crate::whole;
use numpy::{IntoPyArray, PyArray1};
use physgrad::Field;
use physgrad_cli::api;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard};

/// The policy of a task, with its parameters θ.
///
/// `Policy(task, seed=0, **settings)` has random parameters. A training with this seed starts from
/// them, unless the task has an initial policy. Keyword arguments are settings of the section
/// `policy`. `physgrad.Mlp` has an argument for the widths of the hidden layers.
#[pyclass(frozen, module = "physgrad")]
pub struct Policy {
    policy: Mutex<api::Policy>,
    /// True for a copy of the policy of a run, which refuses changes: they would not reach the run.
    of_run: bool,
}

impl Policy {
    pub fn new(policy: api::Policy) -> Self {
        Self { policy: Mutex::new(policy), of_run: false }
    }

    /// Copy of the policy of a run.
    pub fn of_run(policy: api::Policy) -> Self {
        Self { of_run: true, ..Self::new(policy) }
    }

    pub fn lock(&self) -> MutexGuard<'_, api::Policy> {
        self.policy.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    fn check_changeable(&self) -> PyResult<()> {
        if self.of_run {
            return Err(wrong_type(
                "the policy of a run refuses changes, which would not reach the run; change `run.policy.copy()`, and train it \
                 with `physgrad.train(task, policy)`",
            ));
        }
        Ok(())
    }
}

#[pymethods]
impl Policy {
    #[new]
    #[pyo3(signature = (task, seed=0, **settings))]
    fn random(
        task: &Task,
        #[pyo3(from_py_with = whole::seed)] seed: u64,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let scene = task.scene.with(keywords(settings, "policy", &TOP)?).map_err(value_error)?;
        Ok(Self::new(api::Policy::new(&scene, seed)))
    }

    /// A copy of the parameters θ, float64, which refuses assignments to its elements. Assign to
    /// `theta` to replace all parameters. The last entries determine the trained numbers of the
    /// task, if any.
    #[getter]
    fn theta<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        read_only(self.lock().theta().to_vec().into_pyarray(py))
    }

    /// Values of the trained numbers by their keys, a dict: gains of a controller of equations, and
    /// numbers of the task, in their units. Empty for networks.
    #[getter]
    fn numbers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        let numbers = self.lock().numbers();
        numbers.into_iter().try_for_each(|(name, value)| dict.set_item(name, value))?;
        Ok(dict)
    }

    #[setter]
    fn set_theta(&self, theta: &Bound<'_, PyAny>) -> PyResult<()> {
        self.check_changeable()?;
        let count = self.lock().theta().len();
        let theta = any_shape::<f64>("theta", theta, count)?.to_vec()?;
        self.lock().set_theta(theta).map_err(value_error)
    }

    /// The task of the policy, with its settings in the section `policy`.
    #[getter]
    fn task(&self) -> Task {
        Task::new(self.lock().scene().clone())
    }

    /// Controls, (B, m), for observations `y`, (B, observation_dim). Only for policies without a
    /// memory.
    fn __call__<'py>(&self, py: Python<'py>, y: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let policy = self.lock().clone();
        let scene = policy.scene();
        with_precision!(is_f32([y]), F => {
            let (y, count) = Argument::<F>::first("y", y, scene.observation_names().len())?;
            let (y, m) = (y.per_row(), scene.dims()[1]);
            fits("the controls", &[count, m], size_of::<F>())?;
            let mut u = Ok(Vec::<F>::with_capacity(count * m));
            in_parts(py, count, 64, |rows| {
                if let Ok(done) = &mut u {
                    match policy.act(y.of(&rows)) {
                        Ok(more) => done.extend(more),
                        Err(error) => u = Err(error),
                    }
                }
            })?;
            Ok(array(py, u.map_err(value_error)?, &[count, m])?.into_any())
        })
    }

    /// Writes a policy file in the safetensors format.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let bytes = self.lock().safetensors().map_err(runtime_error)?;
        py.detach(|| replace_file(&path, &bytes))
    }

    /// Replaces the parameters by those of a policy file. The tensors of the network must have the
    /// names and shapes of this policy. If file and policy have trained numbers, their names and
    /// bounds must be equal. Without trained numbers in the file, those of this policy get their
    /// initial values. Raises `ValueError` if the path is no file, for example a pipe, or if the
    /// file is larger than one of this policy can be. Ctrl-C raises `KeyboardInterrupt`.
    fn load(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        self.check_changeable()?;
        check_regular(&path)?;
        let policy = self.lock().clone();
        let (shown, most) = (path.display().to_string(), policy.most_bytes());
        let read = interruptible(py, move |_| {
            let bytes = api::read_file(&path, most)
                .map_err(|error| with_path(PyErr::from(error), &path))?
                .ok_or_else(|| {
                    invalid(format!(
                        "{} has more than {most} bytes, the limit of a file of this policy",
                        path.display()
                    ))
                })?;
            PyResult::Ok(api::Policy::read(policy.scene(), &bytes))
        })??;
        *self.lock() = read.map_err(|error| value_error(error.context(shown)))?;
        Ok(())
    }

    /// A copy, which accepts changes.
    fn copy(&self) -> Self {
        Self::new(self.lock().clone())
    }

    /// The policy of a pickle.
    #[staticmethod]
    #[pyo3(name = "_of_theta")]
    fn of_theta(task: &Task, theta: Vec<f64>, of_run: bool) -> PyResult<Self> {
        let mut policy = api::Policy::new(&task.scene, 0);
        policy.set_theta(theta).map_err(value_error)?;
        Ok(Self { of_run, ..Self::new(policy) })
    }

    /// Pickles and copies are made from the settings and the parameters.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let policy = self.lock().clone();
        let restore = py.get_type::<Self>().getattr("_of_theta")?;
        let task = self.task();
        let theta = policy.theta().to_vec();
        let arguments = (task, theta, self.of_run).into_pyobject(py)?;
        PyTuple::new(py, [restore, arguments.into_any()])
    }

    /// Policies are equal if their settings and parameters are.
    fn __eq__(&self, other: &Self) -> bool {
        // One lock at a time, since both may be the same policy.
        let own = self.lock().clone();
        let other = other.lock().clone();
        own.scene().text() == other.scene().text() && own.theta() == other.theta()
    }

    /// A policy whose parameters change keeps its hash.
    fn __hash__(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        self.lock().scene().text().hash(&mut hasher);
        hasher.finish()
    }

    fn __len__(&self) -> usize {
        self.lock().theta().len()
    }

    fn __repr__(&self) -> String {
        let policy = self.lock();
        format!(
            "<physgrad.Policy {} for {}: {} parameters>",
            policy.kind(),
            policy.scene().name(),
            policy.theta().len()
        )
    }
}

/// An error of the file system with the path in its message.
pub fn with_path(error: PyErr, path: &Path) -> PyErr {
    Python::attach(|py| {
        let text = format!("{}: {}", path.display(), error.value(py));
        PyErr::from_type(error.get_type(py), api::plain(&text).into_owned())
    })
}

/// Rollouts of a policy from initial states `starts`, (B, start_dim).
///
/// Returns the states, (B, T+1, n), the initial state first, and the controls, (B, T, m), in the
/// dtype of `starts`. Raises `Divergence` if a number is not finite, and `MemoryError` if the
/// rollouts do not fit into memory. Ctrl-C raises `KeyboardInterrupt`.
#[pyfunction]
pub fn rollout<'py>(
    py: Python<'py>,
    task: &Task,
    policy: &Policy,
    starts: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyTuple>> {
    let policy = policy.lock().clone();
    let [n, m, _] = task.scene.dims();
    with_precision!(is_f32([starts]), F => {
        let (starts, b) = Argument::<F>::first("starts", starts, task.width)?;
        task.check_starts(starts.slice())?;
        let (starts, scene) = (starts.to_vec()?, task.scene.clone());
        let found = interruptible(py, move |stop| policy.rollouts::<F>(&scene, &starts, stop))?.map_err(value_error)?;
        let horizon = task.scene.horizon();
        let x = array(py, found.states, &[b, horizon + 1, n])?.into_any();
        PyTuple::new(py, [x, array(py, found.controls, &[b, horizon, m])?.into_any()])
    })
}

/// Losses, (B,), of rollouts from initial states `starts`, (B, start_dim): the sum of the running
/// costs and the terminal cost. Raises `Divergence` if a number is not finite. Ctrl-C raises
/// `KeyboardInterrupt`.
#[pyfunction]
pub fn losses<'py>(
    py: Python<'py>,
    task: &Task,
    policy: &Policy,
    starts: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let policy = policy.lock().clone();
    with_precision!(is_f32([starts]), F => {
        let (starts, b) = Argument::<F>::first("starts", starts, task.width)?;
        task.check_starts(starts.slice())?;
        let (starts, scene) = (starts.to_vec()?, task.scene.clone());
        let losses = interruptible(py, move |stop| policy.losses::<F>(&scene, &starts, stop))?.map_err(value_error)?;
        Ok(array(py, losses, &[b])?.into_any())
    })
}

/// Vector fields of the mean loss of rollouts from `starts`, (B, start_dim), B ≥ 1. All fields
/// share the forward passes.
///
/// Returns a dict from the names in `fields` to vectors over the parameters. Fields are "R", "M",
/// "N", "S", "C", "P", "F", "MR" and "RM"; by default R, M, S and C. R is the gradient of the mean
/// loss. Raises `Divergence` if a number is not finite, and `MemoryError` if the blocks of 32 rollouts of all threads do not
/// fit into memory.
/// Ctrl-C raises `KeyboardInterrupt`.
#[pyfunction]
#[pyo3(signature = (task, policy, starts, fields=None))]
pub fn gradients<'py>(
    py: Python<'py>,
    task: &Task,
    policy: &Policy,
    starts: &Bound<'py, PyAny>,
    fields: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let policy = policy.lock().clone();
    let names = List {
        name: "fields",
        most: (Field::ALL.len(), "the number of fields"),
        of: "names of fields",
    };
    let fields = match fields {
        Some(fields) => names.read(fields, |name| name.extract::<String>())?,
        None => ["R", "M", "S", "C"].map(str::to_owned).to_vec(),
    };
    let parse = |name: &String| name.parse::<Field>().map_err(|error| invalid(error.to_string()));
    let chosen = fields.iter().map(parse).collect::<PyResult<Vec<Field>>>()?;
    with_precision!(is_f32([starts]), F => {
        let (starts, b) = Argument::<F>::first("starts", starts, task.width)?;
        task.check_starts(starts.slice())?;
        if b == 0 {
            return Err(invalid("`starts` has no rows; a mean loss needs at least one"));
        }
        let (starts, scene) = (starts.to_vec()?, task.scene.clone());
        let vectors = interruptible(py, move |stop| policy.gradients::<F>(&scene, &starts, &chosen, stop))?;
        let vectors = vectors.map_err(value_error)?;
        let dict = PyDict::new(py);
        for (name, vector) in fields.into_iter().zip(vectors) {
            dict.set_item(name, vector.into_pyarray(py))?;
        }
        Ok(dict)
    })
}

/// Replaces a file as a whole, by a temporary file beside it. Refuses a link, a device and a folder.
pub fn replace_file(path: &Path, bytes: &[u8]) -> PyResult<()> {
    api::write_file(path, bytes).map_err(value_error)
}

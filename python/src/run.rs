//! [`Run`]: a training.

use crate::arrays::dict_of_vectors;
use crate::errors::{caught, invalid, runtime_error, value_error, wrong_type};
use crate::interrupt::{POLL, interruptible};
use crate::policy::{Policy, replace_file};
use crate::settings::{Settings, is_same, keywords};
use crate::task::{TOP, Task};
use crate::threads;
use crate::whole;
use physgrad::train::{Record, Warning};
use physgrad_cli::api::{self, EpochEvent, Observer};
use pyo3::exceptions::{PyRuntimeError, PyRuntimeWarning};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyTuple};
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

/// A training of a policy. `physgrad.train` creates and completes a run, and `physgrad.load` opens
/// the folder of a run.
///
/// `Run(task, policy=None, threads=None, **settings)` is a training before its first epoch.
/// Settings outside of sections, such as `field`, `epochs` and `seed`, are keyword arguments. Other
/// keyword arguments are settings of the section `training`, as in `learning_rate=3e-4`. `threads`
/// is the number of threads; results do not depend on it.
#[pyclass(frozen, module = "physgrad")]
pub struct Run(Arc<Mutex<api::Run>>);

impl Run {
    fn of(run: anyhow::Result<api::Run>) -> PyResult<Self> {
        run.map(|run| Self(Arc::new(Mutex::new(run)))).map_err(value_error)
    }

    fn lock(&self) -> PyResult<MutexGuard<'_, api::Run>> {
        lock(&self.0)
    }
}

/// Refuses settings of the policy that differ from those of the given one, which a training keeps.
fn check_policy_settings(settings: &Settings, scene: &api::Scene) -> PyResult<()> {
    for (key, value) in settings {
        // The task refuses None.
        let Some(value) = value else { continue };
        let own = match &**key {
            "initial_policy" => None,
            key if key.starts_with("policy.") => scene.setting(key),
            _ => continue,
        };
        if own.as_ref().is_none_or(|own| !is_same(own, value)) {
            let own = own.map_or_else(|| "another value".to_owned(), |own| own.to_string());
            return Err(invalid(format!(
                "`{key}` is {value}, but the given policy has {own}; create the policy with this setting, or omit `policy`"
            )));
        }
    }
    Ok(())
}

fn lock(run: &Mutex<api::Run>) -> PyResult<MutexGuard<'_, api::Run>> {
    use std::sync::TryLockError;
    match run.try_lock() {
        Ok(run) => Ok(run),
        Err(TryLockError::Poisoned(poisoned)) => Ok(poisoned.into_inner()),
        Err(TryLockError::WouldBlock) => Err(PyRuntimeError::new_err(
            "the run is in use by another call; wait for its end, or use the callback's argument",
        )),
    }
}

#[pymethods]
impl Run {
    #[new]
    #[pyo3(signature = (task, policy=None, threads=None, **settings))]
    fn new(
        py: Python<'_>,
        task: &Task,
        policy: Option<&Policy>,
        #[pyo3(from_py_with = whole::threads)] threads: Option<usize>,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let threads = threads
            .map_or_else(threads::number, |threads| threads::checked("`threads`", threads))?;
        let settings = keywords(settings, "training", &TOP)?;
        let policy = policy.map(|policy| policy.lock().clone());
        if let Some(policy) = &policy {
            check_policy_settings(&settings, policy.scene())?;
        }
        let scene = task.scene.with(settings).map_err(value_error)?;
        Self::of(interruptible(py, move |_| api::Run::new(&scene, policy.as_ref(), threads))?)
    }

    /// Opens the run in a folder, at its last checkpoint.
    #[staticmethod]
    fn load(py: Python<'_>, folder: PathBuf) -> PyResult<Self> {
        let threads = threads::number()?;
        Self::of(interruptible(py, move |_| api::Run::load(&folder, threads))?)
    }

    /// The run of a pickle.
    #[staticmethod]
    #[pyo3(name = "_of_checkpoint")]
    fn of_checkpoint(py: Python<'_>, task: &Task, checkpoint: Vec<u8>) -> PyResult<Self> {
        let (scene, threads) = (task.scene.clone(), threads::number()?);
        Self::of(interruptible(py, move |_| api::Run::restored(&scene, &checkpoint, threads))?)
    }

    /// Pickles and copies are made from the settings and the checkpoint. They have no folder.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let run = self.lock()?;
        let restore = py.get_type::<Self>().getattr("_of_checkpoint")?;
        let checkpoint = PyBytes::new(py, &run.checkpoint());
        let arguments = (Task::new(run.scene().clone()), checkpoint).into_pyobject(py)?;
        PyTuple::new(py, [restore, arguments.into_any()])
    }

    /// Runs are equal if their settings and checkpoints are.
    fn __eq__(&self, other: &Self) -> PyResult<bool> {
        if Arc::ptr_eq(&self.0, &other.0) {
            return Ok(true);
        }
        let (own, other) = (self.lock()?, other.lock()?);
        let is_same = |a: &api::Run, b: &api::Run| {
            a.scene().text() == b.scene().text() && a.checkpoint() == b.checkpoint()
        };
        Ok(is_same(&own, &other))
    }

    /// A run that trains keeps its hash.
    fn __hash__(&self) -> PyResult<u64> {
        let mut hasher = DefaultHasher::new();
        self.lock()?.scene().text().hash(&mut hasher);
        Ok(hasher.finish())
    }

    /// Trains up to the last epoch.
    ///
    /// Calls `callback` with the record of every epoch, a dict; if it returns False, the training stops
    /// after this epoch. `epochs` changes the total number
    /// of epochs. Ctrl-C raises `KeyboardInterrupt` after the current update. The next call of
    /// `train` continues, with the bits of an uninterrupted training. A run with a folder saves
    /// there every few seconds and at the end. Raises `Divergence` after more than `max_skipped`
    /// consecutive skipped updates, and otherwise `RuntimeError` if the run ends without an update.
    #[pyo3(signature = (callback=None, epochs=None))]
    fn train(
        &self,
        py: Python<'_>,
        callback: Option<Bound<'_, PyAny>>,
        #[pyo3(from_py_with = whole::epochs)] epochs: Option<u64>,
    ) -> PyResult<()> {
        if let Some(callback) = callback.as_ref().filter(|callback| !callback.is_callable()) {
            let kind = callback.get_type().name()?;
            return Err(wrong_type(format!(
                "`callback` is of type {kind}; allowed: a function of the record of an epoch"
            )));
        }
        let callback = callback.map(Bound::unbind);
        threads::ready()?;
        let mut run = self.lock()?;
        let run = &mut *run;
        if let Some(epochs) = epochs {
            py.detach(|| caught(|| run.set_epochs(epochs)))?.map_err(value_error)?;
        }
        let mut watcher = Watcher { callback, error: None, is_done: false, warned: Vec::new() };
        let observer = &mut watcher;
        let outcome = py.detach(|| caught(move || run.train(observer)))?;
        match watcher.error {
            Some(error) => Err(error),
            None => outcome.map(drop).map_err(runtime_error),
        }
    }

    /// Numbers of every epoch, a dict of float64 arrays that refuse assignments. The keys are "epoch", "loss",
    /// "train_loss", "test_loss", "grad_norm", "cosine", "kept", "first_order", "skipped",
    /// "seconds", "growth_R" and "growth_M" (decades over a rollout), "length" (mean steps of the episodes
    /// of the test set), "value_error" and "explained" (of a value function). Missing numbers are NaN.
    #[getter]
    fn history<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let run = self.lock()?;
        let column = |(i, name): (usize, &&str)| {
            ((*name).to_owned(), run.records().iter().map(|record| row(record)[i]).collect())
        };
        dict_of_vectors(py, COLUMNS.iter().enumerate().map(column))
    }

    /// The policy with the current parameters: those after the last completed epoch, or after the
    /// last update if Ctrl-C interrupted an epoch. A copy that refuses changes, which would not reach
    /// the run; `copy` returns one that accepts them.
    #[getter]
    fn policy(&self) -> PyResult<Policy> {
        self.lock()?.policy(false).map(Policy::of_run).map_err(runtime_error)
    }

    /// The policy after the epoch with the lowest test loss. Before the first epoch whose test loss
    /// is a number, the initial policy. A copy that refuses changes, as `policy` is.
    #[getter]
    fn best_policy(&self) -> PyResult<Policy> {
        self.lock()?.policy(true).map(Policy::of_run).map_err(runtime_error)
    }

    /// The task with all settings of the run.
    #[getter]
    fn task(&self) -> PyResult<Task> {
        Ok(Task::new(self.lock()?.scene().clone()))
    }

    /// True after the last epoch.
    #[getter]
    fn is_done(&self) -> PyResult<bool> {
        Ok(self.lock()?.is_done())
    }

    /// Folder of the run, or None.
    #[getter]
    fn folder(&self) -> PyResult<Option<PathBuf>> {
        Ok(self.lock()?.folder().map(ToOwned::to_owned))
    }

    /// Writes the run to a folder, in the format of the program. Later calls of `train` save there
    /// too. If the folder holds another run, or another state of this run, renames that folder.
    fn save(&self, py: Python<'_>, folder: PathBuf) -> PyResult<()> {
        let mut run = self.lock()?;
        let run = &mut *run;
        py.detach(|| caught(move || run.save(&folder)))?.map_err(runtime_error)
    }

    /// Writes the page of `physgrad report` to an HTML file. The run needs no folder. Ctrl-C raises
    /// `KeyboardInterrupt`; the run is then in use until the page is complete, on another thread.
    fn report(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let run = self.0.clone();
        let html = interruptible(py, move |_| lock(&run).map(|run| run.report()))??
            .map_err(runtime_error)?;
        py.detach(|| replace_file(&path, html.as_bytes()))
    }

    /// Chart of the losses by epoch, as SVG, for notebooks.
    fn _losses(&self) -> PyResult<String> {
        Ok(self.lock()?.losses())
    }

    fn __repr__(&self) -> PyResult<String> {
        let run = self.lock()?;
        Ok(format!("<physgrad.Run of {}: {} epochs>", run.scene().name(), run.records().len()))
    }
}

/// Names of the numbers of a record.
const COLUMNS: [&str; 15] = [
    "epoch",
    "loss",
    "train_loss",
    "test_loss",
    "grad_norm",
    "cosine",
    "kept",
    "first_order",
    "skipped",
    "seconds",
    "growth_R",
    "growth_M",
    "length",
    "value_error",
    "explained",
];

/// Numbers of a record, in the order of [`COLUMNS`].
fn row(record: &Record) -> [f64; 15] {
    let [growth_r, growth_m] = [record.regular_growth, record.modified_growth]
        .map(|growth| growth.map_or(f64::NAN, |growth| growth.along));
    let [cosine, kept, first_order] =
        [record.cosine, record.kept, record.first_order].map(|mean| mean.unwrap_or(f64::NAN));
    let [length, value_error, explained] =
        [record.length, record.value_error, record.explained].map(|mean| mean.unwrap_or(f64::NAN));
    let (epoch, skipped, norm) =
        (record.epoch as f64, record.skipped as f64, record.grad_norm.get());
    [
        epoch,
        record.loss,
        record.train_loss,
        record.test_loss,
        norm,
        cosine,
        kept,
        first_order,
        skipped,
        record.seconds,
        growth_r,
        growth_m,
        length,
        value_error,
        explained,
    ]
}

/// Calls the callback and checks for signals. Stops the run after an exception, or if the callback
/// returns False.
struct Watcher {
    callback: Option<Py<PyAny>>,
    error: Option<PyErr>,
    /// The callback has returned False.
    is_done: bool,
    /// Kinds of warnings that were reported, with the number of a kind that has one warning per
    /// number.
    warned: Vec<(&'static str, Option<String>)>,
}

impl Watcher {
    fn report(&mut self, py: Python<'_>, event: EpochEvent<'_>) -> PyResult<()> {
        let kind = |warning: &Warning| (warning.kind, warning.number.clone());
        for warning in event.warnings.iter().filter(|warning| !self.warned.contains(&kind(warning)))
        {
            let text =
                std::ffi::CString::new(&*api::plain(&warning.to_string())).unwrap_or_default();
            PyErr::warn(py, &py.get_type::<PyRuntimeWarning>(), &text, 1)?;
        }
        for warning in event.warnings.iter().map(kind) {
            if !self.warned.contains(&warning) {
                self.warned.push(warning);
            }
        }
        let Some(callback) = &self.callback else { return Ok(()) };
        let record = PyDict::new(py);
        for (name, value) in COLUMNS.into_iter().zip(row(event.record)) {
            match name {
                "epoch" | "skipped" => record.set_item(name, value as u64)?,
                _ => record.set_item(name, value)?,
            }
        }
        let result = callback.call1(py, (record,))?;
        self.is_done = result.extract::<bool>(py).is_ok_and(|goes_on| !goes_on);
        Ok(())
    }
}

impl Observer for Watcher {
    fn epoch(&mut self, event: EpochEvent<'_>) {
        let outcome = Python::attach(|py| self.report(py, event));
        self.error = self.error.take().or(outcome.err());
    }

    fn poll_every(&self) -> Option<Duration> {
        Some(POLL)
    }

    fn is_stopped(&mut self) -> bool {
        if self.error.is_none() {
            self.error = Python::attach(|py| py.check_signals()).err();
        }
        self.is_done || self.error.is_some()
    }
}

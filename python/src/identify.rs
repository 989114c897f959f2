//! `identify` and `check`: physical numbers from measurements, and checks of derivatives.

use crate::arrays::{Argument, array, tuple};
use crate::errors::{invalid, value_error};
use crate::interrupt::interruptible;
use crate::lists::List;
use crate::policy::Policy;
use crate::settings::{Settings, starting_at, value_of};
use crate::task::Task;
use numpy::IntoPyArray;
use physgrad::identify::{Fit, IdentifyError, Options, Segment};
use physgrad_cli::api::{self, Checked, Remarks, Scene};
use pyo3::exceptions::{PyAssertionError, PyMemoryError, PyUserWarning};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use std::collections::HashMap;
use std::ffi::CString;
use toml::Value;

/// Fits physical numbers to measured segments: pairs, or dicts with "x", "u", "t" and "p".
/// `physgrad.identify` documents arguments and result, of which this dict has the attributes. With
/// `only_starts`, fits only the initial states.
#[pyfunction]
#[pyo3(signature = (task, data, params=None, noise=None, window=10, exact_starts=false, only_starts=false))]
pub fn identify<'py>(
    py: Python<'py>,
    task: &Task,
    data: &Bound<'py, PyAny>,
    params: Option<&Bound<'py, PyAny>>,
    noise: Option<&Bound<'py, PyAny>>,
    window: usize,
    exact_starts: bool,
    only_starts: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let unknowns = params.map_or(Ok(Vec::new()), |params| unknowns(task, params))?;
    let order: Vec<String> = unknowns.iter().map(|(key, _)| key.clone()).collect();
    let scene = task.scene.with(unknowns).and_then(|scene| scene.without_sensor());
    let scene = scene.map_err(value_error)?;
    let segments = List {
        name: "data",
        most: (scene.most_rows(), "which take 1 GB with one row each"),
        of: "pairs or dicts of arrays",
    };
    let data = segments.read(data, Ok)?;
    let deviations = List {
        name: "noise",
        most: (scene.dims()[0], "one standard deviation for each state"),
        of: "numbers",
    };
    let deviation = |deviation: Bound<'py, PyAny>| deviation.extract::<f64>();
    let noise = noise.map(|noise| deviations.read(noise, deviation)).transpose()?;
    check_memory(&scene, &data)?;
    let segments = data
        .iter()
        .enumerate()
        .map(|(i, data)| segment(&scene, i, data))
        .collect::<PyResult<Vec<_>>>()?;
    let problem = scene.clone();
    let fit = interruptible(py, move |stop| {
        let options = Options {
            noise,
            free_starts: !exact_starts,
            window: (window > 0).then_some(window),
            stop: Some(stop.clone()),
            ..Options::default()
        };
        let fit = match only_starts {
            true => scene.fit_starts(&segments, &options),
            false => scene.identify(&segments, &options),
        };
        fit.map(|fit| {
            let fit = ordered(fit, &order);
            let remarks = scene.remarks(&fit, &segments, options.noise.is_some());
            (fit, remarks, segments)
        })
    })?;
    let (fit, remarks, segments) = fit.map_err(|error| refusal(&problem, error))?;
    for warning in &remarks.warnings {
        let text = CString::new(&*api::plain(warning)).unwrap_or_default();
        // The place of the warning is the call of the Python function.
        PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 2)?;
    }
    dict_of(py, &problem, fit, remarks, &segments)
}

/// The exception for an error of a fit, in terms of the arguments.
fn refusal(scene: &Scene, error: IdentifyError) -> PyErr {
    invalid(match error {
        IdentifyError::NothingUnknown => {
            "the task has no unknown numbers; name them in `params`, as in {\"system.pole_mass\": 0.2}".to_owned()
        }
        IdentifyError::MissingParam { name, .. } => {
            format!(
                "the task has the parameter `{name}`, which has no value; give a dict for each segment, as in \
                 {{\"x\": x, \"u\": u, \"p\": {{\"{name}\": 0.0}}}}, or a column `{name}`"
            )
        }
        IdentifyError::MissingStart { segment, component } => format!(
            "segment {segment}: the first row lacks {}, but `exact_starts` takes it as the exact initial state; begin at a \
             complete row, or omit `exact_starts`",
            scene.state_names()[component]
        ),
        error => error.to_string(),
    })
}

/// The attributes of the result.
fn dict_of<'py>(
    py: Python<'py>,
    scene: &Scene,
    fit: Fit,
    remarks: Remarks,
    segments: &[Segment],
) -> PyResult<Bound<'py, PyDict>> {
    let result = of_numbers(py, scene, &fit)?;
    let measured = |segment: &Segment| {
        let columns: Vec<Vec<f64>> =
            (0..scene.dims()[0]).map(|i| fit.measured(i, segment)).collect();
        (0..segment.x.len()).map(|row| columns.iter().map(|column| column[row]).collect()).collect()
    };
    let measured: Vec<Vec<Vec<f64>>> = segments.iter().map(measured).collect();
    result.set_item("measured", matrices(py, measured)?)?;
    result.set_item("states", matrices(py, fit.states)?)?;
    result.set_item("chi_squared", fit.chi_squared)?;
    result.set_item("measurements", fit.measurements)?;
    result.set_item("unknowns", fit.unknowns)?;
    result.set_item("window", fit.window.unwrap_or(0))?;
    result.set_item("iterations", fit.iterations)?;
    result.set_item("simulations", fit.simulations)?;
    result.set_item("jacobians", fit.jacobians)?;
    result.set_item("converged", fit.converged)?;
    result.set_item("undetermined", fit.undetermined)?;
    result.set_item("undetermined_starts", fit.undetermined_starts)?;
    result.set_item("at_bound", fit.at_bound)?;
    result.set_item("notes", remarks.notes)?;
    result.set_item("warnings", remarks.warnings)?;
    Ok(result)
}

/// What a fit knows about its numbers, by name.
fn of_numbers<'py>(py: Python<'py>, scene: &Scene, fit: &Fit) -> PyResult<Bound<'py, PyDict>> {
    let [values, errors, statuses, starts, bounds] = [(); 5].map(|()| PyDict::new(py));
    for (i, name) in fit.names.iter().enumerate() {
        values.set_item(name, fit.values[i])?;
        errors.set_item(name, fit.errors[i])?;
        statuses.set_item(name, fit.statuses[i].name())?;
        let setting = scene.setting(name);
        let of = |key: &str, absent: f64| {
            let value = setting.as_ref().and_then(|setting| setting.get(key));
            let integer = || value.and_then(Value::as_integer).map(|value| value as f64);
            value.and_then(Value::as_float).or_else(integer).unwrap_or(absent)
        };
        starts.set_item(name, of("start", f64::NAN))?;
        bounds.set_item(name, (of("min", f64::NEG_INFINITY), of("max", f64::INFINITY)))?;
    }
    let (count, result) = (fit.names.len(), PyDict::new(py));
    result.set_item("values", values)?;
    result.set_item("errors", errors)?;
    result.set_item("statuses", statuses)?;
    result.set_item("starts", starts)?;
    result.set_item("bounds", bounds)?;
    result.set_item("correlations", array(py, fit.correlations.concat(), &[count, count])?)?;
    result.set_item("robust_errors", fit.robust_errors.clone().into_pyarray(py))?;
    Ok(result)
}

/// A list of matrices from their rows.
fn matrices(py: Python<'_>, all: Vec<Vec<Vec<f64>>>) -> PyResult<Bound<'_, PyList>> {
    let matrix = |rows: Vec<Vec<f64>>| {
        let shape = [rows.len(), rows.first().map_or(0, Vec::len)];
        array(py, rows.concat(), &shape)
    };
    PyList::new(py, all.into_iter().map(matrix).collect::<PyResult<Vec<_>>>()?)
}

/// The fit with its numbers in the order of these keys. Numbers without a key follow in the order
/// of the task.
fn ordered(fit: Fit, keys: &[String]) -> Fit {
    let mut places = HashMap::new();
    for (place, key) in keys.iter().enumerate() {
        places.entry(&**key).or_insert(place);
    }
    let place = |name: &String| places.get(&**name).copied().unwrap_or(keys.len());
    let mut order: Vec<usize> = (0..fit.names.len()).collect();
    order.sort_by_key(|&i| place(&fit.names[i]));
    let numbers = |of: &[f64]| order.iter().map(|&i| of[i]).collect::<Vec<_>>();
    let sorted = |mut names: Vec<String>| {
        names.sort_by_key(place);
        names
    };
    Fit {
        names: order.iter().map(|&i| fit.names[i].clone()).collect(),
        values: numbers(&fit.values),
        statuses: order.iter().map(|&i| fit.statuses[i]).collect(),
        errors: numbers(&fit.errors),
        robust_errors: numbers(&fit.robust_errors),
        correlations: order.iter().map(|&i| numbers(&fit.correlations[i])).collect(),
        undetermined: fit.undetermined.into_iter().map(sorted).collect(),
        at_bound: sorted(fit.at_bound),
        ..fit
    }
}

/// Settings that make numbers of the task unknown.
pub fn unknowns(task: &Task, params: &Bound<'_, PyAny>) -> PyResult<Settings> {
    if let Ok(starts) = params.cast::<PyDict>() {
        let unknown = |(key, value): (Bound<'_, PyAny>, Bound<'_, PyAny>)| {
            let key = task.scene.key(key.extract()?);
            let value = value_of(&key, &value)?;
            let is_of_model = task.scene.has_model_numbers() && key.starts_with("system.");
            if (is_of_model || !key.contains('.')) && task.scene.number(&key).is_none() {
                return Err(no_number(&task.scene, &key));
            }
            if value.as_table().is_some_and(|table| !table.contains_key("start")) {
                return Err(invalid(format!(
                    "`params`: the dict of `{key}` has no \"start\", the initial value"
                )));
            }
            let value = if value.is_table() { value } else { starting_at(value) };
            Ok((key.clone(), Some(with_bounds_of(task.scene.setting(&key), value))))
        };
        return starts.iter().map(unknown).collect();
    }
    let unknown = |key: String| match task.scene.number(&key) {
        Some(value @ (Value::Float(_) | Value::Integer(_))) => Ok((key, Some(starting_at(value)))),
        Some(Value::Table(table)) if table.contains_key("start") => {
            Ok((key, Some(Value::Table(table))))
        }
        Some(_) => Err(invalid(format!(
            "`{key}` is no single number in the task; give an initial value, as in params={{\"{key}\": 0.2}}"
        ))),
        None => Err(no_number(&task.scene, &key)),
    };
    let keys = List {
        name: "params",
        most: (
            leaves(&Value::Table(task.scene.settings())) + task.scene.number_names().len(),
            "the number of settings of the task",
        ),
        of: "keys, or a dict with initial values",
    };
    keys.read(params, |key| unknown(task.scene.key(key.extract()?)))
}

/// The error of a key in `params` that the task does not have.
fn no_number(scene: &Scene, key: &str) -> PyErr {
    let names = scene.number_names();
    let hint = api::did_you_mean(key, names.iter().map(String::as_str));
    invalid(format!(
        "`params`: the task has no number `{key}`; numbers of its system: {}{hint}",
        nearest(key, &names).join(", ")
    ))
}

/// The names that a misspelt key may mean: all, unless they are many, as those of a robot. Then those
/// of the same body, joint or actuator, or else those with the same last word.
fn nearest(key: &str, names: &[String]) -> Vec<String> {
    const MANY: usize = 20;
    let (part, last) = key.rsplit_once('.').unwrap_or(("", key));
    let of_part = |name: &&String| name.rsplit_once('.').is_some_and(|(of, _)| of == part);
    let of_kind = |name: &&String| name.rsplit_once('.').is_some_and(|(_, word)| word == last);
    let chosen = |keep: &dyn Fn(&&String) -> bool| -> Vec<String> {
        names.iter().filter(|name| keep(name)).cloned().collect()
    };
    let lists = [chosen(&of_part), chosen(&of_kind)];
    let list = lists.into_iter().find(|list| names.len() > MANY && !list.is_empty());
    list.unwrap_or_else(|| names.to_vec())
}

/// Number of single values in a value.
fn leaves(value: &Value) -> usize {
    match value {
        Value::Table(table) => table.values().map(leaves).sum(),
        Value::Array(list) => list.iter().map(leaves).sum(),
        _ => 1,
    }
}

/// A table with an initial value, and with the bounds of the setting if it has none of its own.
fn with_bounds_of(setting: Option<Value>, mut value: Value) -> Value {
    let bounds =
        setting.as_ref().and_then(Value::as_table).filter(|known| known.contains_key("start"));
    if let (Some(known), Some(table)) = (bounds, value.as_table_mut()) {
        for (key, bound) in known.iter().filter(|(key, _)| ["min", "max"].contains(&key.as_str())) {
            table.entry(key.clone()).or_insert_with(|| bound.clone());
        }
    }
    value
}

/// Distance of a time from the nearest step that counts as rounding, relative to the time step.
const OFF_GRID: f64 = 1e-3;

/// Refuses segments that do not fit into memory together, before anything is copied. Segments that
/// are no pair or dict of arrays are refused later.
fn check_memory(scene: &Scene, data: &[Bound<'_, PyAny>]) -> PyResult<()> {
    let rows = |data: &Bound<'_, PyAny>| -> PyResult<usize> {
        match data.cast::<PyDict>() {
            Ok(dict) => dict.get_item("x")?.map_or(Ok(0), |x| x.len()),
            Err(_) => data.get_item(0)?.len(),
        }
    };
    let each = data.iter().map(|data| rows(data).unwrap_or(0).max(1));
    let (rows, most) = (each.fold(0_usize, usize::saturating_add), scene.most_rows());
    if rows > most {
        return Err(PyMemoryError::new_err(format!(
            "the segments have {rows} rows in total; allowed: {most}, which take 1 GB; pass fewer rows, or a task with a longer \
             time step"
        )));
    }
    scene.fits_rows(rows).map_err(|error| PyMemoryError::new_err(error.to_string()))
}

/// A measured segment, from a pair or a dict.
fn segment(scene: &Scene, i: usize, data: &Bound<'_, PyAny>) -> PyResult<Segment> {
    let [n, m, _] = scene.dims();
    let Ok(dict) = data.cast::<PyDict>() else {
        let (x, u): (Bound<'_, PyAny>, Bound<'_, PyAny>) = data.extract()?;
        let [x, u] = states_and_controls(i, [&x, &u], [n, m])?;
        return Ok(Segment { x, u, ..Segment::default() });
    };
    for key in dict.keys() {
        let key: String = key.extract()?;
        if !["x", "u", "t", "p"].contains(&&*key) {
            return Err(invalid(format!(
                "segment {i} has the key {key:?}; allowed: \"x\", \"u\", \"t\" and \"p\""
            )));
        }
    }
    let matrix = |key: &str| {
        dict.get_item(key)?.ok_or_else(|| invalid(format!("segment {i} has no {key:?}")))
    };
    let [x, u] = states_and_controls(i, [&matrix("x")?, &matrix("u")?], [n, m])?;
    let names = scene.param_names();
    let mut p = vec![f64::NAN; names.len()];
    for (name, value) in dict
        .get_item("p")?
        .map(|p| p.extract::<HashMap<String, f64>>())
        .transpose()?
        .unwrap_or_default()
    {
        let place = names.iter().position(|known| *known == name).ok_or_else(|| {
            invalid(format!(
                "segment {i}: {name:?} in \"p\" is no parameter of the task; allowed: {}",
                names.join(", ")
            ))
        })?;
        if value.is_nan() {
            return Err(invalid(format!(
                "segment {i}: {name:?} in \"p\" is NaN; give its value, or omit it for the nominal value of the task"
            )));
        }
        p[place] = value;
    }
    scene.check_params(&p).map_err(|error| invalid(format!("segment {i}: {error}")))?;
    let t = dict.get_item("t")?.map_or(Ok(0.0), |t| t.extract::<f64>())?;
    let step = t / scene.dt();
    if !step.is_finite() || step.abs() > 9e15 {
        return Err(invalid(format!("segment {i}: \"t\" is {t}; allowed: finite times in s")));
    }
    let segment = Segment { x, u, p, first_step: step.round().max(0.0) as usize };
    let is_step = (step - step.round()).abs() < OFF_GRID && step.round() >= 0.0;
    if !is_step && scene.depends_on_time(&segment) {
        return Err(invalid(format!(
            "segment {i}: \"t\" is {t} s, but the physics depends on time and has steps of {} s from 0; begin at a step",
            scene.dt()
        )));
    }
    Ok(segment)
}

/// Rows of the states and of the controls of a segment. NaN marks a missing state.
fn states_and_controls(
    segment: usize,
    objects: [&Bound<'_, PyAny>; 2],
    widths: [usize; 2],
) -> PyResult<[Vec<Vec<f64>>; 2]> {
    let [x, u] = objects;
    let x = rows("states", segment, x, widths[0], &|_| true)?;
    let count = x.len();
    let u = rows("controls", segment, u, widths[1], &|found| found == count || found + 1 == count)?;
    let kinds = [
        ("states", &x, "finite numbers, and NaN for a missing one"),
        ("controls", &u, "finite numbers"),
    ];
    for (name, rows, allowed) in kinds {
        for (row, numbers) in rows.iter().enumerate() {
            let is_bad = |y: &f64| y.is_infinite() || (y.is_nan() && name == "controls");
            if let Some(column) = numbers.iter().position(is_bad) {
                let found = numbers[column];
                return Err(invalid(format!(
                    "{name} of segment {segment}: row {row} has {found} in column {column}; allowed: {allowed}"
                )));
            }
        }
    }
    Ok([x, u])
}

/// Rows of a matrix, a number that `is_allowed`.
fn rows(
    name: &str,
    segment: usize,
    object: &Bound<'_, PyAny>,
    width: usize,
    is_allowed: &dyn Fn(usize) -> bool,
) -> PyResult<Vec<Vec<f64>>> {
    let name = format!("{name} of segment {segment}");
    let array = Argument::<f64>::read(&name, object, &|shape| match *shape {
        [steps, found] if found == width && is_allowed(steps) => Ok(()),
        [steps, found] if found == width => Err(format!(
            "the {name} have {steps} rows; expected as many as the states, or one less"
        )),
        _ => Err(format!(
            "the {name} have the shape {}; expected (steps, {width}), without components of a sensor",
            tuple(shape)
        )),
    })?;
    // A matrix without columns has rows too.
    let row = |i: usize| array.slice()[i * width..(i + 1) * width].to_vec();
    Ok((0..array.shape()[0]).map(row).collect())
}

/// Checks the derivatives of a task and a policy against dual numbers, as `physgrad check` does.
///
/// Compares the derivatives of the system and of the policy, and the gradients of whole rollouts,
/// in f64. Rollouts have the parameters of `policy`. Without `policy`, the policy is that of the
/// task, with random parameters. Rollouts that amplify rounding errors by about 1e6 fail, although
/// all derivatives are exact.
///
/// Returns a table, and below it the notes of `physgrad check`: stability of the time step, kinks,
/// slope of the loss and jumps. If checks fail, raises `AssertionError` with all failures and the
/// notes. Raises `ValueError`
/// if the policy does not fit the task. Ctrl-C raises `KeyboardInterrupt`; the checks then run
/// until the next note on another thread.
#[pyfunction]
#[pyo3(signature = (task, policy=None))]
pub fn check(py: Python<'_>, task: &Task, policy: Option<&Policy>) -> PyResult<String> {
    let policy = policy.map(|policy| policy.lock().clone());
    let scene = task.scene.clone();
    let Checked { table, notes, failures } =
        interruptible(py, move |stop| scene.check(policy.as_ref(), stop))?.map_err(value_error)?;
    let is_ok = failures.is_empty();
    let first = if is_ok { vec![table] } else { failures };
    let text = first.into_iter().chain(notes).collect::<Vec<_>>().join("\n");
    let text = api::plain(&text).into_owned();
    if is_ok { Ok(text) } else { Err(PyAssertionError::new_err(text)) }
}

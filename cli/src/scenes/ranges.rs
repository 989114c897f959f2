//! What a task allows, in errors of its settings: ranges of whole numbers, numbers that may vary,
//! and integration methods. The validation of other values tells it.

use crate::scenes::source::find;
use crate::settings::config_error::{ConfigError, Problem};
use crate::settings::reading::flat;
use crate::settings::reading::is_number;
use crate::settings::{Method, OPTIONAL};
use crate::tasks::{self, AnyTaskSpec, is_read_by_user};
use toml::{Table, Value};

/// Adds the range of the setting to the error of a value that is not a whole number.
///
/// The check of `i64::MAX` for this setting names the range. Elements of lists have no range. Nor
/// have settings that code of the user reads, which could for example allocate as many numbers.
pub fn with_range(
    spec: &'static dyn AnyTaskSpec,
    settings: impl Fn() -> Table,
    mut error: ConfigError,
) -> ConfigError {
    let Problem::NotWhole { range, .. } = &mut error.problem else { return error };
    if is_read_by_user(spec.name(), &error.key) {
        return error;
    }
    let Some(settings) = with(settings(), &error.key, Value::Integer(i64::MAX)) else {
        return error;
    };
    if let Err(ConfigError { key, problem: Problem::Value { allowed, .. } }) = spec.scene(settings)
        && key == error.key
    {
        *range = Some(allowed);
    }
    error
}

/// Replaces the error of a setting that varies or is unknown, but cannot: lists the settings that
/// can.
pub fn with_numbers(
    spec: &'static dyn AnyTaskSpec,
    settings: impl Fn() -> Table,
    mut error: ConfigError,
) -> ConfigError {
    let (Problem::Value { found, .. } | Problem::NotWhole { found, .. }) = &error.problem else {
        return error;
    };
    let settings = settings();
    let value = find(&settings, &error.key).and_then(Value::as_table);
    let defaults = spec.defaults(&settings);
    let default = find(&defaults, &error.key).filter(|value| !value.is_table());
    let (true, Some(_), Some(default)) =
        (found == "a section", value.filter(|value| is_number(value)), default)
    else {
        return error;
    };
    let Some(settings) = with(settings.clone(), &error.key, default.clone()) else { return error };
    let varies = |(key, value): &(String, Value)| {
        let choice = Value::Array(vec![value.clone()]);
        let drawn = Value::Table(Table::from_iter([("choice".to_owned(), choice)]));
        let is_physics =
            ["system", OPTIONAL[0]].contains(&key.split('.').next().unwrap_or_default());
        let is_plain = value.is_float() || value.is_integer();
        let varied = || with(settings.clone(), key, drawn);
        is_physics && is_plain && varied().is_some_and(|settings| spec.scene(settings).is_ok())
    };
    let numbers = flat(&settings).into_iter().filter(varies).map(|(key, _)| key);
    let mut what = match &numbers.collect::<Vec<_>>().join("`, `")[..] {
        "" => "cannot vary and cannot be fitted, nor can another setting of this scene".to_owned(),
        numbers => format!("cannot vary and cannot be fitted; settings that can: `{numbers}`"),
    };
    if tasks::own().iter().any(|own| own.name() == spec.name()) {
        what += " (fields of the type `Number` that `System::numbers` lists)";
    }
    error.problem = Problem::Other(what);
    error
}

/// Lists only the methods of the task in the error of an unknown integration method.
pub fn with_methods(
    spec: &'static dyn AnyTaskSpec,
    settings: impl Fn() -> Table,
    mut error: ConfigError,
) -> ConfigError {
    if error.key != "integrator.method" {
        return error;
    }
    // At least one of these is no method of the task.
    let refusal = [Method::Pade, Method::Euler].into_iter().find_map(|method| {
        let settings = with(settings(), &error.key, Value::String(method.name().into()))?;
        spec.scene(settings).err().filter(|refusal| refusal.key == error.key)
    });
    if let (
        Problem::Value { allowed, .. },
        Some(ConfigError { problem: Problem::Value { allowed: of_task, .. }, .. }),
    ) = (&mut error.problem, refusal)
    {
        *allowed = of_task;
    }
    error
}

/// The settings with another value of a key that is present.
fn with(mut settings: Table, key: &str, value: Value) -> Option<Table> {
    let (sections, name) = key.rsplit_once('.').unwrap_or(("", key));
    let mut names = sections.split('.').filter(|name| !name.is_empty());
    let section = names.try_fold(&mut settings, |table, name| table.get_mut(name)?.as_table_mut());
    *section?.get_mut(name)? = value;
    Some(settings)
}

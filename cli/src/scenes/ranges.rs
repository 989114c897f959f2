//! Allowed ranges in errors of settings that must be whole numbers.

use crate::settings::config_error::{ConfigError, Problem};
use crate::tasks::{AnyTaskSpec, is_read_by_user};
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
    let mut settings = settings();
    let (sections, name) = error.key.rsplit_once('.').unwrap_or(("", &error.key));
    let mut names = sections.split('.').filter(|name| !name.is_empty());
    let section = names.try_fold(&mut settings, |table, name| table.get_mut(name)?.as_table_mut());
    let Some(section) = section.filter(|section| section.contains_key(name)) else { return error };
    section.insert(name.to_owned(), Value::Integer(i64::MAX));
    if let Err(ConfigError { key, problem: Problem::Value { allowed, .. } }) = spec.scene(settings)
        && key == error.key
    {
        *range = Some(allowed);
    }
    error
}

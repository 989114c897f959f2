//! Allowed ranges in errors of settings that must be whole numbers.

use crate::settings::config_error::{ConfigError, WHOLE_NUMBER};
use crate::tasks::{AnyTaskSpec, is_read_by_user};
use toml::{Table, Value};

/// Replaces the range of the type in an error by the range of the setting, if the setting should be
/// a whole number.
///
/// Validates the settings with `i64::MAX` for this setting: the resulting error names the range.
/// Elements of lists keep the range of the type. So do settings that code of the user reads, which
/// could for example allocate as many numbers.
pub fn with_range(
    spec: &'static dyn AnyTaskSpec,
    settings: impl Fn() -> Table,
    mut error: ConfigError,
) -> ConfigError {
    let Some(found) = error.what.strip_suffix(WHOLE_NUMBER).map(str::to_owned) else {
        return error;
    };
    if is_read_by_user(spec.name(), &error.key) {
        return error;
    }
    let mut settings = settings();
    let (sections, name) = error.key.rsplit_once('.').unwrap_or(("", &error.key));
    let mut names = sections.split('.').filter(|name| !name.is_empty());
    let section = names.try_fold(&mut settings, |table, name| table.get_mut(name)?.as_table_mut());
    let Some(section) = section.filter(|section| section.contains_key(name)) else { return error };
    section.insert(name.to_owned(), Value::Integer(i64::MAX));
    if let Err(of_largest) = spec.scene(settings)
        && of_largest.key == error.key
        && let Some((_, range)) = of_largest.what.split_once("; allowed: ")
    {
        error.what = format!("{found}a whole number, {range}");
    }
    error
}

//! [`check_numbers`]: settings of a user's system or effect, compared with its list of numbers.

use crate::settings::config_error::ConfigError;
use crate::settings::reading::is_number;
use physgrad::Numbers;
use physgrad::number::Varied;
use toml::{Table, Value};

/// Owner of the numbers.
pub struct Owner<'a> {
    /// Section of the settings, for example `system`.
    pub section: &'a str,
    /// Method that lists the numbers, for example `System::numbers`.
    pub method: &'static str,
}

impl Owner<'_> {
    /// Checks that all settings are finite, also those in lists and in nested sections. Checks that
    /// `varied` lists each number that varies exactly once, by the name of its field. Checks that
    /// each listed number equals the field of the same name, if there is one.
    pub fn check_numbers(
        &self,
        settings: &Table,
        numbers: Numbers<'_>,
        varied: &[Varied],
    ) -> Result<(), ConfigError> {
        settings.iter().try_for_each(|(name, value)| self.check(name, value, varied))?;
        for (name, number) in numbers.listed() {
            let value = Value::try_from(*number).expect("a number is a plain value");
            if settings.get(name).is_some_and(|found| *found != value) {
                let method = self.method;
                let what = format!(
                    "is another number than `{name}` of `{method}`; list each number by the name of its field"
                );
                return Err(ConfigError::new(self.key(name), what));
            }
        }
        Ok(())
    }

    /// Checks the value of one field, or of an element or a field within it.
    fn check(&self, name: &str, value: &Value, varied: &[Varied]) -> Result<(), ConfigError> {
        match value {
            Value::Float(number) if !number.is_finite() => {
                Err(ConfigError::invalid(&self.key(name), Some(value), "a finite number"))
            }
            Value::Table(table) if is_number(table) => {
                let (count, method) =
                    (varied.iter().filter(|varied| varied.name == name).count(), self.method);
                if count == 1 {
                    return Ok(());
                }
                let what = format!(
                    "varies, but `{method}` lists it {count} times; list each number once, by the name of its field"
                );
                Err(ConfigError::new(self.key(name), what))
            }
            Value::Table(table) => table
                .iter()
                .try_for_each(|(key, value)| self.check(&format!("{name}.{key}"), value, varied)),
            Value::Array(list) => list
                .iter()
                .enumerate()
                .try_for_each(|(i, value)| self.check(&format!("{name}[{i}]"), value, varied)),
            _ => Ok(()),
        }
    }

    fn key(&self, name: &str) -> String {
        format!("{}.{name}", self.section)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use physgrad::Number;

    #[test]
    fn forgotten_swapped_and_non_finite_numbers_are_refused() {
        let check = |settings: &str, numbers: Numbers<'_>| {
            let settings = settings.parse().expect("a table");
            let owner = Owner { section: "system", method: "System::numbers" };
            owner
                .check_numbers(&settings, numbers, &numbers.placed(0))
                .map_err(|error| error.to_string())
        };
        let [one, two, drawn] = [1.0.into(), 2.0.into(), Number::Uniform { low: 0.5, high: 1.5 }];
        let fixed = Numbers::new([("mass", &one), ("length", &two)]);
        let varied = Numbers::new([("mass", &drawn), ("length", &two)]);
        assert_eq!(check("mass = 1.0\nlength = 2.0", fixed), Ok(()));
        assert_eq!(check("mass = { uniform = [0.5, 1.5] }\nlength = 2.0", varied), Ok(()));
        assert_eq!(
            check("motor.mass = { uniform = [0.5, 1.5] }", Numbers::new([("motor.mass", &drawn)])),
            Ok(())
        );
        let swapped = Numbers::new([("length", &one), ("mass", &two)]);
        for (settings, numbers, message) in [
            ("mass = 1.0\nlength = 2.0", swapped, "`system.length` is another number"),
            ("mass = { uniform = [0.5, 1.5] }", fixed, "`system.mass` varies, but"),
            (
                "mass = { uniform = [0.5, 1.5] }",
                Numbers::default(),
                "varies, but `System::numbers` lists it 0 times",
            ),
            ("motor.mass = { uniform = [0.5, 1.5] }", varied, "`system.motor.mass` varies, but"),
            ("mass = nan", fixed, "`system.mass` is NaN; allowed: a finite number"),
            ("gains = [1.0, inf]", fixed, "`system.gains[1]` is inf; allowed: a finite number"),
        ] {
            let error = check(settings, numbers).expect_err("refused");
            assert!(error.contains(message), "{error}");
        }
    }
}

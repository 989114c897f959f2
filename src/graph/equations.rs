//! [`Equations`]: a system as names, numbers and expressions, and its functions as graphs.

use super::function::Function;
use super::lexer::names;
use super::op::Id;
use super::parse::{OPERATIONS, name_problem, short};
use super::reader::{P, Reader, TIME, U, Vocabulary, X, listed};
use crate::dynamics::number::Number;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap, HashSet};

/// A system of equations. Its fields are the settings of a scene.
///
/// # Expressions
/// Numbers; names of states, controls, parameters, tables and definitions; `t`, the time in s;
/// `dt`, the time step; `pi`. Operators are `+ - * / ^`, where `**` is the same as `^`. Their order of evaluation is
/// that of Python. Functions are `sin cos tan asin acos atan atan2(y, x) sinh cosh tanh exp log
/// sqrt abs sign min(a, b) max(a, b) clip(a, low, high) hypot(a, b) wrap(angle) pow(a, b)
/// where(condition, a, b) detach(a)`. Conditions compare by `< <= > >=`, with `and`, `or` and `not`.
/// `detach` drops the derivative, and `wrap` returns an angle between -π and π.
///
/// A whole exponent is repeated multiplication. `min`, `max` and `clip` of NaN are NaN; at equality
/// they have the derivative of the second argument, or of the only one that is not a constant.
/// Derivatives at singular points are those of [`Scalar`](crate::Scalar).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Equations {
    /// Names of the state components.
    pub states: Vec<String>,
    /// Names of the control components.
    pub controls: Vec<String>,
    /// Time step, s.
    pub dt: f64,
    /// States that are angles in rad.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub angles: Vec<String>,
    /// Smallest and largest value of controls, by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub bounds: BTreeMap<String, [f64; 2]>,
    /// Units of states, controls, parameters and tables, by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub units: BTreeMap<String, String>,
    /// Numbers by name: constants, or drawn for each sample, or trained.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub parameters: BTreeMap<String, Number>,
    /// Initial values of states, by name: constants, or drawn for each sample. 0 if absent.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub start: BTreeMap<String, Number>,
    /// Values over time, by name: one per step, and the last one afterwards.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub tables: BTreeMap<String, Vec<f64>>,
    /// Expressions by name, for use in all other expressions.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub define: BTreeMap<String, String>,
    /// Derivative of each state with respect to time, for an integrator. Either `rate` or `next`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub rate: BTreeMap<String, String>,
    /// Each state after one step. Either `rate` or `next`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub next: BTreeMap<String, String>,
    /// What the policy observes. Default: the states.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub observe: Vec<String>,
}

/// Costs as expressions. An empty expression is no cost.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Costs {
    /// Cost of each step. `next.NAME` is a state after the step.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub running: String,
    /// Cost of the final state.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub terminal: String,
    /// Condition of the state that ends an episode, for example `z < 0.7`. Later costs are 0.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub end: String,
}

/// Why equations are not a system.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("`{key}` {what}")]
pub struct EquationError {
    /// Key of the setting, for example `rate.h1`; that of a cost begins with `loss`.
    pub key: String,
    /// What is wrong, as text after the key.
    pub what: String,
    /// A name that is unknown, and the known ones, for suggestions.
    pub unknown: Option<(String, Vec<String>)>,
}

impl EquationError {
    pub(super) fn new(key: impl Into<String>, what: impl Into<String>) -> Self {
        Self { key: key.into(), what: what.into(), unknown: None }
    }
}

/// Largest number of names in a list, which bounds the memory of equations that somebody else wrote.
pub(super) const NAMES: usize = 4096;
/// Largest size of all equations and tables, in bytes.
pub(super) const TEXT: usize = 500_000;

/// Names of the lists that no text uses. Omits lists without such names.
pub(super) fn unused<'a, const N: usize>(
    texts: impl Iterator<Item = &'a String>,
    lists: [(&'static str, Vec<&'a String>); N],
) -> Vec<(&'static str, Vec<&'a str>)> {
    let used: HashSet<&str> = texts.flat_map(|text| names(text)).collect();
    let unused = lists.map(|(section, list)| {
        let names = list.into_iter().map(String::as_str);
        (section, names.filter(|name| !used.contains(name)).collect::<Vec<_>>())
    });
    unused.into_iter().filter(|(_, names)| !names.is_empty()).collect()
}

/// Sentences about [`unused`] names.
pub(super) fn unused_remarks(unused: &[(&str, Vec<&str>)]) -> Vec<String> {
    let remark = |(section, names): &(&str, Vec<&str>)| {
        format!("no expression uses {} of `{section}`", listed(names.iter().copied()))
    };
    unused.iter().map(remark).collect()
}

/// Functions of the equations.
#[derive(Debug)]
pub(super) struct Functions {
    pub(super) motion: Function,
    /// Index of the velocity of each state that is a position.
    pub(super) velocities: Vec<Option<usize>>,
    pub(super) observe: Option<Function>,
    pub(super) running: Option<Function>,
    pub(super) terminal: Option<Function>,
    pub(super) margin: Option<Function>,
    pub(super) operations: Operations,
}

/// Number of operations of equations. Those of a method that discretizes rates are not among them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Operations {
    /// As written, each definition once.
    pub written: usize,
    /// Evaluated: without equal ones, those that constants simplify, and unused ones.
    pub evaluated: usize,
}

impl Equations {
    /// Returns whether the equations give rates, rather than next states.
    pub fn is_continuous(&self) -> bool {
        !self.rate.is_empty()
    }

    /// Functions of the equations and the costs.
    pub(super) fn functions(&self, costs: &Costs) -> Result<Functions, EquationError> {
        self.check_names()?;
        self.check_numbers()?;
        self.check_size(costs)?;
        let mut reader = Reader::new(self.vocabulary())?;
        let (section, motion, other) = if self.is_continuous() {
            ("rate", &self.rate, &self.next)
        } else {
            ("next", &self.next, &self.rate)
        };
        if !other.is_empty() {
            return Err(EquationError::new("next", "and `rate` are both there; keep one of them"));
        }
        self.check_keys(section, motion.keys(), &self.states, "a state")?;
        let motion: Vec<Id> = self
            .states
            .iter()
            .map(|state| {
                let key = format!("{section}.{state}");
                let Some(text) = motion.get(state) else {
                    return Err(EquationError::new(
                        key,
                        "is missing; each state needs an equation",
                    ));
                };
                reader.expression(&key, text)
            })
            .collect::<Result<_, _>>()?;
        let velocities = velocities(&motion, self.states.len());
        let motion = reader.function(section, motion, &[X, U, P, TIME])?;
        let observe = reader.observation("observe", &self.observe)?;
        let running = reader.running_cost("loss.running", &costs.running)?;
        let margin = reader.margin("loss.end", &costs.end)?;
        let terminal = reader.terminal_cost("loss.terminal", &costs.terminal)?;
        let others = [&observe, &running, &terminal, &margin].into_iter().flatten();
        let outputs = [&motion].into_iter().chain(others).flat_map(Function::outputs);
        let operations = reader.operations(outputs.copied());
        Ok(Functions { motion, velocities, observe, running, terminal, margin, operations })
    }

    /// Names that no expression uses, with their sections.
    pub fn unused<'a>(&'a self, costs: &'a Costs) -> Vec<(&'static str, Vec<&'a str>)> {
        let Self { define, rate, next, observe, .. } = self;
        let texts = define.values().chain(rate.values()).chain(next.values()).chain(observe);
        let lists = [
            ("parameters", self.parameters.keys().collect::<Vec<_>>()),
            ("tables", self.tables.keys().collect()),
            ("define", define.keys().collect()),
            ("controls", self.controls.iter().collect()),
        ];
        unused(texts.chain([&costs.running, &costs.terminal, &costs.end]), lists)
    }

    /// What is allowed but hardly meant: names that no expression uses, tables that end before the
    /// `horizon`, and no costs.
    pub fn remarks(&self, costs: &Costs, horizon: usize) -> Vec<String> {
        let mut remarks = unused_remarks(&self.unused(costs));
        for (name, values) in self.tables.iter().filter(|(_, values)| values.len() < horizon) {
            remarks.push(format!(
                "the table `{name}` has {} values for {horizon} steps; its last value holds afterwards",
                values.len()
            ));
        }
        if *costs == Costs::default() {
            remarks.push("there is no cost, so a training has nothing to minimize".into());
        }
        remarks
    }

    /// Names of the numbers in the equations.
    fn vocabulary(&self) -> Vocabulary<'_> {
        let varied = self.parameters.iter().filter(|(_, number)| !number.is_fixed());
        Vocabulary {
            states: self.states.clone(),
            controls: self.controls.clone(),
            params: varied.map(|(name, _)| name.clone()).collect(),
            tables: self.tables.keys().cloned().collect(),
            constants: self
                .parameters
                .iter()
                .filter_map(|(name, number)| match *number {
                    Number::Fixed(value) => Some((name.clone(), value)),
                    _ => None,
                })
                .collect(),
            define: &self.define,
            dt: self.dt,
            quantities: &(),
        }
    }

    fn check_names(&self) -> Result<(), EquationError> {
        let mut seen: HashMap<&str, &str> = HashMap::new();
        let lists = [
            ("states", self.states.iter().collect::<Vec<_>>()),
            ("controls", self.controls.iter().collect()),
            ("parameters", self.parameters.keys().collect()),
            ("tables", self.tables.keys().collect()),
            ("define", self.define.keys().collect()),
        ];
        for (key, list) in lists {
            let limit = if key == "define" { OPERATIONS } else { NAMES };
            if list.len() > limit {
                let what = format!("has {} names; allowed: at most {limit}", list.len());
                return Err(EquationError::new(key, what));
            }
            for name in list {
                if let Some(problem) = name_problem(name) {
                    let what = format!("has `{}`, which {problem}", short(name));
                    return Err(EquationError::new(key, what));
                }
                if let Some(other) = seen.insert(name, key) {
                    let what = format!("has `{name}`, which is also in `{other}`; rename one");
                    return Err(EquationError::new(key, what));
                }
            }
        }
        if self.states.is_empty() {
            return Err(EquationError::new("states", "is empty; name at least one state"));
        }
        if self.controls.is_empty() {
            let what = "is empty; name at least one control, which no equation has to use";
            return Err(EquationError::new("controls", what));
        }
        let numbers = [&self.states[..], &self.controls].concat();
        let tables = self.tables.keys().chain(self.parameters.keys()).cloned();
        let all: Vec<String> = numbers.into_iter().chain(tables).collect();
        self.check_keys("angles", self.angles.iter(), &self.states, "a state")?;
        self.check_keys("bounds", self.bounds.keys(), &self.controls, "a control")?;
        self.check_keys("start", self.start.keys(), &self.states, "a state")?;
        self.check_keys("units", self.units.keys(), &all, "a state, control, parameter or table")
    }

    /// Bounds the text, because a run stores it in its settings.
    fn check_size(&self, costs: &Costs) -> Result<(), EquationError> {
        let Self { define, rate, next, observe, .. } = self;
        let texts = [define, rate, next].into_iter().flatten();
        let texts = texts.flat_map(|(name, text)| [name, text]).chain(observe);
        let costs = [&costs.running, &costs.terminal, &costs.end];
        let bytes: usize = texts.chain(costs).map(String::len).sum();
        let tables: usize = self.tables.values().map(Vec::len).sum();
        if bytes + 8 * tables > TEXT {
            let what = format!(
                "has {bytes} bytes of equations and {tables} values of tables; allowed: at most {TEXT} bytes, with 8 \
                 for each value"
            );
            return Err(EquationError::new("define", what));
        }
        Ok(())
    }

    fn check_keys<'a>(
        &self,
        section: &str,
        mut keys: impl Iterator<Item = &'a String>,
        allowed: &[String],
        what: &str,
    ) -> Result<(), EquationError> {
        keys.try_for_each(|key| {
            if allowed.contains(key) {
                return Ok(());
            }
            let names = listed(allowed.iter().map(String::as_str));
            let what = format!("has `{key}`, which is not {what}; allowed: {names}");
            Err(EquationError::new(section, what))
        })
    }

    fn check_numbers(&self) -> Result<(), EquationError> {
        if !(self.dt.is_finite() && self.dt > 0.0) {
            return Err(EquationError::new(
                "dt",
                format!("is {}; allowed: a positive number", self.dt),
            ));
        }
        for (section, numbers) in [("parameters", &self.parameters), ("start", &self.start)] {
            for (name, number) in numbers {
                let key = format!("{section}.{name}");
                if let Some(value) = number.extremes().into_iter().find(|value| !value.is_finite())
                {
                    return Err(EquationError::new(
                        key,
                        format!("is {value}; allowed: a finite number"),
                    ));
                }
                if section == "start" && matches!(number, Number::Trained { .. } | Number::Noise(_))
                {
                    let what = "is trained or noise; allowed: a number or a distribution";
                    return Err(EquationError::new(key, what));
                }
            }
        }
        for (name, values) in &self.tables {
            if values.is_empty() || values.iter().any(|value| !value.is_finite()) {
                let what =
                    "is empty or has a number that is not finite; allowed: one value per step";
                return Err(EquationError::new(format!("tables.{name}"), what));
            }
        }
        for (name, [low, high]) in &self.bounds {
            if low.is_nan() || high.is_nan() || low >= high {
                let what = format!("is [{low}, {high}]; allowed: the smaller bound first");
                return Err(EquationError::new(format!("bounds.{name}"), what));
            }
        }
        Ok(())
    }
}

/// Velocities of positions: the rate of a position is a state that is no position itself.
fn velocities(rates: &[Id], states: usize) -> Vec<Option<usize>> {
    let state_of = |i: usize| {
        let of = rates[i] as usize;
        (of < states && of != i).then_some(of)
    };
    (0..states).map(|i| state_of(i).filter(|&velocity| state_of(velocity).is_none())).collect()
}

//! [`GraphPolicy`]: a controller as expressions.

use super::equations::{EquationError, NAMES, TEXT, unused, unused_remarks};
use super::function::{Function, LISTS, Lists};
use super::parse::{name_problem, short};
use super::reader::{P, Reader, TIME, Vocabulary, X, listed};
use crate::dynamics::number::Number;
use crate::numbers::pool::lend;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Float, Lane, Real, Scalar};
use crate::policy::blocks::{gather, scatter};
use crate::policy::{
    Action, Observed, Policy, PolicyPass, PolicyRecord, Sizes, Tensor, TrainedParam,
};
use serde::{Deserialize, Serialize};
use smallvec::SmallVec;
use std::collections::{BTreeMap, HashSet};
use std::sync::Arc;

/// A controller as expressions. Its fields are the settings of a scene.
///
/// Expressions are those of [`Equations`](super::Equations), of the observed components, the
/// memory, the parameters, the definitions, `t` and `dt`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Controller {
    /// Each control, by name.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub control: BTreeMap<String, String>,
    /// Memory of the controller: each number after the step, by name. It is 0 at the start.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub next: BTreeMap<String, String>,
    /// Numbers by name: constants, or trained from `start` within optional bounds.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub parameters: BTreeMap<String, Number>,
    /// Expressions by name, for use in the others.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub define: BTreeMap<String, String>,
}

impl Controller {
    /// The trained numbers, in the order of θ, with their maps from θ.
    ///
    /// # Errors
    /// A number is drawn, or is not finite.
    pub fn trained(&self) -> Result<Vec<(String, TrainedParam)>, EquationError> {
        let mut trained = Vec::new();
        for (name, number) in &self.parameters {
            let error = |what: &str| Err(EquationError::new(format!("parameters.{name}"), what));
            match *number {
                Number::Fixed(value) if value.is_finite() => {}
                Number::Trained { start, min, max } if min < start && start < max => {
                    trained.push((
                        name.clone(),
                        TrainedParam::within(trained.len(), start, [min, max]),
                    ));
                }
                Number::Fixed(_) | Number::Trained { .. } => {
                    return error("is not a finite number between its bounds");
                }
                _ => return error("is drawn; allowed: a number, or { start = value }"),
            }
        }
        Ok(trained)
    }

    /// Names that no expression uses, with their sections.
    pub fn unused(&self) -> Vec<(&'static str, Vec<&str>)> {
        let Self { control, next, parameters, define } = self;
        let lists = [
            ("parameters", parameters.keys().collect()),
            ("next", next.keys().collect()),
            ("define", define.keys().collect()),
        ];
        unused(control.values().chain(next.values()).chain(define.values()), lists)
    }

    /// Sentences about the names that no expression uses.
    pub fn remarks(&self) -> Vec<String> {
        unused_remarks(&self.unused())
    }

    fn check(&self, observations: &[String], controls: &[String]) -> Result<(), EquationError> {
        let Self { control, next, parameters, define } = self;
        if let Some(other) = control.keys().find(|name| !controls.contains(name)) {
            let names = listed(controls.iter().map(String::as_str));
            let what = format!("has `{}`, which is not a control; allowed: {names}", short(other));
            return Err(EquationError::new("control", what));
        }
        if let Some(missing) = controls.iter().find(|name| !control.contains_key(*name)) {
            let what = "is missing; each control needs an expression";
            return Err(EquationError::new(format!("control.{missing}"), what));
        }
        let mut seen: HashSet<&str> = observations.iter().map(String::as_str).collect();
        for (section, list) in
            [("next", next.keys().collect::<Vec<_>>()), ("parameters", parameters.keys().collect())]
        {
            for name in list {
                if let Some(problem) = name_problem(name) {
                    let what = format!("has `{}`, which {problem}", short(name));
                    return Err(EquationError::new(section, what));
                }
                if !seen.insert(name) {
                    let what =
                        format!("has `{name}`, which is the name of another number; rename it");
                    return Err(EquationError::new(section, what));
                }
            }
        }
        let texts = [control, next, define].into_iter().flatten();
        let bytes: usize = texts.map(|(name, text)| name.len() + text.len()).sum();
        let count = next.len() + parameters.len();
        if bytes > TEXT || count > NAMES {
            let what = format!(
                "has {bytes} bytes of expressions and {count} names; allowed: at most {TEXT} bytes and {NAMES} names"
            );
            return Err(EquationError::new("define", what));
        }
        Ok(())
    }
}

/// A [`Policy`] whose controls and next memory are expressions. θ holds its trained numbers.
///
/// ```
/// use physgrad::check;
/// use physgrad::graph::{Controller, GraphPolicy};
///
/// // Proportional and integral feedback of the error of a level.
/// let text = |name: &str, text: &str| (name.to_owned(), text.to_owned());
/// let controller = Controller {
///     control: [text("pump", "kp * e + ki * integral")].into(),
///     next: [text("integral", "integral + dt * e")].into(),
///     define: [text("e", "0.3 - level")].into(),
///     parameters: [("kp".into(), 2.0.into()), ("ki".into(), 0.1.into())].into(),
/// };
/// let policy = GraphPolicy::new(&controller, &["level".into()], &["pump".into()], 0.1)?;
/// check::policy(&policy).unwrap();
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct GraphPolicy {
    observations: usize,
    controls: usize,
    memory: usize,
    trained: Vec<(String, TrainedParam)>,
    /// Controls, then the next memory, of the observations with the memory, the trained numbers and
    /// the time.
    function: Arc<Function>,
    /// Time step, s.
    dt: f64,
}

impl GraphPolicy {
    /// The policy with these names of the observed components and of the controls. `dt` is the time
    /// step.
    ///
    /// # Errors
    /// An expression does not fit, a name is missing or occurs twice, or a number has no valid
    /// value.
    pub fn new(
        controller: &Controller,
        observations: &[String],
        controls: &[String],
        dt: f64,
    ) -> Result<Self, EquationError> {
        controller.check(observations, controls)?;
        let Controller { control, next, parameters, define } = controller;
        let trained = controller.trained()?;
        let fixed = parameters.iter().filter_map(|(name, number)| match *number {
            Number::Fixed(value) => Some((name.clone(), value)),
            _ => None,
        });
        let mut reader = Reader::new(Vocabulary {
            states: observations.iter().chain(next.keys()).cloned().collect(),
            controls: Vec::new(),
            params: trained.iter().map(|(name, _)| name.clone()).collect(),
            tables: Vec::new(),
            constants: fixed.collect(),
            dt,
            define,
            quantities: &(),
        })?;
        let mut outputs = Vec::with_capacity(controls.len() + next.len());
        for name in controls {
            outputs.push(reader.expression(&format!("control.{name}"), &control[name])?);
        }
        for (name, text) in next {
            outputs.push(reader.expression(&format!("next.{name}"), text)?);
        }
        Ok(Self {
            observations: observations.len(),
            controls: controls.len(),
            memory: next.len(),
            function: Arc::new(reader.function("control", outputs, &[X, P, TIME])?),
            trained,
            dt,
        })
    }

    fn time<T: Scalar>(&self, t: usize) -> [T; 1] {
        [T::from(t as f64 * self.dt)]
    }

    /// Values of the trained numbers from packed parameters, equal in all lanes.
    fn values<F: Float>(&self, packed: &[F]) -> SmallVec<[Lane<F>; 16]> {
        packed[..self.trained.len()].iter().map(|&value| Real::splat(value)).collect()
    }

    /// Calls `visit` with each block of columns, its step, inputs and cotangents of the outputs.
    fn each_block<F: Float>(
        &self,
        pass: PolicyPass<F>,
        u_bar: &[F],
        mut visit: impl FnMut(crate::policy::PolicyColumns, Lists<'_, Lane<F>>, &[Lane<F>]),
    ) {
        let (inputs, outputs) = (self.observations + self.memory, self.controls + self.memory);
        let values = self.values(pass.packed);
        lend(|[x, bars]: &mut [Vec<Lane<F>>; 2]| {
            for (t, at) in pass.blocks() {
                gather(pass.x, inputs, at, x);
                gather(u_bar, outputs, at, bars);
                visit(at, [x, &[], &values, &[], &self.time(t)], bars);
            }
        });
    }
}

/// Writes no cotangents of the lists.
fn none<'a, C>() -> [Option<&'a mut [C]>; LISTS - 1] {
    [const { None }; LISTS - 1]
}

impl Policy for GraphPolicy {
    fn observation_dim(&self) -> usize {
        self.observations
    }

    fn control_dim(&self) -> usize {
        self.controls
    }

    fn memory_dim(&self) -> usize {
        self.memory
    }

    fn param_count(&self) -> usize {
        self.trained.len()
    }

    fn init(&self, _rng: &mut Rng, theta: &mut [f64]) {
        for (theta, (_, number)) in theta.iter_mut().zip(&self.trained) {
            *theta = number.initial();
        }
    }

    fn act<T: Scalar>(
        &self,
        theta: &[T],
        Observed { y, memory, t }: Observed<'_, T>,
        action: Action<'_, T>,
    ) {
        let x: SmallVec<[T; 16]> = y.iter().chain(memory).copied().collect();
        let numbers = self.trained.iter().zip(theta);
        let values: SmallVec<[T; 16]> = numbers.map(|((_, n), &r)| n.value(r)).collect();
        let mut outputs: SmallVec<[T; 16]> =
            SmallVec::from_elem(T::zero(), self.controls + self.memory);
        self.function.eval([&x, &[], &values, &[], &self.time(t)], &mut outputs);
        action.u.copy_from_slice(&outputs[..self.controls]);
        action.memory.copy_from_slice(&outputs[self.controls..]);
    }

    fn tensors(&self) -> Vec<Tensor> {
        let tensor = |(i, (name, _)): (usize, &(String, TrainedParam))| Tensor {
            name: format!("parameters.{name}"),
            shape: vec![1],
            range: i..i + 1,
        };
        self.trained.iter().enumerate().map(tensor).collect()
    }

    /// `packed` holds the values of the trained numbers, then their slopes.
    fn sizes<F: Float>(&self, _columns: usize) -> Sizes {
        Sizes { packed: 2 * self.trained.len(), tape: 0, tape_bar: 0, scratch: 0 }
    }

    fn pack<F: Float>(&self, theta: &[F], packed: &mut [F]) {
        let (values, slopes) = packed.split_at_mut(self.trained.len());
        for (i, ((_, number), r)) in self.trained.iter().zip(theta).enumerate() {
            values[i] = F::from_f64(number.value(r.as_()));
            slopes[i] = F::from_f64(number.slope(r.as_()));
        }
    }

    fn forward<F: Float>(&self, pass: PolicyPass<F>, _tape: &mut [F], u: &mut [F]) {
        let values = self.values(pass.packed);
        lend(|[x, outputs]: &mut [Vec<Lane<F>>; 2]| {
            outputs.clear();
            outputs.resize(self.controls + self.memory, Lane::zero());
            for (t, at) in pass.blocks() {
                gather(pass.x, self.observations + self.memory, at, x);
                self.function.eval([x, &[], &values, &[], &self.time(t)], outputs);
                scatter(outputs, at, u);
            }
        });
    }

    fn backward<F: Float>(
        &self,
        pass: PolicyPass<F>,
        _tape: &[F],
        u_bar: &[F],
        _tape_bar: &mut [F],
        x_bar: Option<&mut [F]>,
    ) {
        let Some(x_bar) = x_bar else { return };
        let mut bars = vec![Lane::<F>::null(); self.observations + self.memory];
        self.each_block(pass, u_bar, |at, lists, u_bar| {
            bars.fill(Lane::null());
            let mut cotangents = none();
            cotangents[X] = Some(&mut bars[..]);
            self.function.vjp(lists, u_bar, cotangents);
            scatter(&bars, at, x_bar);
        });
    }

    fn param_gradient<F: Float>(
        &self,
        pass: PolicyPass<F>,
        record: PolicyRecord<F>,
        _scratch: &mut [F],
        theta_bar: &mut [F],
    ) {
        if self.trained.is_empty() {
            return;
        }
        let slopes = &pass.packed[self.trained.len()..];
        let mut bars = vec![Lane::<F>::null(); self.trained.len()];
        self.each_block(pass, record.u_bar, |at, lists, u_bar| {
            bars.fill(Lane::null());
            let mut cotangents = none();
            cotangents[P] = Some(&mut bars[..]);
            self.function.vjp(lists, u_bar, cotangents);
            for (lane, c) in at.iter().enumerate() {
                let weight = record.weight.map_or(F::one(), |weight| weight[c]);
                for (i, bar) in bars.iter().enumerate() {
                    theta_bar[i] += weight * slopes[i] * bar.lane(lane);
                }
            }
        });
    }
}

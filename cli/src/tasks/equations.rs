//! A system of equations in the scene: settings, limits and animation.

use crate::operations::trajectory::Trajectory;
use crate::platform::terminal::did_you_mean;
use crate::settings::Method;
use crate::settings::config_error::ConfigError;
use crate::settings::reading::overlay;
use crate::tasks::hard::{Nothing, in_scene};
use crate::tasks::{Settings, TaskSpec};
use physgrad::DynTask;
use physgrad::engine::Cause;
use physgrad::graph::{self, Costs, EquationError, GraphTask, Replacement};
use physgrad::integrator::{AnyIntegrator, RungeKutta};
use physgrad_plot::{Animation, Channel, channels_over_time};
use std::collections::BTreeMap;

/// Task `equations`.
#[derive(Clone, Debug)]
pub struct Equations;

/// The task of these settings.
fn graph(settings: &Settings<Equations>) -> Result<GraphTask, ConfigError> {
    let Settings { system, loss, integrator, precision, horizon, .. } = settings;
    let method = integrator.integrator(*precision);
    let method = method.unwrap_or(AnyIntegrator::RungeKutta(RungeKutta::RK4));
    GraphTask::new(system, loss, method, integrator.count(), *horizon).map_err(|error| {
        let section = if error.key.starts_with("loss.") { "" } else { "system." };
        located(section, error)
    })
}

/// The error of a setting in this section, with a suggestion for an unknown name.
pub fn located(section: &str, error: EquationError) -> ConfigError {
    let EquationError { key, what, unknown } = error;
    let hint = unknown.map_or_else(String::new, |(name, mut known)| {
        known.sort_unstable();
        did_you_mean(&name, known.iter().map(String::as_str))
    });
    ConfigError::new(format!("{section}{key}"), what + &hint)
}

/// Dotted keys of names, which are given by their sections.
pub fn keys_of(sections: Vec<(&str, Vec<&str>)>) -> Vec<String> {
    let keys = |(section, names): (&str, Vec<&str>)| -> Vec<String> {
        names.into_iter().map(|name| format!("{section}.{name}")).collect()
    };
    sections.into_iter().flat_map(keys).collect()
}

impl TaskSpec for Equations {
    type System = graph::Equations;
    type Effects = Nothing;
    type Loss = Costs;

    const NAME: &'static str = "equations";
    const ABOUT: &'static str = "a system whose equations and costs are in the scene";
    const EPOCHS: usize = 300;
    const METHODS: &'static [Method] = &Method::ODE;

    fn horizon() -> usize {
        100
    }

    /// No equations: each scene has its own.
    fn system() -> graph::Equations {
        graph::Equations::default()
    }

    fn validate(settings: &Settings<Self>) -> Result<(), ConfigError> {
        graph(settings)?;
        if settings.equations != Replacement::default() {
            let what = "is for other tasks; write `system.observe` and the expressions of `loss`";
            return Err(ConfigError::new("equations", what));
        }
        if let Some(method) = settings.integrator.method
            && !settings.system.is_continuous()
        {
            let because = "`system.next` gives the state after a step; write `system.rate`";
            return Err(ConfigError::unread("integrator.method", method.name(), because));
        }
        Ok(())
    }

    fn task(settings: &Settings<Self>) -> DynTask {
        in_scene(settings, graph(settings).expect("validated settings"))
    }

    fn variants() -> Vec<(String, Settings<Self>)> {
        let mut table = Settings::<Self>::defaults().table();
        let preset = include_str!("../scenes/presets/equations.toml");
        overlay(&mut table, &preset.parse().expect("presets are TOML"));
        vec![("two tanks".into(), Settings::fill(table).expect("presets are valid"))]
    }

    fn dt(settings: &Settings<Self>) -> f64 {
        settings.system.dt
    }

    fn state_names(settings: &Settings<Self>) -> Vec<String> {
        settings.system.states.clone()
    }

    fn angles(settings: &Settings<Self>) -> Vec<usize> {
        let graph::Equations { states, angles, .. } = &settings.system;
        (0..states.len()).filter(|&i| angles.contains(&states[i])).collect()
    }

    fn control_names(settings: &Settings<Self>) -> Vec<String> {
        settings.system.controls.clone()
    }

    fn equations(settings: &Settings<Self>) -> Vec<(String, String)> {
        let graph::Equations { rate, next, define, observe, units, .. } = &settings.system;
        let Costs { running, terminal, end } = &settings.loss;
        let unit = |name: &str| units.get(name).map_or(String::new(), |unit| format!(", {unit}"));
        let of_states = |list: &BTreeMap<String, String>, before: &str, after: &str| {
            let named = list
                .iter()
                .map(|(name, text)| (format!("{before}{name}{after}{}", unit(name)), text.clone()));
            named.collect::<Vec<_>>()
        };
        let observed = observe.iter().enumerate();
        let costs = [("running cost", running), ("terminal cost", terminal), ("end", end)];
        let costs = costs.into_iter().filter(|(_, text)| !text.is_empty());
        [
            of_states(define, "", ""),
            of_states(rate, "d ", " / dt"),
            of_states(next, "next ", ""),
            observed.map(|(i, text)| (format!("y_{}", i + 1), text.clone())).collect(),
            costs.map(|(name, text)| (name.to_owned(), text.clone())).collect(),
        ]
        .concat()
    }

    fn operations(settings: &Settings<Self>) -> Option<graph::Operations> {
        graph(settings).ok()?.operations()
    }

    fn observe(settings: &Settings<Self>) -> Vec<String> {
        settings.system.observe.clone()
    }

    fn remarks(settings: &Settings<Self>) -> Vec<String> {
        settings.system.remarks(&settings.loss, settings.horizon)
    }

    fn unused(settings: &Settings<Self>) -> Vec<String> {
        keys_of(settings.system.unused(&settings.loss))
    }

    fn expression_of(
        settings: &Settings<Self>,
        component: usize,
        cause: Option<Cause>,
    ) -> Option<String> {
        // After a step of rates, the first component that is not finite may be due to another one.
        let (section, i) = match cause {
            Some(Cause::Rate(i)) => ("rate", i),
            None if !settings.system.is_continuous() => ("next", component),
            _ => return None,
        };
        Some(format!("system.{section}.{}", settings.system.states.get(i)?))
    }

    fn animation(
        settings: &Settings<Self>,
        Trajectory { states, controls, .. }: &Trajectory,
    ) -> Animation {
        let graph::Equations { states: names, controls: inputs, units, .. } = &settings.system;
        let labels = |names: &[String]| -> Vec<String> {
            let label = |name: &String| match units.get(name) {
                Some(unit) => format!("{name}, {unit}"),
                None => name.clone(),
            };
            names.iter().map(label).collect()
        };
        let states: Vec<Vec<f64>> = states.iter().map(|x| x[..names.len()].to_vec()).collect();
        let states = Channel::columns(labels(names), &states, "#0072B2");
        let controls = Channel::columns(labels(inputs), controls, "#D55E00");
        channels_over_time(Self::ABOUT, &[states, controls].concat(), Self::dt(settings))
    }
}

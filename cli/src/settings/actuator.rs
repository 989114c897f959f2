//! The `actuator` section.

use crate::settings::Info;
use crate::settings::config_error::{ConfigError, count, positive};
use physgrad::Inputs;
use physgrad::actuator::{Actuator, AnyActuator, Delay, Lag, Limit};
use physgrad::{Actuated, System};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Transformations of the control between policy and physics, in this order: limit, delay, lag.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ActuatorSettings {
    /// Limit on the magnitude of every control.
    #[serde(skip_serializing_if = "Option::is_none")]
    limit: Option<Limit>,
    /// Delay of every control by a number of steps. The first applied controls are 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    delay: Option<Delay>,
    /// First-order lag of every control.
    #[serde(skip_serializing_if = "Option::is_none")]
    lag: Option<LagSettings>,
}

/// First-order lag.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct LagSettings {
    /// Time constant, s, positive.
    time: f64,
}

/// Documentation of every part of the actuator.
pub const ACTUATORS: [Info; 3] = [
    Info {
        name: "limit",
        equation: "u' = bound tanh(u / bound), or u clipped at ±bound",
        derivative: "analytic; smoothed or one-sided",
    },
    Info {
        name: "delay",
        equation: "u'_t = u_{t-steps}; the state contains the delayed controls",
        derivative: "analytic",
    },
    Info {
        name: "lag",
        equation: "df/dt = (u - f) / time, u' = f; the state contains f, the lagged control",
        derivative: "analytic",
    },
];

impl ActuatorSettings {
    /// Checks the ranges of all parameters.
    pub fn validate(&self) -> Result<(), ConfigError> {
        if let Some(limit) = self.limit {
            positive("actuator.limit.bound", limit.bound)?;
        }
        if let Some(delay) = self.delay {
            count("actuator.delay.steps", delay.steps, 1..=1000)?;
        }
        self.lag.map_or(Ok(()), |lag| positive("actuator.lag.time", lag.time))
    }

    /// Returns an error if a part has a state. `because` is the reason.
    pub fn without_state(&self, because: &str) -> Result<(), ConfigError> {
        let parts = [("delay", self.delay.is_some()), ("lag", self.lag.is_some())];
        match parts.into_iter().find(|(_, present)| *present) {
            Some((name, _)) => Err(ConfigError::new(
                format!("actuator.{name}"),
                format!("adds to the state, and {because}; allowed here: actuator.limit"),
            )),
            None => Ok(()),
        }
    }

    /// Returns whether all parts are absent.
    pub fn is_empty(&self) -> bool {
        self.limit.is_none() && self.delay.is_none() && self.lag.is_none()
    }

    /// Puts the actuator before a system with time step `dt`.
    pub fn wrap<S: System>(&self, system: S, dt: f64) -> Actuated<S, Vec<AnyActuator>> {
        Actuated { system, actuator: self.chain(dt) }
    }

    /// Controls that reach the physics, for these states and these controls from the policy. All
    /// lists are `[step][component]`.
    pub fn applied(&self, dt: f64, states: &[Vec<f64>], controls: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let chain = self.chain(dt);
        let step = |(state, control): (&Vec<f64>, &Vec<f64>)| {
            // The actuator's state is the last part of the state.
            let internal = &state[state.len() - chain.state_dim(control.len())..];
            let (mut internal_next, mut applied) = (internal.to_vec(), control.clone());
            chain.step(Inputs::new(internal, control), &mut internal_next, &mut applied);
            applied
        };
        states.iter().zip(controls).map(step).collect()
    }

    /// The parts, in order, for the time step `dt` of the policy.
    pub fn chain(&self, dt: f64) -> Vec<AnyActuator> {
        let limit = self.limit.map(AnyActuator::Limit);
        let delay = self.delay.map(AnyActuator::Delay);
        let lag = self.lag.map(|lag| AnyActuator::Lag(Lag::new(lag.time, dt)));
        [limit, delay, lag].into_iter().flatten().collect()
    }

    /// Names of the components that the actuator adds to the state.
    pub fn state_names(&self, controls: &[String]) -> Vec<String> {
        let delayed = (1..=self.delay.map_or(0, |delay| delay.steps)).flat_map(|step| {
            // The oldest control comes first and is applied next.
            controls.iter().map(move |control| format!("{control}_in_{step}"))
        });
        let lagged = controls
            .iter()
            .filter(|_| self.lag.is_some())
            .map(|control| format!("{control}_before"));
        delayed.chain(lagged).collect()
    }

    /// Names of the applied controls. Empty without an actuator.
    pub fn applied_names(&self, controls: &[String]) -> Vec<String> {
        controls
            .iter()
            .filter(|_| !self.is_empty())
            .map(|control| format!("{control}_applied"))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn applied_controls_pass_limit_delay_and_lag() {
        let applied = |actuator: &str, state: &[f64]| {
            let actuator: ActuatorSettings = toml::from_str(actuator).expect("settings");
            actuator.applied(0.05, &[state.to_vec()], &[vec![9.0]])[0][0]
        };
        // Components of the state: the body's, the delayed control, the lagged control.
        let share = 1.0 - (-0.5f64).exp();
        let all =
            "limit = { bound = 2.0, kind = 'hard' }\ndelay = { steps = 1 }\nlag = { time = 0.1 }";
        assert!((applied(all, &[7.0, 3.0, 1.0]) - (1.0 + 2.0 * share)).abs() < 1e-12);
        assert_eq!(applied("limit = { bound = 2.0, kind = 'hard' }", &[7.0]), 2.0);
        assert_eq!(applied("delay = { steps = 2 }", &[7.0, 3.0, 4.0]), 3.0);
        assert_eq!(applied("", &[7.0]), 9.0);
    }
}

//! The `actuator` section.

use crate::program::settings::Info;
use crate::program::settings::config_error::{ConfigError, count, positive};
use physgrad::{Actuated, Actuator, AnyActuator, Delay, Lag, Limit, System};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What stands between the policy and the physics, in this order.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ActuatorSettings {
    /// A limit on the size of every control.
    #[serde(skip_serializing_if = "Option::is_none")]
    limit: Option<Limit>,
    /// The physics gets every control some steps late, and 0 before the first.
    #[serde(skip_serializing_if = "Option::is_none")]
    delay: Option<Delay>,
    /// The physics gets what follows the control with a lag of first order.
    #[serde(skip_serializing_if = "Option::is_none")]
    lag: Option<LagSettings>,
}

/// A lag of first order.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct LagSettings {
    /// Time in which all but a share of 1/e of a step is made up, s, positive.
    time: f64,
}

/// What there is.
pub const ACTUATORS: [Info; 3] = [
    Info {
        name: "limit",
        equation: "u' = bound tanh(u / bound), or u cut off at ±bound",
        derivative: "by hand; smoothed, or one-sided",
    },
    Info { name: "delay", equation: "u'_t = u_{t-steps}; adds the controls under way to the state", derivative: "by hand" },
    Info { name: "lag", equation: "df/dt = (u - f) / time, u' = f; adds f to the state", derivative: "by hand" },
];

impl ActuatorSettings {
    /// What is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        if let Some(limit) = self.limit {
            positive("actuator.limit.bound", limit.bound)?;
        }
        if let Some(delay) = self.delay {
            count("actuator.delay.steps", delay.steps, 1..=1000)?;
        }
        self.lag.map_or(Ok(()), |lag| positive("actuator.lag.time", lag.time))
    }

    /// What adds to the state, where nothing may.
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

    /// Whether there is nothing.
    pub fn is_empty(&self) -> bool {
        self.limit.is_none() && self.delay.is_none() && self.lag.is_none()
    }

    /// A system with time steps of this length behind all of it.
    pub fn wrap<S: System>(&self, system: S, dt: f64) -> Actuated<S, Vec<AnyActuator>> {
        Actuated { system, actuator: self.chain(dt) }
    }

    /// What the physics got in place of the controls that were asked for in these states.
    pub fn applied(&self, dt: f64, states: &[Vec<f64>], controls: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let chain = self.chain(dt);
        let step = |(state, asked): (&Vec<f64>, &Vec<f64>)| {
            // Its own state comes last.
            let own = &state[state.len() - chain.state_dim(asked.len())..];
            let (mut own_next, mut applied) = (own.to_vec(), asked.clone());
            chain.step(own, asked, &mut own_next, &mut applied);
            applied
        };
        states.iter().zip(controls).map(step).collect()
    }

    fn chain(&self, dt: f64) -> Vec<AnyActuator> {
        let limit = self.limit.map(AnyActuator::Limit);
        let delay = self.delay.map(AnyActuator::Delay);
        let lag = self.lag.map(|lag| AnyActuator::Lag(Lag::new(lag.time, dt)));
        [limit, delay, lag].into_iter().flatten().collect()
    }

    /// The names of what it adds to the state.
    pub fn state_names(&self, controls: &[String]) -> Vec<String> {
        let under_way = (1..=self.delay.map_or(0, |delay| delay.steps)).flat_map(|step| {
            // The oldest comes first, and is the next to leave.
            controls.iter().map(move |control| format!("{control}_in_{step}"))
        });
        let lagging = controls.iter().filter(|_| self.lag.is_some()).map(|control| format!("{control}_before"));
        under_way.chain(lagging).collect()
    }

    /// The names of the controls that the physics gets, where they are not those that the policy asks for.
    pub fn applied_names(&self, controls: &[String]) -> Vec<String> {
        controls.iter().filter(|_| !self.is_empty()).map(|control| format!("{control}_felt")).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_felt_has_gone_through_all_of_it() {
        let applied = |actuator: &str, state: &[f64]| {
            let actuator: ActuatorSettings = toml::from_str(actuator).expect("settings");
            actuator.applied(0.05, &[state.to_vec()], &[vec![9.0]])[0][0]
        };
        // The body's own state comes first, then the control under way and the one that lags behind.
        let share = 1.0 - (-0.5f64).exp();
        let all = "limit = { bound = 2.0, kind = 'hard' }\ndelay = { steps = 1 }\nlag = { time = 0.1 }";
        assert!((applied(all, &[7.0, 3.0, 1.0]) - (1.0 + 2.0 * share)).abs() < 1e-12);
        assert_eq!(applied("limit = { bound = 2.0, kind = 'hard' }", &[7.0]), 2.0);
        assert_eq!(applied("delay = { steps = 2 }", &[7.0, 3.0, 4.0]), 3.0);
        assert_eq!(applied("", &[7.0]), 9.0);
    }
}

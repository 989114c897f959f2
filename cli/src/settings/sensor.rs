//! The `sensor` section.

use crate::settings::Info;
use crate::settings::config_error::{ConfigError, count, not_negative, positive};
use physgrad::Number;
use physgrad::sensor::Sensor;
use schemars::JsonSchema;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

/// Sensors between the observation of the task and the policy, in this order: lag, bias, noise,
/// sampling, delay.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SensorSettings {
    /// First-order lag of every observed component.
    #[serde(skip_serializing_if = "Option::is_none")]
    lag: Option<LagSettings>,
    /// Constant error of the observed components.
    #[serde(skip_serializing_if = "Option::is_none")]
    bias: Option<BiasSettings>,
    /// Normal noise of the observed components, drawn in every step.
    #[serde(skip_serializing_if = "Option::is_none")]
    noise: Option<NoiseSettings>,
    /// Measurements at every so many steps; the sensor holds the last one.
    #[serde(skip_serializing_if = "Option::is_none")]
    sampling: Option<Steps>,
    /// Delay of every observed component by a number of steps. The first measurement is that of the
    /// initial state.
    #[serde(skip_serializing_if = "Option::is_none")]
    delay: Option<Delay>,
}

/// First-order lag.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct LagSettings {
    /// Time constant, s, positive.
    time: f64,
}

/// Constant error.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct BiasSettings {
    /// A number or a distribution for all components, or a list with one for each.
    value: PerComponent<Number>,
}

/// Normal noise.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct NoiseSettings {
    /// Standard deviation of all components, or a list with one for each.
    deviation: PerComponent<f64>,
}

/// A number of steps.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Steps {
    /// Number of steps, at least 1.
    steps: usize,
}

/// A delay.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Delay {
    /// Number of steps, 0 for none.
    steps: usize,
}

/// One value for all components, or a list with one value for each.
#[derive(Clone, Debug, Serialize, JsonSchema)]
#[serde(untagged)]
enum PerComponent<T> {
    /// Value of all components.
    All(T),
    /// Values of the components.
    Each(Vec<T>),
}

impl<'de, T: for<'a> Deserialize<'a>> Deserialize<'de> for PerComponent<T> {
    /// The error is that of a value, not that of a choice between both forms.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = toml::Value::deserialize(deserializer)?;
        let error = |error: toml::de::Error| D::Error::custom(error.message());
        if value.is_array() {
            value.try_into().map(Self::Each).map_err(error)
        } else {
            value.try_into().map(Self::All).map_err(error)
        }
    }
}

impl<T: Clone> PerComponent<T> {
    fn of(&self, observed: usize) -> Vec<T> {
        match self {
            Self::All(value) => vec![value.clone(); observed],
            Self::Each(values) => values.clone(),
        }
    }

    fn values(&self) -> &[T] {
        match self {
            Self::All(value) => std::slice::from_ref(value),
            Self::Each(values) => values,
        }
    }
}

/// Documentation of every part of the sensor.
pub const SENSORS: [Info; 5] = [
    Info {
        name: "lag",
        equation: "df/dt = (y - f) / time, y' = f; exact for an observation that is linear between two steps",
        derivative: "analytic",
    },
    Info { name: "bias", equation: "y' = y + value", derivative: "analytic" },
    Info {
        name: "noise",
        equation: "y' = y + deviation w; w is normal, and drawn anew in each step",
        derivative: "analytic",
    },
    Info {
        name: "sampling",
        equation: "y'_t = y_s with s = t - t mod steps; the state contains the last measurement",
        derivative: "analytic",
    },
    Info {
        name: "delay",
        equation: "y'_t = y_{t-steps}, from y_0; the state contains the delayed observations",
        derivative: "analytic",
    },
];

impl SensorSettings {
    /// The first part whose output depends on earlier steps.
    pub fn remembers(&self) -> Option<&'static str> {
        let parts = [
            ("lag", self.lag.is_some()),
            ("sampling", self.sampling.is_some()),
            ("delay", self.delay.is_some()),
        ];
        parts.into_iter().find_map(|(name, is_present)| is_present.then_some(name))
    }

    /// Checks the ranges of all parameters.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let Self { lag, bias, noise, sampling, delay } = self;
        if let Some(lag) = lag {
            positive("sensor.lag.time", lag.time)?;
        }
        for value in bias.iter().flat_map(|bias| bias.value.values()) {
            let what = match value {
                Number::Trained { .. } => "is trained; allowed: a number or a distribution",
                Number::Noise(_) => {
                    "is noise; allowed: a number or a distribution, and sensor.noise"
                }
                _ => "",
            };
            if !what.is_empty() {
                return Err(ConfigError::new("sensor.bias.value", what));
            }
            if value.extremes().iter().any(|value| !value.is_finite()) {
                let what = "is not finite; allowed: a finite number";
                return Err(ConfigError::new("sensor.bias.value", what));
            }
        }
        let lists = [
            ("bias.value", bias.as_ref().map(|bias| bias.value.values().len())),
            ("noise.deviation", noise.as_ref().map(|noise| noise.deviation.values().len())),
        ];
        if let Some((list, _)) = lists.into_iter().find(|(_, len)| *len == Some(0)) {
            let what = "is empty; allowed: one value, or one for each observed component";
            return Err(ConfigError::new(format!("sensor.{list}"), what));
        }
        for &deviation in noise.iter().flat_map(|noise| noise.deviation.values()) {
            not_negative("sensor.noise.deviation", deviation)?;
        }
        if let Some(Steps { steps }) = *sampling {
            count("sensor.sampling.steps", steps, 1..=1_000_000)?;
        }
        delay.map_or(Ok(()), |delay| count("sensor.delay.steps", delay.steps, 0..=1000))
    }

    /// Returns whether all parts are absent.
    pub fn is_empty(&self) -> bool {
        let Self { lag, bias, noise, sampling, delay } = self;
        lag.is_none() && bias.is_none() && noise.is_none() && sampling.is_none() && delay.is_none()
    }

    /// The sensor of a task with this number of observed components and this time step in s.
    pub fn sensor(&self, observed: usize, dt: f64) -> Sensor {
        let Self { lag, bias, noise, sampling, delay } = self;
        Sensor {
            lag: lag.map_or(0.0, |lag| lag.time / dt),
            bias: bias.as_ref().map_or_else(Vec::new, |bias| bias.value.of(observed)),
            noise: noise.as_ref().map_or_else(Vec::new, |noise| noise.deviation.of(observed)),
            sampling: sampling.map_or(1, |sampling| sampling.steps),
            delay: delay.map_or(0, |delay| delay.steps),
        }
    }

    /// Names of the components that the sensor adds to the state, for the names of the observed
    /// components.
    pub fn state_names(&self, observed: &[String]) -> Vec<String> {
        let lagged = self.lag.map(|_| "lagged".to_owned());
        let is_held = self.sampling.is_some_and(|sampling| sampling.steps > 1);
        let held = is_held.then(|| "held".to_owned());
        // The oldest observation comes first and is seen next.
        let delay = self.delay.map_or(0, |delay| delay.steps);
        let late = (1..=delay).rev().map(|age| format!("{age}_ago"));
        let kinds = lagged.into_iter().chain(held).chain(late);
        kinds.flat_map(|kind| observed.iter().map(move |name| format!("{name}_{kind}"))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_value_is_for_all_components_and_a_list_for_each() {
        let sensor = |text: &str| -> Result<SensorSettings, String> {
            toml::from_str(text).map_err(|error: toml::de::Error| error.message().to_owned())
        };
        let of = |text: &str| sensor(text).expect("settings").sensor(2, 0.1);
        assert_eq!(of("noise = { deviation = 0.5 }").noise, [0.5, 0.5]);
        assert_eq!(of("noise = { deviation = [1, 0] }").noise, [1.0, 0.0]);
        let bias = of("bias = { value = [0.1, { normal = [0, 1] }] }").bias;
        assert_eq!(bias[0], Number::Fixed(0.1));
        assert!(matches!(bias[1], Number::Normal { .. }));
        let error = sensor("bias = { value = { normal = [0, -1] } }").expect_err("negative");
        assert!(error.contains("with a deviation of 0 or more"), "{error}");
        assert!((of("lag = { time = 0.3 }").lag - 3.0).abs() < 1e-12);
    }

    #[test]
    fn names_of_memories_have_the_order_of_the_state() {
        let names = |text: &str| -> Vec<String> {
            let settings: SensorSettings = toml::from_str(text).expect("settings");
            settings.state_names(&["a".into(), "b".into()])
        };
        let all = "delay = { steps = 2 }\nlag = { time = 1 }\nsampling = { steps = 2 }";
        let expected = [
            "a_lagged", "b_lagged", "a_held", "b_held", "a_2_ago", "b_2_ago", "a_1_ago", "b_1_ago",
        ];
        assert_eq!(names(all), expected);
        assert!(names("sampling = { steps = 1 }\nnoise = { deviation = 1 }").is_empty());
    }
}

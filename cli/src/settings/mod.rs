//! Sections of a scene that all tasks share, and errors in settings.
//!
//! Imports no other part of the program. Start with `training`.

mod actuator;
pub mod config_error;
mod integrator;
mod joined;
mod names;
pub mod reading;
mod sensor;
mod training;
mod window;

pub use actuator::{ACTUATORS, ActuatorSettings};
pub use integrator::{IntegratorSettings, Method};
pub use joined::Joined;
pub use names::{
    ClipName, DecayName, EstimatorName, FieldName, LogFormat, OptimizerName, Precision,
};
pub use sensor::{SENSORS, SensorSettings};
pub use training::TrainingSettings;
pub use window::WindowSettings;

/// Version of the scene format.
pub const VERSION: i64 = 1;

/// Sections whose subsections may be absent.
pub const OPTIONAL: [&str; 3] = ["effects", "actuator", "sensor"];

/// Documentation of an effect, or of a part of the actuator or the sensor.
#[derive(Clone, Copy, Debug)]
pub struct Info {
    /// Key in the section.
    pub name: &'static str,
    /// Equation of the added term, of the control that the actuator applies, or of what the policy
    /// sees.
    pub equation: &'static str,
    /// Method of differentiation, and where it smooths or takes a one-sided derivative.
    pub derivative: &'static str,
}

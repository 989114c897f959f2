//! The `integrator` section.

use crate::program::settings::Precision;
use crate::program::settings::config_error::{ConfigError, allowed, count, positive};
use physgrad::{Adaptive, AnyIntegrator, Discretized, ImplicitMidpoint, Ode, RungeKutta, SemiImplicit, Substeps, System, Verlet};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How a step is taken. Without it, as the task takes it: one step of its own scheme.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct IntegratorSettings {
    /// The method; without it, the task's own scheme.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub method: Option<Method>,
    /// Steps that the physics takes in one of the policy, 1 without it; the control is the same in all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub substeps: Option<usize>,
    /// Of `adaptive`: error allowed in relation to a component's size.
    #[serde(skip_serializing_if = "Option::is_none")]
    rtol: Option<f64>,
    /// Of `adaptive`: error allowed whatever the size.
    #[serde(skip_serializing_if = "Option::is_none")]
    atol: Option<f64>,
    /// Of `implicit_midpoint`: when Newton's iteration stops.
    #[serde(skip_serializing_if = "Option::is_none")]
    tolerance: Option<f64>,
}

/// Methods.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Explicit Euler, order 1.
    Euler,
    /// Semi-implicit Euler, order 1: positions with the new velocities.
    SemiImplicit,
    /// Velocity Verlet, order 2.
    Verlet,
    /// Heun, order 2.
    Heun,
    /// Implicit midpoint, order 2: stable however stiff.
    ImplicitMidpoint,
    /// The classical method of Runge and Kutta, order 4.
    Rk4,
    /// Tsitouras, order 5.
    Tsit5,
    /// Tsitouras 5(4) with steps of its own choice.
    Adaptive,
    /// Of quantum control: Padé's scheme, order 4.
    Pade,
    /// Of quantum control: Strang's splitting, order 2, exact without potential.
    Strang,
}

impl Method {
    /// Those for ordinary differential equations.
    pub const ODE: [Self; 8] = [
        Self::Euler,
        Self::SemiImplicit,
        Self::Verlet,
        Self::Heun,
        Self::ImplicitMidpoint,
        Self::Rk4,
        Self::Tsit5,
        Self::Adaptive,
    ];

    /// Those for Schrödinger's equation, beside that of Crank and Nicolson.
    pub const QUANTUM: [Self; 2] = [Self::Pade, Self::Strang];

    /// As a scene spells it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Euler => "euler",
            Self::SemiImplicit => "semi_implicit",
            Self::Verlet => "verlet",
            Self::Heun => "heun",
            Self::ImplicitMidpoint => "implicit_midpoint",
            Self::Rk4 => "rk4",
            Self::Tsit5 => "tsit5",
            Self::Adaptive => "adaptive",
            Self::Pade => "pade",
            Self::Strang => "strang",
        }
    }
}

impl IntegratorSettings {
    /// What is out of range, what nothing reads, and a method that is not of the task.
    pub fn validate(&self, precision: Precision, methods: &[Method]) -> Result<(), ConfigError> {
        if let Some(method) = self.method
            && !methods.contains(&method)
        {
            let names: Vec<&str> = methods.iter().map(|method| method.name()).collect();
            allowed("integrator.method", method.name(), false, format!("{} here, or none", names.join(", ")))?;
        }
        if let Some(substeps) = self.substeps {
            count("integrator.substeps", substeps, 1..=1_000_000)?;
        }
        let of = |key: &str, value: Option<f64>, method: Method| match value {
            Some(value) if self.method != Some(method) => {
                let because = format!("`integrator.method` is not {}", method.name());
                Err(ConfigError::unread(&format!("integrator.{key}"), value, &because))
            }
            Some(value) => positive(&format!("integrator.{key}"), value),
            None => Ok(()),
        };
        of("rtol", self.rtol, Method::Adaptive)?;
        of("atol", self.atol, Method::Adaptive)?;
        of("tolerance", self.tolerance, Method::ImplicitMidpoint)?;
        let (name, floor) = (precision.name(), precision.tolerance_floor());
        for (key, value) in [("rtol", self.rtol), ("tolerance", self.tolerance)] {
            let Some(value) = value else { continue };
            let what = format!("{floor:.1e} or more: rounding in {name} is no less; or precision = \"f64\"");
            allowed(&format!("integrator.{key}"), format!("{value:e}"), value >= floor, what)?;
        }
        Ok(())
    }

    /// Whether there is nothing in it.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Steps of the physics in one of the policy.
    pub fn count(&self) -> usize {
        self.substeps.unwrap_or(1)
    }

    /// What the method is, if there is one.
    pub fn integrator(&self, precision: Precision) -> Option<AnyIntegrator> {
        let floor = precision.tolerance_floor();
        self.method.map(|method| match method {
            Method::Pade | Method::Strang => unreachable!("validated: not a method of this task"),
            Method::Euler => AnyIntegrator::RungeKutta(RungeKutta::EULER),
            Method::SemiImplicit => AnyIntegrator::SemiImplicit(SemiImplicit),
            Method::Verlet => AnyIntegrator::Verlet(Verlet),
            Method::Heun => AnyIntegrator::RungeKutta(RungeKutta::HEUN),
            Method::Rk4 => AnyIntegrator::RungeKutta(RungeKutta::RK4),
            Method::Tsit5 => AnyIntegrator::RungeKutta(RungeKutta::TSIT5),
            Method::ImplicitMidpoint => {
                let tolerance = self.tolerance.unwrap_or(ImplicitMidpoint::default().tolerance);
                AnyIntegrator::ImplicitMidpoint(ImplicitMidpoint { tolerance })
            }
            Method::Adaptive => {
                let usual = Adaptive::default();
                let rtol = self.rtol.unwrap_or(usual.rtol.max(floor));
                AnyIntegrator::Adaptive(Adaptive { rtol, atol: self.atol.unwrap_or(usual.atol), ..usual })
            }
        })
    }

    /// A system whose own step has the length `dt`, as it is to be integrated.
    pub fn discretize<S: System + Ode>(&self, system: S, dt: f64, precision: Precision) -> Substeps<Discretized<S>> {
        Substeps { system: Discretized { system, integrator: self.integrator(precision), dt }, count: self.count() }
    }
}

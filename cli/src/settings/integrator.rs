//! The `integrator` section.

use crate::settings::Precision;
use crate::settings::config_error::{ConfigError, allowed, count, positive};
use physgrad::integrator::{
    Adaptive, AnyIntegrator, Discretized, ImplicitMidpoint, RungeKutta, Sdirk2, SemiImplicit,
    Verlet,
};
use physgrad::{Ode, Substeps, System};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Discretization in time. By default, one step of the task's native scheme per time step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct IntegratorSettings {
    /// Integration method. Without it, the task's native scheme.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub method: Option<Method>,
    /// Steps of the physics per step of the policy, 1 by default. All of them apply one control.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub substeps: Option<usize>,
    /// Relative error tolerance per component. Only for `adaptive`.
    #[serde(skip_serializing_if = "Option::is_none")]
    rtol: Option<f64>,
    /// Absolute error tolerance per component. Only for `adaptive`.
    #[serde(skip_serializing_if = "Option::is_none")]
    atol: Option<f64>,
    /// Stopping tolerance of Newton's iteration. Only for `implicit_midpoint` and `sdirk2`.
    #[serde(skip_serializing_if = "Option::is_none")]
    tolerance: Option<f64>,
}

/// Integration methods.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, strum::IntoStaticStr,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Method {
    /// Explicit Euler, order 1.
    Euler,
    /// Semi-implicit Euler, order 1: the new velocities advance the positions.
    SemiImplicit,
    /// Velocity Verlet, order 2.
    Verlet,
    /// Heun, order 2.
    Heun,
    /// Implicit midpoint, order 2, A-stable: suits stiff systems.
    ImplicitMidpoint,
    /// Alexander's diagonally implicit method, order 2, L-stable: damps stiff components.
    Sdirk2,
    /// Classical Runge-Kutta, order 4.
    Rk4,
    /// Tsitouras, order 5.
    Tsit5,
    /// Tsitouras 5(4) with adaptive step sizes.
    Adaptive,
    /// Padé scheme for the Schrödinger equation, order 4.
    Pade,
    /// Strang splitting for the Schrödinger equation, order 2; exact without potential.
    Strang,
}

impl Method {
    /// Methods for ordinary differential equations.
    pub const ODE: [Self; 9] = [
        Self::Euler,
        Self::SemiImplicit,
        Self::Verlet,
        Self::Heun,
        Self::ImplicitMidpoint,
        Self::Sdirk2,
        Self::Rk4,
        Self::Tsit5,
        Self::Adaptive,
    ];

    /// Methods for the Schrödinger equation, besides Crank-Nicolson, the native scheme.
    pub const QUANTUM: [Self; 2] = [Self::Pade, Self::Strang];

    /// Name in a scene.
    pub fn name(self) -> &'static str {
        self.into()
    }
}

impl IntegratorSettings {
    /// Rejects invalid values, unused keys and unsupported methods.
    pub fn validate(&self, precision: Precision, methods: &[Method]) -> Result<(), ConfigError> {
        if let Some(method) = self.method
            && !methods.contains(&method)
        {
            let names: Vec<&str> = methods.iter().map(|method| method.name()).collect();
            let what = match &names[..] {
                [] => "none for this task; omit it for the native scheme".into(),
                names => format!("{}; or omit it for the native scheme", names.join(", ")),
            };
            allowed("integrator.method", method.name(), false, what)?;
        }
        if let Some(substeps) = self.substeps {
            count("integrator.substeps", substeps, 1..=1_000_000)?;
        }
        let adaptive = [Adaptive::floor::<f32>(), Adaptive::floor::<f64>()];
        let newton = [ImplicitMidpoint::floor::<f32>(), ImplicitMidpoint::floor::<f64>()];
        for (key, value, methods, floors) in [
            ("rtol", self.rtol, &[Method::Adaptive][..], Some(adaptive)),
            ("atol", self.atol, &[Method::Adaptive][..], None),
            (
                "tolerance",
                self.tolerance,
                &[Method::ImplicitMidpoint, Method::Sdirk2][..],
                Some(newton),
            ),
        ] {
            let Some(value) = value else { continue };
            let key = format!("integrator.{key}");
            if !self.method.is_some_and(|method| methods.contains(&method)) {
                let names: Vec<&str> = methods.iter().map(|method| method.name()).collect();
                let because = format!("`integrator.method` is not {}", names.join(" or "));
                return Err(ConfigError::unread(&key, value, &because));
            }
            positive(&key, value)?;
            let Some([single, double]) = floors else { continue };
            let floor = if precision == Precision::F32 { single } else { double };
            let what = format!(
                "{single:.1e} or more in f32, {double:.1e} or more in f64, because of rounding"
            );
            allowed(&key, format!("{value:e}"), value >= floor, what)?;
        }
        Ok(())
    }

    /// Returns whether all settings are absent.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Steps of the physics per step of the policy.
    pub fn count(&self) -> usize {
        self.substeps.unwrap_or(1)
    }

    /// The integrator. None for the native scheme.
    pub fn integrator(&self, precision: Precision) -> Option<AnyIntegrator> {
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
            Method::Sdirk2 => {
                let tolerance = self.tolerance.unwrap_or(Sdirk2::default().tolerance);
                AnyIntegrator::Sdirk2(Sdirk2 { tolerance })
            }
            Method::Adaptive => {
                let default = Adaptive::default();
                let floor = match precision {
                    Precision::F32 => Adaptive::floor::<f32>(),
                    Precision::F64 => Adaptive::floor::<f64>(),
                };
                let rtol = self.rtol.unwrap_or(default.rtol.max(floor));
                AnyIntegrator::Adaptive(Adaptive {
                    rtol,
                    atol: self.atol.unwrap_or(default.atol),
                    ..default
                })
            }
        })
    }

    /// Discretizes a system with substeps. `dt` is the time step of one substep.
    pub fn discretize<S: System + Ode>(
        &self,
        system: S,
        dt: f64,
        precision: Precision,
    ) -> Substeps<Discretized<S>> {
        Substeps {
            system: Discretized { system, integrator: self.integrator(precision), dt },
            count: self.count(),
        }
    }
}

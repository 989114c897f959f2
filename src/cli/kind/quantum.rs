//! Quantum control in the program.

use super::{Info, Kind, Network, Visit};
use crate::cli::problem::{Problem, allowed, count, positive};
use crate::cli::settings::Settings;
use physgrad::policy::Conv;
use physgrad::report::{self, Animation};
use physgrad::tasks::{self, LossMode, QuantumSystem};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `quantum`.
#[derive(Clone, Debug)]
pub struct Quantum;

/// `system` of quantum control.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct QuantumSettings {
    /// Grid points between the walls.
    grid: usize,
    /// Length of the box.
    length: f64,
    /// Time step.
    dt: f64,
    /// Number of the eigenstate to reach; 1 is the ground state.
    target: usize,
    /// How strongly the first and the second eigenstate come into the start states.
    weighting: [f64; 2],
}

/// `effects` of quantum control.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct QuantumEffects {}

/// `loss` of quantum control.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct QuantumLoss {
    /// Which states are paid for.
    mode: LossMode,
}

impl Default for QuantumLoss {
    fn default() -> Self {
        Self { mode: LossMode::Continuous }
    }
}

/// `policy` of quantum control: a convolutional network.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ConvSettings {
    /// Filters of each convolution.
    width: usize,
    /// Start with a zeroed last kernel.
    zero_last: bool,
}

impl Default for ConvSettings {
    fn default() -> Self {
        Self { width: 60, zero_last: false }
    }
}

impl Network for ConvSettings {
    type Policy = Conv;

    fn validate(&self) -> Result<(), Problem> {
        count("policy.width", self.width, 1..=10_000)
    }

    fn build(&self, state_dim: usize, _control_dim: usize) -> Conv {
        Conv::new(state_dim / 2, self.width).zero_last(self.zero_last)
    }
}

impl Kind for Quantum {
    type System = QuantumSettings;
    type Effects = QuantumEffects;
    type Loss = QuantumLoss;
    type Network = ConvSettings;

    const NAME: &'static str = "quantum";
    const ABOUT: &'static str = "bring a particle in a box into an eigenstate by tilting the floor";
    const EPOCHS: usize = 200;
    const HORIZON: usize = 128;

    const EFFECTS: &'static [Info] = &[];

    fn system() -> QuantumSettings {
        let tasks::Quantum { system: QuantumSystem { grid, length, dt }, target, weighting, .. } = tasks::Quantum::new(3);
        QuantumSettings { grid, length, dt, target, weighting }
    }

    fn validate(settings: &Settings<Self>) -> Result<(), Problem> {
        let QuantumSettings { grid, length, dt, target, weighting: [first, second] } = settings.system;
        // Two convolutions leave nothing of fewer points.
        count("system.grid", grid, 7..=100_000)?;
        count("system.target", target, 1..=grid)?;
        positive("system.length", length)?;
        positive("system.dt", dt)?;
        // Within these limits every start state can be normalized.
        let can_be_normalized = first.is_finite() && second.is_finite() && (1e-6..=1e6).contains(&first.abs().max(second.abs()));
        let weighting = format!("[{first}, {second}]");
        allowed("system.weighting", weighting, can_be_normalized, "two numbers, the larger in size 1e-6 to 1e6")
    }

    fn visit<V: Visit>(settings: &Settings<Self>, visitor: V) -> V::Out {
        let task = tasks::Quantum {
            system: settings.physics(),
            target: settings.system.target,
            loss: settings.loss.mode,
            horizon: settings.horizon,
            weighting: settings.system.weighting,
        };
        settings.policy.visit(task, visitor)
    }

    fn variants() -> Vec<(String, Settings<Self>)> {
        let modes = [(LossMode::Final, "final"), (LossMode::Continuous, "continuous")];
        let variant = |(mode, name)| {
            let settings = Settings { loss: QuantumLoss { mode }, horizon: 40, ..Settings::<Self>::defaults() };
            (format!("eigenstate 3, {name} loss"), settings)
        };
        modes.map(variant).to_vec()
    }

    fn dt(settings: &Settings<Self>) -> f64 {
        settings.system.dt
    }

    fn state_names(settings: &Settings<Self>) -> Vec<String> {
        (1..=settings.system.grid).flat_map(|j| [format!("re_{j}"), format!("im_{j}")]).collect()
    }

    fn control_names(_settings: &Settings<Self>) -> Vec<String> {
        vec!["tilt".into()]
    }

    fn animation(settings: &Settings<Self>, states: &[Vec<f64>], controls: &[Vec<f64>]) -> Animation {
        let tilts: Vec<f64> = controls.iter().map(|u| u[0]).collect();
        let system = settings.physics();
        let target: Vec<f64> = system.eigenstate(settings.system.target).collect();
        report::quantum(states, &tilts, &target, system.length, system.dt)
    }
}

impl Settings<Quantum> {
    fn physics(&self) -> QuantumSystem {
        let QuantumSettings { grid, length, dt, .. } = self.system;
        QuantumSystem { grid, length, dt }
    }
}

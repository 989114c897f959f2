//! Quantum control in the program.

use super::{Network, Scene};
use crate::cli::settings::{count, positive};
use anyhow::{Result, bail};
use physgrad::policy::Conv;
use physgrad::report::{self, Animation};
use physgrad::tasks::{LossMode, Quantum, QuantumSystem};
use serde::{Deserialize, Serialize};

/// `system` of quantum control.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuantumSetup {
    /// Grid points between the walls.
    grid: usize,
    length: f64,
    dt: f64,
    /// Number of the eigenstate to reach; 1 is the ground state.
    target: usize,
    /// How strongly the first and the second eigenstate come into the start states.
    weighting: [f64; 2],
}

/// `loss` of quantum control.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuantumLoss {
    mode: LossMode,
}

impl Default for QuantumLoss {
    fn default() -> Self {
        Self { mode: LossMode::Continuous }
    }
}

/// `policy` of quantum control: a convolutional network.
#[derive(Clone, Debug, Serialize, Deserialize)]
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

    fn validate(&self) -> Result<()> {
        count("policy.width", self.width, 1..=10_000)
    }

    fn build(&self, state_dim: usize, _control_dim: usize) -> Conv {
        Conv::new(state_dim / 2, self.width).zero_last(self.zero_last)
    }
}

impl Scene for Quantum {
    type Setup = QuantumSetup;
    type Loss = QuantumLoss;
    type Network = ConvSettings;

    const NAME: &'static str = "quantum";
    const ABOUT: &'static str = "bring a particle in a box into an eigenstate by tilting the floor";
    const EPOCHS: usize = 200;
    const HORIZON: usize = 128;

    fn setup() -> QuantumSetup {
        let Quantum { system: QuantumSystem { grid, length, dt }, target, weighting, .. } = Quantum::new(3);
        QuantumSetup { grid, length, dt, target, weighting }
    }

    fn validate(setup: &QuantumSetup, _loss: &QuantumLoss) -> Result<()> {
        // Two convolutions leave nothing of fewer points.
        count("system.grid", setup.grid, 7..=100_000)?;
        count("system.target", setup.target, 1..=setup.grid)?;
        positive("system.length", setup.length)?;
        positive("system.dt", setup.dt)?;
        let [first, second] = setup.weighting;
        // Within these limits every start state can be normalized.
        let largest = first.abs().max(second.abs());
        if !(first.is_finite() && second.is_finite() && (1e-6..=1e6).contains(&largest)) {
            bail!("`system.weighting` is [{first}, {second}]; allowed: two numbers, the larger in size 1e-6 to 1e6");
        }
        Ok(())
    }

    fn build(setup: &QuantumSetup, loss: &QuantumLoss, horizon: usize) -> Self {
        let QuantumSetup { grid, length, dt, target, weighting } = *setup;
        Self { system: QuantumSystem { grid, length, dt }, target, loss: loss.mode, horizon, weighting }
    }

    fn variants() -> Vec<(String, Self)> {
        let modes = [(LossMode::Final, "final"), (LossMode::Continuous, "continuous")];
        let variant = |(loss, name)| (format!("eigenstate 3, {name} loss"), Self { loss, horizon: 40, ..Self::new(3) });
        modes.map(variant).to_vec()
    }

    fn dt(&self) -> f64 {
        self.system.dt
    }

    fn state_names(&self) -> Vec<String> {
        (1..=self.system.grid).flat_map(|j| [format!("re_{j}"), format!("im_{j}")]).collect()
    }

    fn control_names(&self) -> Vec<String> {
        vec!["tilt".into()]
    }

    fn animation(&self, states: &[Vec<f64>], controls: &[Vec<f64>]) -> Animation {
        let tilts: Vec<f64> = controls.iter().map(|u| u[0]).collect();
        let target: Vec<f64> = self.system.eigenstate(self.target).collect();
        report::quantum(states, &tilts, &target, self.system.length, self.system.dt)
    }
}

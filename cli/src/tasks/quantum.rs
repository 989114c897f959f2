//! Quantum control: settings, effects, limits and animation.

use crate::operations::trajectory::Trajectory;
use crate::settings::config_error::{
    ConfigError, allowed, count, exclusive, finite, not_negative, positive,
};
use crate::settings::{Joined, Method};
use crate::tasks::effects::{EffectsSection, effects_section, named};
use crate::tasks::{Conserved, SceneEffects, Settings, TaskSpec, policy};
use physgrad::effect::Named;
use physgrad::tasks::{
    self, Absorbing, AbsorbingEdges, Barrier, ControlShape, Cubic, DoubleWell, Harmonic, LossMode,
    Pade, QuantumEffect, QuantumScheme, QuantumSystem, Strang, Tabulated,
};
use physgrad::{DynTask, Forced, Substeps};
use physgrad_plot::{Animation, Landscape};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Task `quantum`.
#[derive(Clone, Debug)]
pub struct Quantum;

/// Settings that the task adds to the section `system`.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct States {
    /// Index of the target eigenstate; 1 is the ground state.
    target: usize,
    /// Weights of the first and the second eigenstate in initial states.
    weighting: [f64; 2],
}

effects_section! {
    /// The `effects` section of quantum control, in order of evaluation.
    QuantumEffects {
        /// A harmonic trap.
        harmonic: Harmonic {
            equation: "V = stiffness (ξ - center)²",
            derivative: "none, because V is independent of ψ",
            limits: { stiffness: finite, center: finite },
        }
        /// A potential barrier, or a well, in the box.
        barrier: Barrier {
            equation: "V = height / cosh²((ξ - center) / width)",
            derivative: "none, because V is independent of ψ",
            limits: { height: finite, width: positive, center: finite },
        }
        /// Two potential wells separated by a barrier.
        double_well: DoubleWell {
            equation: "V = height ((2 ξ / separation)² - 1)²",
            derivative: "none, because V is independent of ψ",
            limits: { height: finite, separation: positive },
        }
        /// Cubic self-interaction of the Gross-Pitaevskii equation.
        cubic: Cubic {
            equation: "V = strength |ψ_j|² / dx",
            derivative: "analytic",
            limits: { strength: finite },
        }
        /// Absorbing layers at the walls.
        absorbing_edges: AbsorbingEdges {
            equation: "ψ_j ← exp(-dt W) ψ_j, W = strength ((width - d) / width)² at the distance d < width from a wall",
            derivative: "analytic",
            limits: { width: positive, strength: not_negative },
        }
    }
}

impl QuantumEffects {
    /// The static potential on the grid, if any.
    fn potential(&self, system: &QuantumSystem) -> Option<Named<Tabulated>> {
        let harmonic = self.harmonic.map(|effect| Tabulated::of(system, &effect));
        let barrier = self.barrier.map(|effect| Tabulated::of(system, &effect));
        let double_well = self.double_well.map(|effect| Tabulated::of(system, &effect));
        named("effects.harmonic", harmonic)
            .or_else(|| named("effects.barrier", barrier))
            .or_else(|| named("effects.double_well", double_well))
    }

    /// Effects that add to the potential.
    fn list(&self, system: &QuantumSystem) -> Vec<Named<QuantumEffect>> {
        let potential = self
            .potential(system)
            .map(|Named { name, effect }| Named { name, effect: effect.into() });
        potential.into_iter().chain(named("effects.cubic", self.cubic)).collect()
    }

    /// Potential and absorbing layers for the animation.
    fn landscape(&self, system: &QuantumSystem) -> Landscape {
        let potential =
            self.potential(system).map_or(Vec::new(), |potential| potential.effect.values);
        let absorbing = self.absorbing_edges.map(|edges| edges.width);
        Landscape { potential, absorbing, ..Landscape::default() }
    }

    fn validate(&self, length: f64) -> Result<(), ConfigError> {
        self.validate_values()?;
        if let Some(DoubleWell { separation, .. }) = self.double_well {
            within("effects.double_well.separation", separation, length, "the length of the box")?;
        }
        if let Some(AbsorbingEdges { width, .. }) = self.absorbing_edges {
            within(
                "effects.absorbing_edges.width",
                width,
                0.5 * length,
                "half the length of the box",
            )?;
        }
        let potentials = [
            ("harmonic", self.harmonic.is_some()),
            ("barrier", self.barrier.is_some()),
            ("double_well", self.double_well.is_some()),
        ];
        exclusive(&potentials, "there is one static potential")
    }
}

/// Returns an error unless the value is positive and at most `limit`. `what` describes the limit.
fn within(key: &str, value: f64, limit: f64, what: &str) -> Result<(), ConfigError> {
    allowed(
        key,
        value,
        value > 0.0 && value <= limit,
        format!("more than 0, up to {limit}, {what}"),
    )
}

/// The `loss` section of quantum control.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct QuantumLoss {
    /// States that enter the loss.
    mode: LossMode,
}

impl Default for QuantumLoss {
    fn default() -> Self {
        Self { mode: LossMode::Running }
    }
}

impl TaskSpec for Quantum {
    type System = Joined<QuantumSystem, States>;
    type Effects = QuantumEffects;
    type Loss = QuantumLoss;

    const NAME: &'static str = "quantum";
    const ABOUT: &'static str = "bring a particle in a box into an eigenstate by tilting the floor";
    const EPOCHS: usize = 200;
    const POLICY: &'static str = policy::CONV;
    fn horizon() -> usize {
        128
    }
    const SYMBOLS: &'static str = "V is the potential. ξ is the position, from the middle of the box. ψ_j is the wave at grid point j, dx the spacing \
             of the grid, and dt the time step. Units: ħ = 1, and the mass is 1/2. A scene has at most one static potential: \
             `harmonic`, `barrier` or `double_well`. Costs are for 32 grid points.";
    const METHODS: &'static [Method] = &Method::QUANTUM;

    fn system() -> Self::System {
        let tasks::Quantum { system, target, weighting, .. } = tasks::Quantum::new(3);
        Joined(system, States { target, weighting })
    }

    fn validate(settings: &Settings<Self>) -> Result<(), ConfigError> {
        let Joined(QuantumSystem { grid, length, dt, control: _ }, states) = settings.system;
        let States { target, weighting: [first, second] } = states;
        // Two convolutions of kernel size 3 and stride 2 need at least seven points.
        count("system.grid", grid, 7..=100_000)?;
        let is_dense = settings.integrator.method == Some(Method::Strang);
        allowed(
            "system.grid",
            grid,
            !is_dense || grid <= 4096,
            "up to 4096 with the method `strang`, which has a dense matrix",
        )?;
        count("system.target", target, 1..=grid)?;
        positive("system.length", length)?;
        positive("system.dt", dt)?;
        // Within these limits every initial state can be normalized.
        let can_be_normalized = first.is_finite()
            && second.is_finite()
            && (1e-6..=1e6).contains(&first.abs().max(second.abs()));
        let weighting = format!("[{first}, {second}]");
        allowed(
            "system.weighting",
            weighting,
            can_be_normalized,
            "two numbers, the larger magnitude from 1e-6 to 1e6",
        )?;
        settings.effects.validate(length)?;
        // The convolutions accept no state components besides the wave function.
        settings.actuator.without_state("the network of this task observes only the wave function")
    }

    fn validate_own_effects(effects: &SceneEffects) -> Result<(), ConfigError> {
        effects.only_of::<QuantumSystem>()
    }

    fn task(settings: &Settings<Self>) -> DynTask {
        let system = settings.system.0;
        let mut effects = settings.effects.list(&system);
        effects.extend(settings.own_effects.listed());
        // Uses one type in all scenes: an empty list of effects costs little compared with the
        // tridiagonal solve. Absorbing edges of width 0 leave the state unchanged.
        let edges = settings
            .effects
            .absorbing_edges
            .unwrap_or(AbsorbingEdges { width: 0.0, strength: 0.0 });
        let count = settings.integrator.count();
        let system = QuantumSystem { dt: system.dt / count as f64, ..system };
        let scheme = match settings.integrator.method {
            Some(Method::Pade) => QuantumScheme::Pade(Pade(system)),
            Some(Method::Strang) => QuantumScheme::Strang(Strang::new(system)),
            _ => QuantumScheme::CrankNicolson(system),
        };
        let system =
            Substeps { system: Absorbing::new(Forced { system: scheme, effects }, edges), count };
        let system = settings.actuator.wrap(system, settings.system.0.dt);
        let States { target, weighting } = settings.system.1;
        DynTask::new(tasks::Quantum {
            system,
            target,
            loss: settings.loss.mode,
            horizon: settings.horizon,
            weighting,
        })
    }

    fn variants() -> Vec<(String, Settings<Self>)> {
        let modes = [(LossMode::Terminal, "terminal"), (LossMode::Running, "running")];
        let variant = |(mode, name)| {
            let settings = Settings {
                loss: QuantumLoss { mode },
                horizon: 40,
                ..Settings::<Self>::defaults()
            };
            (format!("eigenstate 3, {name} loss"), settings)
        };
        modes.map(variant).to_vec()
    }

    fn dt(settings: &Settings<Self>) -> f64 {
        settings.system.0.dt
    }

    fn state_names(settings: &Settings<Self>) -> Vec<String> {
        (1..=settings.system.0.grid).flat_map(|j| [format!("re_{j}"), format!("im_{j}")]).collect()
    }

    fn control_names(settings: &Settings<Self>) -> Vec<String> {
        let name = match settings.system.0.control {
            ControlShape::Tilt => "tilt",
            ControlShape::Dipole => "dipole",
        };
        vec![name.into()]
    }

    fn conserved(settings: &Settings<Self>) -> Option<Conserved> {
        let square = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>();
        settings
            .effects
            .absorbing_edges
            .is_none()
            .then(|| Conserved { name: "squared norm", value: Box::new(square) })
    }

    fn animation(settings: &Settings<Self>, rollout: &Trajectory) -> Animation {
        drawn(settings, rollout, 0)
    }

    fn unfinished(
        settings: &Settings<Self>,
        rollout: &Trajectory,
        _bounds: Option<&[[f64; 2]]>,
    ) -> Animation {
        drawn(settings, rollout, settings.horizon)
    }
}

/// Animation of a rollout; `steps` is that of [`Landscape`].
fn drawn(
    settings: &Settings<Quantum>,
    Trajectory { states, controls, .. }: &Trajectory,
    steps: usize,
) -> Animation {
    let system = settings.system.0;
    let tilts: Vec<f64> =
        settings.actuator.applied(system.dt, states, controls).iter().map(|u| u[0]).collect();
    let landscape = Landscape { steps, ..settings.effects.landscape(&system) };
    let target: Vec<f64> = system.eigenstate(settings.system.1.target).collect();
    physgrad_plot::quantum_in(&landscape, states, &tilts, &target, system.length, system.dt)
}

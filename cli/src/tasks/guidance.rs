//! Guidance by repulsion: settings, effects, limits and animation.

use crate::operations::trajectory::Trajectory;
use crate::settings::Method;
use crate::settings::config_error::{ConfigError, allowed, count, finite, not_negative, positive};
use crate::tasks::effects::{EffectsSection, effects_section, named};
use crate::tasks::{SceneEffects, Settings, TaskSpec};
use physgrad::effect::{HasModel, Named};
use physgrad::tasks::{
    self, Drive, Evade, Flock, Friction, GuidanceEffect, GuidanceSystem, LossMode, Obstacles,
    Spread, Walls,
};
use physgrad::{DynTask, Forced, System};
use physgrad_plot::{Animation, Field};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Task `guidance`.
#[derive(Clone, Debug)]
pub struct Guidance;

effects_section! {
    /// The `effects` section of guidance, in order of evaluation.
    GuidanceEffects {
        /// Viscous friction of the agents.
        friction: Friction {
            equation: "a = -friction v",
            derivative: "analytic",
            limits: { drivers: not_negative, evaders: not_negative },
        }
        /// Drivers repel each other.
        spread: Spread {
            equation: "driver j: a = strength Σ_i (D_j - D_i) / d²",
            derivative: "analytic",
            limits: { strength: finite },
        }
        /// Drivers repel evaders.
        evade: Evade {
            equation: "evader k: a = strength Σ_j (E_k - D_j) / d²",
            derivative: "analytic",
            limits: { strength: finite },
        }
        /// Evaders attract each other nearby and repel each other farther off.
        flock: Flock {
            equation: "evader k: a = strength Σ_i (distance / d - 1) / d (E_i - E_k)",
            derivative: "analytic",
            limits: { strength: finite, distance: finite },
        }
        /// Evaders attract drivers.
        drive: Drive {
            equation: "driver j: a = strength Σ_k (E_k - D_j) / d²",
            derivative: "analytic",
            limits: { strength: finite },
        }
        /// Circular obstacles with a repelling spring force.
        obstacles: Obstacles {
            equation: "a = stiffness max(0, radius - |r|) r / d, r from the center",
            derivative: "analytic; one-sided at contact",
            limits: { centers: some_centers, radius: positive, stiffness: not_negative },
        }
        /// Walls around a rectangular field.
        walls: Walls {
            equation: "a = -stiffness max(0, |x| - half_width), outwards, and likewise in y",
            derivative: "analytic; one-sided at contact",
            limits: { half_width: positive, half_height: positive, stiffness: not_negative },
        }
    }
}

/// Concrete type of the paper's effects.
type PaperEffects = (Named<Friction>, Named<Spread>, Named<Evade>, Named<Flock>);

impl GuidanceEffects {
    /// Effects of the paper.
    fn paper() -> Self {
        Self {
            friction: Some(Friction::default()),
            spread: Some(Spread::default()),
            evade: Some(Evade::default()),
            flock: Some(Flock::default()),
            ..Self::default()
        }
    }

    /// Effects of the paper, if they are all present and there are no others.
    fn only_of_the_paper(&self) -> Option<PaperEffects> {
        let Self { friction, spread, evade, flock, drive: None, obstacles: None, walls: None } =
            *self
        else {
            return None;
        };
        Some((
            named("effects.friction", friction)?,
            named("effects.spread", spread)?,
            named("effects.evade", evade)?,
            named("effects.flock", flock)?,
        ))
    }

    /// Obstacles and walls for the animation.
    fn field(&self) -> Field {
        let discs = |Obstacles { centers, radius, .. }: &Obstacles| {
            centers.iter().map(|&center| (center, *radius)).collect()
        };
        let walls = self.walls.map(|walls| [walls.half_width, walls.half_height]);
        Field { obstacles: self.obstacles.as_ref().map_or_else(Vec::new, discs), walls }
    }
}

/// Checks that there are 1 to 1000 centers, all finite.
fn some_centers(key: &str, centers: Vec<[f64; 2]>) -> Result<(), ConfigError> {
    const MAX: usize = 1000;
    allowed(key, "[]", !centers.is_empty(), "one center or more, each [x, y]")?;
    let found = format!("a list of {}", centers.len());
    allowed(key, found, centers.len() <= MAX, format!("up to {MAX} centers"))?;
    for (i, center) in centers.iter().enumerate() {
        for (axis, &coordinate) in center.iter().enumerate() {
            finite(&format!("{key}[{i}][{axis}]"), coordinate)?;
        }
    }
    Ok(())
}

/// The `loss` section of guidance.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GuidanceLoss {
    /// States that enter the loss.
    mode: LossMode,
    /// Weight of the mean squared control, m² s⁴.
    regularization: f64,
}

impl Default for GuidanceLoss {
    fn default() -> Self {
        let tasks::Guidance { loss, regularization, .. } = tasks::Guidance::new(1, 1);
        Self { mode: loss, regularization }
    }
}

/// Herding task with this system.
fn herd(system: impl HasModel<GuidanceSystem> + 'static, settings: &Settings<Guidance>) -> DynTask {
    let GuidanceLoss { mode: loss, regularization } = settings.loss;
    DynTask::new(tasks::Guidance { system, loss, regularization, horizon: settings.horizon })
}

impl TaskSpec for Guidance {
    type System = GuidanceSystem;
    type Effects = GuidanceEffects;
    type Loss = GuidanceLoss;

    const NAME: &'static str = "guidance";
    const ABOUT: &'static str = "drivers herd evaders, which flee from them, to the origin";
    const EPOCHS: usize = 200;
    fn horizon() -> usize {
        60
    }
    const SYMBOLS: &'static str = "D_j and E_k are the positions of driver j and evader k. (x, y), v and a are position, velocity and acceleration of \
             an agent. d is `softening` plus the distance between two agents, or between an agent and the center of an \
             obstacle. Costs are for 2 drivers and 4 evaders.";
    const METHODS: &'static [Method] = &Method::ODE;

    fn system() -> GuidanceSystem {
        GuidanceSystem::default()
    }

    fn validate(settings: &Settings<Self>) -> Result<(), ConfigError> {
        let (system, regularization) = (&settings.system, settings.loss.regularization);
        count("system.drivers", system.drivers, 1..=1000)?;
        count("system.evaders", system.evaders, 1..=1000)?;
        positive("system.softening", system.softening)?;
        positive("system.dt", system.dt)?;
        not_negative("loss.regularization", regularization)?;
        settings.effects.validate_values()
    }

    fn validate_own_effects(effects: &SceneEffects) -> Result<(), ConfigError> {
        effects.only_of::<GuidanceSystem>()
    }

    fn task(settings: &Settings<Self>) -> DynTask {
        let dt = settings.system.dt / settings.integrator.count() as f64;
        let system = GuidanceSystem { dt, ..settings.system };
        // Uses a separate type only for the paper's effects, because each type adds compile time.
        if settings.actuator.is_empty()
            && settings.integrator.is_empty()
            && settings.own_effects.is_empty()
            && let Some(effects) = settings.effects.only_of_the_paper()
        {
            return herd(Forced { system, effects }, settings);
        }
        let effects: Vec<Named<GuidanceEffect>> = settings.all_effects();
        let system =
            settings.integrator.discretize(Forced { system, effects }, dt, settings.precision);
        herd(settings.actuator.wrap(system, settings.system.dt), settings)
    }

    fn variants() -> Vec<(String, Settings<Self>)> {
        let variant = |drivers, evaders, mode| {
            let mut settings =
                Settings { effects: GuidanceEffects::paper(), ..Settings::<Self>::defaults() };
            (settings.system.drivers, settings.system.evaders) = (drivers, evaders);
            settings.loss.mode = mode;
            settings
        };
        vec![
            ("1 driver, 1 evader, terminal loss".into(), variant(1, 1, LossMode::Terminal)),
            ("2 drivers, 4 evaders, running loss".into(), variant(2, 4, LossMode::Running)),
        ]
    }

    fn dt(settings: &Settings<Self>) -> f64 {
        settings.system.dt
    }

    fn state_names(settings: &Settings<Self>) -> Vec<String> {
        let drivers = (1..=settings.system.drivers).map(|i| format!("driver_{i}"));
        let evaders = (1..=settings.system.evaders).map(|i| format!("evader_{i}"));
        drivers
            .chain(evaders)
            .flat_map(|agent| ["x", "y", "vx", "vy"].map(|name| format!("{agent}_{name}")))
            .collect()
    }

    fn control_names(settings: &Settings<Self>) -> Vec<String> {
        (1..=settings.system.drivers)
            .flat_map(|i| [format!("radial_{i}"), format!("tangential_{i}")])
            .collect()
    }

    fn animation(settings: &Settings<Self>, Trajectory { states, .. }: &Trajectory) -> Animation {
        let dim = System::state_dim(&settings.system);
        let states: Vec<Vec<f64>> = states.iter().map(|x| x[..dim].to_vec()).collect();
        physgrad_plot::guidance_in(
            &settings.effects.field(),
            &states,
            settings.system.drivers,
            settings.system.dt,
        )
    }
}

//! Cart-pole: settings, effects, limits and animation.

use crate::operations::trajectory::Trajectory;
use crate::settings::config_error::{
    ConfigError, count, exclusive, finite, not_negative, positive,
};
use crate::settings::{Joined, Method};
use crate::tasks::effects::{EffectsSection, Present, effects_section};
use crate::tasks::{Conserved, SceneEffects, Settings, TaskSpec};
use physgrad::effect::{HasModel, Named};
use physgrad::tasks::{
    self, Bumpers, CartDamping, CartPoleEffect, CartPoleModel, CartPoleSystem, CoupledCartPole,
    DryFriction, GustyWind, LossMode, PoleDamping, SteadyWind,
};
use physgrad::{DynTask, Effect, Forced, System};
use physgrad_plot::{Animation, Rail};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Task `cart_pole`.
#[derive(Clone, Debug)]
pub struct CartPole;

/// Settings that the task adds to the section `system`.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Equations {
    /// Equations of motion: uncoupled or coupled poles.
    model: Model,
}

/// Equations of motion.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
enum Model {
    /// Equations of the paper's code: the control drives every pole, without coupling between
    /// poles.
    Uncoupled,
    /// Exact equations: the poles couple through the cart.
    Coupled,
}

effects_section! {
    /// The `effects` section of cart-pole, in order of evaluation.
    CartPoleEffects {
        /// Viscous friction in the joints of the poles.
        pole_damping: PoleDamping {
            equation: "τ_i = -damping ω_i",
            derivative: "analytic",
            limits: { damping: not_negative },
        }
        /// Viscous friction of the cart on its rail.
        cart_damping: CartDamping {
            equation: "F = -damping ẋ",
            derivative: "analytic",
            limits: { damping: not_negative },
        }
        /// Dry friction of the cart on its rail, smoothed.
        dry_friction: DryFriction {
            equation: "F = -force tanh(ẋ / smoothing)",
            derivative: "analytic; smoothed",
            limits: { force: not_negative, smoothing: positive },
        }
        /// A steady wind along the rail.
        steady_wind: SteadyWind {
            equation: "F = cart_drag |w - ẋ| (w - ẋ) + Σ D_i cos θ_i, τ_i = l D_i, D_i = pole_drag |v_i| v_i, v_i = (w - ẋ) cos θ_i - l ω_i, w = speed",
            derivative: "analytic",
            limits: { speed: finite, cart_drag: not_negative, pole_drag: not_negative },
        }
        /// Wind along the rail with sinusoidal gusts of random phase.
        gusty_wind: GustyWind {
            equation: "as steady_wind, w = speed + gust sin(2π (t + t₀) / period), t₀ drawn from 0 to period per rollout",
            derivative: "analytic",
            limits: { speed: finite, gust: finite, period: positive, cart_drag: not_negative, pole_drag: not_negative },
        }
        /// Spring-damper bumpers at both ends of the rail.
        bumpers: Bumpers {
            equation: "F = -stiffness δ max(0, 1 + damping dδ/dt), δ = max(0, |x| - half_travel), outwards",
            derivative: "analytic; one-sided at contact",
            limits: { half_travel: positive, stiffness: not_negative, damping: not_negative },
        }
    }
}

impl CartPoleEffects {
    /// Wind speed in m/s at each step. Empty without wind. `params` are the parameters of each step,
    /// of duration `dt` in s.
    fn wind(&self, params: &[Vec<f64>], dt: f64) -> Vec<f64> {
        let mut first = 0;
        for Named { effect, .. } in Present::<CartPoleEffect>::present(self) {
            match effect {
                CartPoleEffect::SteadyWind(wind) => {
                    return params.iter().map(|p| wind.speed_at(&p[first..])).collect();
                }
                CartPoleEffect::GustyWind(wind) => {
                    let speed =
                        |(t, p): (usize, &Vec<f64>)| wind.speed_at(&p[first..], t as f64 * dt)[0];
                    return params.iter().enumerate().map(speed).collect();
                }
                effect => first += Effect::<CartPoleSystem>::param_dim(&effect),
            }
        }
        Vec::new()
    }

    fn validate(&self) -> Result<(), ConfigError> {
        self.validate_values()?;
        let winds = [
            ("steady_wind", self.steady_wind.is_some()),
            ("gusty_wind", self.gusty_wind.is_some()),
        ];
        exclusive(&winds, "both set the wind speed")
    }
}

/// The `loss` section of cart-pole.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CartPoleLoss {
    /// States that enter the loss.
    mode: LossMode,
}

/// Time step of the physics: the control step divided by the number of substeps.
fn system_dt(settings: &Settings<CartPole>) -> f64 {
    settings.system.1.dt / settings.integrator.count() as f64
}

/// Swing-up task with this system.
fn swing_up(
    system: impl HasModel<CartPoleSystem> + 'static,
    settings: &Settings<CartPole>,
) -> DynTask {
    DynTask::new(tasks::CartPole { system, loss: settings.loss.mode, horizon: settings.horizon })
}

/// Task whose effects are a list, with integrator and actuators.
fn listed(
    system: CartPoleModel,
    effects: Vec<Named<CartPoleEffect>>,
    settings: &Settings<CartPole>,
) -> DynTask {
    let system = settings.integrator.discretize(
        Forced { system, effects },
        system_dt(settings),
        settings.precision,
    );
    let system = settings.actuator.wrap(system, settings.system.1.dt);
    swing_up(system, settings)
}

impl TaskSpec for CartPole {
    type System = Joined<Equations, CartPoleSystem>;
    type Effects = CartPoleEffects;
    type Loss = CartPoleLoss;

    const NAME: &'static str = "cart_pole";
    const ABOUT: &'static str = "swing up 1 to 64 poles on one cart";
    const EPOCHS: usize = 1000;
    fn horizon() -> usize {
        100
    }
    const SYMBOLS: &'static str = "x is the position of the cart. θ_i and ω_i are angle and angular velocity of pole i. l is `half_length`. F is the \
             force on the cart. τ_i is the torque on pole i. D_i is the drag of pole i, and v_i the speed of the air across it. δ \
             is the depth of contact. Costs are for 2 poles.";
    const METHODS: &'static [Method] = &Method::ODE;

    fn system() -> Self::System {
        let system = CartPoleSystem { poles: 2, ..CartPoleSystem::default() };
        Joined(Equations { model: Model::Uncoupled }, system)
    }

    fn validate(settings: &Settings<Self>) -> Result<(), ConfigError> {
        let system = &settings.system.1;
        count("system.poles", system.poles, 1..=CartPoleSystem::MAX_POLES)?;
        positive("system.cart_mass", system.cart_mass)?;
        positive("system.pole_mass", system.pole_mass)?;
        positive("system.half_length", system.half_length)?;
        positive("system.dt", system.dt)?;
        finite("system.gravity", system.gravity)?;
        system.check().map_err(|error| {
            ConfigError::new(
                "system.cart_mass",
                format!("is {}: {error}", system.cart_mass.nominal()),
            )
        })?;
        settings.effects.validate()
    }

    fn validate_own_effects(effects: &SceneEffects) -> Result<(), ConfigError> {
        effects.only_of::<CartPoleSystem>()
    }

    fn task(settings: &Settings<Self>) -> DynTask {
        let effects = settings.all_effects();
        let system = CartPoleSystem { dt: system_dt(settings), ..settings.system.1 };
        // Uses a separate type only for the paper's system, because each type adds compile time.
        match settings.system.0.model {
            Model::Uncoupled
                if effects.is_empty()
                    && settings.actuator.is_empty()
                    && settings.integrator.is_empty() =>
            {
                swing_up(system, settings)
            }
            Model::Uncoupled => listed(CartPoleModel::Uncoupled(system), effects, settings),
            Model::Coupled => {
                listed(CartPoleModel::Coupled(CoupledCartPole(system)), effects, settings)
            }
        }
    }

    fn variants() -> Vec<(String, Settings<Self>)> {
        let modes = [(LossMode::Terminal, "terminal"), (LossMode::Running, "running")];
        let variant = |poles: usize, (mode, name): (LossMode, &str)| {
            let mut settings = Settings::<Self>::defaults();
            settings.system.1.poles = poles;
            settings.loss.mode = mode;
            (format!("{poles} pole{}, {name} loss", if poles == 1 { "" } else { "s" }), settings)
        };
        let mut windy = variant(2, modes[0]).1;
        windy.effects.cart_damping = Some(CartDamping::default());
        windy.effects.steady_wind = Some(SteadyWind::default());
        let plain = [1, 2, 4].into_iter().flat_map(|poles| modes.map(|mode| variant(poles, mode)));
        plain.chain([("2 poles, cart damping, steady wind".to_owned(), windy)]).collect()
    }

    fn dt(settings: &Settings<Self>) -> f64 {
        settings.system.1.dt
    }

    fn state_names(settings: &Settings<Self>) -> Vec<String> {
        let poles = (1..=settings.system.1.poles)
            .flat_map(|i| [format!("theta_{i}"), format!("omega_{i}")]);
        ["x".into(), "x_dot".into()].into_iter().chain(poles).collect()
    }

    fn param_names(settings: &Settings<Self>) -> Vec<String> {
        settings.effects.gusty_wind.map(|_| "start_of_gusts".to_owned()).into_iter().collect()
    }

    fn control_names(_settings: &Settings<Self>) -> Vec<String> {
        vec!["force".into()]
    }

    fn conserved(settings: &Settings<Self>) -> Option<Conserved> {
        // With several poles, only the exact equations conserve energy.
        let exact =
            matches!(settings.system.0.model, Model::Coupled) || settings.system.1.poles == 1;
        let free =
            settings.all_effects::<_, CartPoleEffect>().is_empty() && settings.actuator.is_empty();
        let system = CoupledCartPole(settings.system.1);
        (exact && free)
            .then(|| Conserved { name: "energy", value: Box::new(move |x| system.energy(x)) })
    }

    fn animation(settings: &Settings<Self>, rollout: &Trajectory) -> Animation {
        let wind = settings.effects.wind(&rollout.params, settings.system.1.dt);
        drawn(settings, rollout, Rail { wind, ..Rail::default() })
    }

    fn unfinished(
        settings: &Settings<Self>,
        rollout: &Trajectory,
        bounds: Option<&[[f64; 2]]>,
    ) -> Animation {
        // The label names the strongest wind of the whole rollout.
        let mut params = rollout.params.clone();
        let last = params.last().cloned().unwrap_or_default();
        params.resize(settings.horizon + 1, last);
        let wind = settings.effects.wind(&params, settings.system.1.dt);
        // Without bounds, an infinite force leaves no arrow.
        let strongest = |[low, high]: &[f64; 2]| low.abs().max(high.abs());
        let unfinished = Some(bounds.map_or(f64::INFINITY, |bounds| strongest(&bounds[0])));
        drawn(settings, rollout, Rail { wind, unfinished, ..Rail::default() })
    }
}

/// Animation of a rollout on a rail, to which it adds the bumpers.
fn drawn(
    settings: &Settings<CartPole>,
    Trajectory { states, controls, .. }: &Trajectory,
    rail: Rail,
) -> Animation {
    let CartPoleSystem { half_length, dt, .. } = settings.system.1;
    let dim = System::state_dim(&settings.system.1);
    let forces: Vec<f64> =
        settings.actuator.applied(dt, states, controls).iter().map(|u| u[0]).collect();
    let bumpers = settings.effects.bumpers.map(|bumpers| bumpers.half_travel);
    let states: Vec<Vec<f64>> = states.iter().map(|x| x[..dim].to_vec()).collect();
    let rail = Rail { bumpers, ..rail };
    physgrad_plot::cart_pole_on(&rail, &states, &forces, half_length.nominal(), dt)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn the_wind_of_an_animation_has_the_drawn_numbers_of_the_rollout() {
        let effects: CartPoleEffects = toml::from_str(
            "pole_damping = { damping = { uniform = [1, 2] } }\n\
             gusty_wind = { speed = 3, gust = { uniform = [1, 2] }, period = 4 }",
        )
        .expect("settings");
        // The damping, then the start of the gusts and their amplitude.
        let params = [vec![1.5, 1.0, 1.25], vec![1.5, 1.0, 1.25]];
        let wind = effects.wind(&params, 0.5);
        assert_eq!(wind[0], 3.0 + 1.25);
        assert!((wind[1] - (3.0 + 1.25 * (0.75 * PI).sin())).abs() < 1e-15, "{wind:?}");
        assert!(CartPoleEffects::default().wind(&params, 0.5).is_empty());
    }
}

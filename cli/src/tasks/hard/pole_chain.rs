//! Chain of poles on a cart: settings, limits and animation.

use crate::operations::trajectory::Trajectory;
use crate::settings::Method;
use crate::settings::config_error::{ConfigError, count, finite, positive};
use crate::tasks::hard::{Nothing, Start, UprightLoss, in_scene, upright, validate_upright};
use crate::tasks::{Conserved, MlpSettings, Settings, TaskSpec};
use physgrad::DynTask;
use physgrad::Number;
use physgrad::tasks::{self, CartPoleSystem};
use physgrad_plot::{Animation, Posture, Stage, mechanics};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Task `pole_chain`.
#[derive(Clone, Debug)]
pub struct PoleChain;

/// The `system` section of the pole chain.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PoleChainSettings {
    /// Number of poles, hinged end to end.
    poles: usize,
    /// Mass of the cart, kg.
    cart_mass: f64,
    /// Mass of a pole, kg.
    pole_mass: f64,
    /// Half the length of a pole, m.
    half_length: f64,
    /// Gravitational acceleration, m/s².
    gravity: f64,
    /// Time step, s.
    dt: f64,
    /// Distribution of initial states.
    start: Start,
}

fn chain(settings: &Settings<PoleChain>) -> tasks::PoleChain {
    let PoleChainSettings { poles, cart_mass, pole_mass, half_length, gravity, dt, start: _ } =
        settings.system;
    let [cart_mass, pole_mass, half_length, gravity] =
        [cart_mass, pole_mass, half_length, gravity].map(Number::Fixed);
    tasks::PoleChain(CartPoleSystem { poles, cart_mass, pole_mass, half_length, gravity, dt })
}

impl TaskSpec for PoleChain {
    type System = PoleChainSettings;
    type Effects = Nothing;
    type Loss = UprightLoss;
    type PolicySpec = MlpSettings;

    const NAME: &'static str = "pole_chain";
    const ABOUT: &'static str = "swing up a chain of poles, hinged end to end, on a cart";
    const EPOCHS: usize = 300;
    fn horizon() -> usize {
        100
    }
    const METHODS: &'static [Method] = &Method::ODE;

    fn system() -> PoleChainSettings {
        let (model, dt) = (CartPoleSystem::default(), CartPoleSystem::default().dt);
        let [cart_mass, pole_mass, half_length, gravity] = model.nominal();
        PoleChainSettings {
            poles: 2,
            cart_mass,
            pole_mass,
            half_length,
            gravity,
            dt,
            start: Start::Hanging,
        }
    }

    fn validate(settings: &Settings<Self>) -> Result<(), ConfigError> {
        let PoleChainSettings { poles, cart_mass, pole_mass, half_length, gravity, dt, start: _ } =
            settings.system;
        count("system.poles", poles, 1..=20)?;
        positive("system.cart_mass", cart_mass)?;
        positive("system.pole_mass", pole_mass)?;
        positive("system.half_length", half_length)?;
        finite("system.gravity", gravity)?;
        positive("system.dt", dt)?;
        chain(settings).check().map_err(|error| {
            ConfigError::new("system.cart_mass", format!("is {cart_mass}: {error}"))
        })?;
        validate_upright(settings)
    }

    fn task(settings: &Settings<Self>) -> DynTask {
        let task = upright(settings, chain(settings), 2, settings.system.start, 30.0);
        in_scene(settings, task)
    }

    fn variants() -> Vec<(String, Settings<Self>)> {
        let of = |poles: usize| {
            let mut settings = Settings::<Self>::defaults();
            settings.system.poles = poles;
            (format!("{poles} poles"), settings)
        };
        vec![of(2), of(5)]
    }

    fn dt(settings: &Settings<Self>) -> f64 {
        settings.system.dt
    }

    fn state_names(settings: &Settings<Self>) -> Vec<String> {
        let poles =
            (1..=settings.system.poles).flat_map(|i| [format!("theta_{i}"), format!("omega_{i}")]);
        ["x".into(), "x_dot".into()].into_iter().chain(poles).collect()
    }

    fn control_names(_settings: &Settings<Self>) -> Vec<String> {
        vec!["force".into()]
    }

    fn conserved(settings: &Settings<Self>) -> Option<Conserved> {
        let chain = chain(settings);
        settings
            .actuator
            .is_empty()
            .then(|| Conserved { name: "energy", value: Box::new(move |x| chain.energy(x)) })
    }

    fn animation(settings: &Settings<Self>, Trajectory { states, .. }: &Trajectory) -> Animation {
        let PoleChainSettings { poles, half_length, dt, .. } = settings.system;
        let posture = |x: &Vec<f64>| {
            let cart = [x[0], 0.0];
            let mut chain = vec![cart];
            for pole in x[2..2 + 2 * poles].chunks_exact(2) {
                let [end_x, end_y] = chain[chain.len() - 1];
                chain.push([
                    end_x + 2.0 * half_length * pole[0].sin(),
                    end_y + 2.0 * half_length * pole[0].cos(),
                ]);
            }
            Posture { chain, boxes: vec![cart] }
        };
        let title = format!("Chain of {poles} pole{} on a cart", if poles == 1 { "" } else { "s" });
        let stage =
            Stage { title, size: 0.5 * half_length, floor: Some(-0.25 * half_length), mark: None };
        mechanics(&stage, &states.iter().map(posture).collect::<Vec<_>>(), dt)
    }
}

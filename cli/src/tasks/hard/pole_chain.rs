//! Chain of poles on a cart: settings, limits and animation.

use crate::operations::trajectory::Trajectory;
use crate::settings::config_error::{ConfigError, allowed, count, finite, positive};
use crate::settings::{Joined, Method};
use crate::tasks::hard::{Nothing, Start, UprightLoss, in_scene, upright, validate_upright};
use crate::tasks::{Conserved, Settings, TaskSpec};
use physgrad::DynTask;
use physgrad::Number;
use physgrad::graph::GraphTask;
use physgrad::tasks::{self, CartPoleSystem};
use physgrad_plot::{Animation, Posture, Stage, mechanics};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Largest number of poles of a chain that is recorded.
const RECORDED: usize = 5;

/// Task `pole_chain`.
#[derive(Clone, Debug)]
pub struct PoleChain;

/// Settings that the task adds to the section `system`.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InitialStates {
    /// Distribution of initial states.
    start: Start,
}

/// Returns an error if the number varies.
fn fixed(name: &str, number: Number) -> Result<(), ConfigError> {
    let value = toml::Value::try_from(number).expect("a number is a plain value");
    allowed(&format!("system.{name}"), value, number.is_fixed(), "a number, which does not vary")
}

impl TaskSpec for PoleChain {
    type System = Joined<CartPoleSystem, InitialStates>;
    type Effects = Nothing;
    type Loss = UprightLoss;

    const NAME: &'static str = "pole_chain";
    const ABOUT: &'static str = "swing up a chain of poles, hinged end to end, on a cart";
    const EPOCHS: usize = 300;
    fn horizon() -> usize {
        100
    }
    const METHODS: &'static [Method] = &Method::ODE;

    fn system() -> Self::System {
        let system = CartPoleSystem { poles: 2, ..CartPoleSystem::default() };
        Joined(system, InitialStates { start: Start::Hanging })
    }

    fn validate(settings: &Settings<Self>) -> Result<(), ConfigError> {
        let system = settings.system.0;
        let CartPoleSystem { poles, cart_mass, pole_mass, half_length, gravity, dt } = system;
        count("system.poles", poles, 1..=20)?;
        for (name, number) in
            [("cart_mass", cart_mass), ("pole_mass", pole_mass), ("half_length", half_length)]
        {
            fixed(name, number)?;
            positive(&format!("system.{name}"), number)?;
        }
        fixed("gravity", gravity)?;
        finite("system.gravity", gravity)?;
        positive("system.dt", dt)?;
        tasks::PoleChain(system).check().map_err(|error| {
            ConfigError::new("system.cart_mass", format!("is {}: {error}", cart_mass.nominal()))
        })?;
        validate_upright(settings)
    }

    fn task(settings: &Settings<Self>) -> DynTask {
        let chain = tasks::PoleChain(settings.system.0);
        let task = upright(settings, chain, 2, settings.system.1.start, 30.0);
        // Straight-line code is faster than loops over poles, but takes time to record: for 20 poles
        // 0.6 s. Adaptive and implicit methods branch, so they are not recorded.
        let recorded = (settings.system.0.poles <= RECORDED).then(|| GraphTask::of(&task));
        match recorded {
            Some(Ok(recorded)) => in_scene(settings, recorded),
            _ => in_scene(settings, task),
        }
    }

    fn variants() -> Vec<(String, Settings<Self>)> {
        let of = |poles: usize| {
            let mut settings = Settings::<Self>::defaults();
            settings.system.0.poles = poles;
            (format!("{poles} poles"), settings)
        };
        vec![of(2), of(5)]
    }

    fn dt(settings: &Settings<Self>) -> f64 {
        settings.system.0.dt
    }

    fn state_names(settings: &Settings<Self>) -> Vec<String> {
        let poles = (1..=settings.system.0.poles)
            .flat_map(|i| [format!("theta_{i}"), format!("omega_{i}")]);
        ["x".into(), "x_dot".into()].into_iter().chain(poles).collect()
    }

    fn control_names(_settings: &Settings<Self>) -> Vec<String> {
        vec!["force".into()]
    }

    fn conserved(settings: &Settings<Self>) -> Option<Conserved> {
        let chain = tasks::PoleChain(settings.system.0);
        settings
            .actuator
            .is_empty()
            .then(|| Conserved { name: "energy", value: Box::new(move |x| chain.energy(x)) })
    }

    fn animation(settings: &Settings<Self>, Trajectory { states, .. }: &Trajectory) -> Animation {
        let CartPoleSystem { poles, half_length, dt, .. } = settings.system.0;
        let half_length = half_length.nominal();
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

//! What the program knows of a task beyond its physics: settings, defaults, limits, names, a picture.

mod cart_pole;
mod guidance;
mod hard;
mod network;
mod quantum;
mod schema;

pub use network::{MlpSettings, Network};
pub use schema::schema;

use super::problem::Problem;
use super::scene::Scene;
use super::settings::{Method, Settings};
use physgrad::report::Animation;
use physgrad::{Named, Policy, Task};
use schemars::JsonSchema;
use serde::{Serialize, de::DeserializeOwned};
use std::fmt::Debug;
use toml::Table;

/// A section of a scene's settings.
pub trait Section: Clone + Debug + Serialize + DeserializeOwned + JsonSchema + Send + Sync + 'static {}
impl<T: Clone + Debug + Serialize + DeserializeOwned + JsonSchema + Send + Sync + 'static> Section for T {}

/// What a task name stands for. Which effects are present decides which type of task it becomes.
pub trait Kind: Clone + Debug + Send + Sync + 'static {
    /// The `system` section: settings of the physics.
    type System: Section;
    /// The `effects` section: a subsection for every effect that is present.
    type Effects: Section + Default;
    /// The `loss` section: settings of the cost.
    type Loss: Section + Default;
    /// The `policy` section; its defaults are the task's.
    type Network: Network;

    /// The task's name.
    const NAME: &'static str;
    /// What it is about, in a line.
    const ABOUT: &'static str;
    /// Default number of epochs.
    const EPOCHS: usize;
    /// Default number of steps.
    const HORIZON: usize;
    /// The methods that can take its steps, beside its own.
    const METHODS: &'static [Method] = &[];
    /// Every effect, in the order of the section.
    const EFFECTS: &'static [Info] = &[];

    /// The default physics.
    fn system() -> Self::System;
    /// What is out of range among the sections `system`, `effects` and `loss`, and what nothing reads.
    fn validate(settings: &Settings<Self>) -> Result<(), Problem>;
    /// Hands the task and the policy that the settings describe to the visitor. One arm for every combination of effects.
    fn visit<V: Visit>(settings: &Settings<Self>, visitor: V) -> V::Out;
    /// Settings worth a gradient check, with a name for each.
    fn variants() -> Vec<(String, Settings<Self>)>;

    /// Seconds per step.
    fn dt(settings: &Settings<Self>) -> f64;
    /// What the components of the state are called, those that effects add included.
    fn state_names(settings: &Settings<Self>) -> Vec<String>;
    /// What the components of the control are called.
    fn control_names(settings: &Settings<Self>) -> Vec<String>;
    /// What keeps its value while the policy does nothing, if anything does.
    fn conserved(_settings: &Settings<Self>) -> Option<Conserved> {
        None
    }
    /// A rollout that moves: states and controls step by step.
    fn animation(settings: &Settings<Self>, states: &[Vec<f64>], controls: &[Vec<f64>]) -> Animation;
}

/// An effect under the key that a scene has it under, if it is there.
fn named<T, E: From<T>>(name: &'static str, effect: Option<T>) -> Option<Named<E>> {
    effect.map(|effect| Named { name, effect: effect.into() })
}

/// What one may want to know of an effect, or of what is between policy and physics.
#[derive(Clone, Copy, Debug)]
pub struct Info {
    /// Its key in the section.
    pub name: &'static str,
    /// What it adds.
    pub equation: &'static str,
    /// How its derivative comes about, and where it is not one.
    pub derivative: &'static str,
}

/// A function of the state that keeps its value in continuous time.
pub struct Conserved {
    /// What it is called.
    pub name: &'static str,
    /// Its value at a state.
    pub value: OfState,
}

type OfState = Box<dyn Fn(&[f64]) -> f64>;

impl Conserved {
    /// How far it moves at most from where it began, over all samples, in relation to its largest size.
    pub fn drift(&self, samples: &[Vec<Vec<f64>>]) -> f64 {
        let (mut drift, mut size) = (0.0_f64, 0.0_f64);
        for states in samples {
            let start = (self.value)(&states[0]);
            for value in states.iter().map(|x| (self.value)(x)) {
                (drift, size) = (drift.max((value - start).abs()), size.max(value.abs()));
            }
        }
        // Of no samples, NaN.
        drift / size
    }
}

/// What needs the types of task and policy. It is compiled once for each of them, so it should do little.
pub trait Visit {
    /// What comes of it.
    type Out;
    /// Does its work.
    fn visit<T: Task + Clone + 'static, P: Policy + Clone + 'static>(self, task: T, policy: P) -> Self::Out;
}

/// Every task.
pub const KINDS: [&dyn AnyKind; 9] = [
    &cart_pole::CartPole,
    &guidance::Guidance,
    &quantum::Quantum,
    &hard::Lqr,
    &hard::DoublePendulum,
    &hard::PoleChain,
    &hard::Slider,
    &hard::Bounce,
    &hard::Push,
];

/// A [`Kind`] of which one need not know which.
pub trait AnyKind: Send + Sync {
    /// The task's name.
    fn name(&self) -> &'static str;
    /// What it is about, in a line.
    fn about(&self) -> &'static str;
    /// Every effect.
    fn effects(&self) -> &'static [Info];
    /// The methods that can take its steps, beside its own.
    fn methods(&self) -> &'static [Method];
    /// A method of high order and steps in one of the policy, to compare others with.
    fn reference(&self) -> (&'static str, usize);
    /// The default settings.
    fn defaults(&self) -> Table;
    /// These settings, in which nothing is missing but what has a default of its own, in full.
    fn fill(&self, settings: Table) -> Result<Table, Problem>;
    /// A scene of these settings, which must be complete.
    fn scene(&'static self, settings: Table) -> Result<Scene, Problem>;
    /// The JSON schema of its scenes.
    fn schema(&self) -> serde_json::Value;
    /// Scenes worth a gradient check, with a name for each.
    fn variants(&'static self) -> Vec<(String, Scene)>;
}

impl<K: Kind> AnyKind for K {
    fn name(&self) -> &'static str {
        K::NAME
    }

    fn about(&self) -> &'static str {
        K::ABOUT
    }

    fn effects(&self) -> &'static [Info] {
        K::EFFECTS
    }

    fn methods(&self) -> &'static [Method] {
        K::METHODS
    }

    fn reference(&self) -> (&'static str, usize) {
        let best = [Method::Tsit5, Method::Pade].into_iter().find(|method| K::METHODS.contains(method));
        (best.map_or("own", Method::name), 128)
    }

    fn defaults(&self) -> Table {
        Settings::<K>::defaults().table()
    }

    fn fill(&self, settings: Table) -> Result<Table, Problem> {
        Ok(Settings::<K>::fill(settings)?.table())
    }

    fn scene(&'static self, settings: Table) -> Result<Scene, Problem> {
        let settings = Settings::<K>::fill(settings)?;
        settings.validate()?;
        Ok(Scene::new(self, settings))
    }

    fn schema(&self) -> serde_json::Value {
        schema::of::<Settings<K>>(self)
    }

    fn variants(&'static self) -> Vec<(String, Scene)> {
        K::variants().into_iter().map(|(name, settings)| (name, Scene::new(self, settings))).collect()
    }
}

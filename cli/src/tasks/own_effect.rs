//! [`ProgramEffect`]: an effect of the user, with its fields as settings.

use crate::settings::config_error::ConfigError;
use crate::settings::{Info, reading};
use crate::tasks::own_numbers::Owner;
use crate::tasks::{Section, schema};
use physgrad::Effect;
use physgrad::effect::{DynEffect, Named};
use std::any::Any;
use std::marker::PhantomData;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use toml::{Table, Value};

/// An effect that scenes add by its name, in the section `effects.NAME`.
///
/// The fields of the effect are the settings of this section. `Default` gives their default values.
/// Fields of type [`Number`](physgrad::Number) may be drawn or trained if [`Effect::numbers`] lists
/// them. The comment on the struct is the description of the effect.
///
/// [`Program::effect`](crate::Program::effect) registers the effect.
pub trait ProgramEffect: Effect<Self::Model> + Section + Default {
    /// Model that the effect reads, for instance [`CartPoleSystem`](physgrad::tasks::CartPoleSystem).
    type Model: 'static;
    /// Name of the task that accepts the effect.
    const TASK: &'static str;
    /// Name of the effect in scenes: lower case letters, digits and underscores.
    const NAME: &'static str;
    /// Equation of the added term, for example a force.
    const EQUATION: &'static str;
    /// Method of differentiation, for the output of `explain` and `effects`.
    const DERIVATIVE: &'static str = "dual numbers";

    /// Checks the settings. Default: all values are valid.
    ///
    /// # Errors
    /// The name of a field and its allowed values, for instance `("force", "a positive number")`.
    fn validate(&self) -> Result<(), (&'static str, &'static str)> {
        Ok(())
    }
}

/// Object-safe [`ProgramEffect`], without a value.
pub trait AnyEffectSpec: Send + Sync {
    /// Name of the task that accepts the effect.
    fn task(&self) -> &'static str;
    /// Name and documentation.
    fn info(&self) -> Info;
    /// JSON schema of the section.
    fn schema(&self) -> serde_json::Value;
    /// Reads a section with the given key. Missing settings have their defaults.
    fn read(&self, key: &'static str, section: Table) -> Result<SceneEffect, ConfigError>;
}

/// Entry of a [`ProgramEffect`] in the list of effects.
pub struct OwnEffect<E>(PhantomData<fn() -> E>);

impl<E> OwnEffect<E> {
    pub const NEW: Self = Self(PhantomData);
}

impl<E: ProgramEffect> AnyEffectSpec for OwnEffect<E> {
    fn task(&self) -> &'static str {
        E::TASK
    }

    fn info(&self) -> Info {
        Info { name: E::NAME, equation: E::EQUATION, derivative: E::DERIVATIVE }
    }

    fn schema(&self) -> serde_json::Value {
        schema::of_section::<E>(&table(&E::default()))
    }

    fn read(&self, key: &'static str, section: Table) -> Result<SceneEffect, ConfigError> {
        let mut settings = table(&E::default());
        reading::overlay(&mut settings, &section);
        let effect: E = reading::read(settings).map_err(|error| error.within(key))?;
        let section = table(&effect);
        let invalid =
            |(field, allowed)| ConfigError::invalid(field, section.get(field), allowed).within(key);
        effect.validate().map_err(invalid)?;
        let owner = Owner { section: key, method: "Effect::numbers" };
        owner.check_numbers(&section, effect.numbers(), &effect.varied(0))?;
        Ok(SceneEffect {
            key,
            section,
            effect: Arc::new(DynEffect::new(effect)),
            used: Arc::default(),
        })
    }
}

fn table(effect: &impl Section) -> Table {
    Table::try_from(effect).expect("settings are plain tables")
}

/// An effect of the user in a scene.
#[derive(Clone, Debug)]
pub struct SceneEffect {
    /// Key of the effect's section.
    key: &'static str,
    /// All settings of the effect.
    section: Table,
    /// A [`DynEffect`] of some model.
    effect: Arc<dyn Any + Send + Sync>,
    /// True after [`SceneEffects::of`] returned the effect.
    used: Arc<AtomicBool>,
}

impl SceneEffect {
    fn of<B: 'static>(&self) -> Option<Named<DynEffect<B>>> {
        let effect = self.effect.downcast_ref::<DynEffect<B>>()?.clone();
        self.used.store(true, Ordering::Relaxed);
        Some(Named { name: self.key, effect })
    }
}

/// Effects of the user in a scene, in order of registration.
#[derive(Clone, Debug, Default)]
pub struct SceneEffects(Vec<SceneEffect>);

impl SceneEffects {
    /// Returns whether the scene has no effects of the user.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Effects of the model `B`.
    pub fn of<B: 'static>(&self) -> Vec<Named<DynEffect<B>>> {
        self.0.iter().filter_map(SceneEffect::of).collect()
    }

    /// Effects of the model `B`, converted to elements of a task's list of effects.
    pub(super) fn listed<B: 'static, E: From<DynEffect<B>>>(
        &self,
    ) -> impl Iterator<Item = Named<E>> {
        self.of().into_iter().map(|Named { name, effect }| Named { name, effect: E::from(effect) })
    }

    /// Returns an error if an effect has another model than `B`.
    pub(super) fn only_of<B: 'static>(&self) -> Result<(), ConfigError> {
        match self.0.iter().find(|effect| effect.of::<B>().is_none()) {
            Some(effect) => Err(ConfigError::new(
                effect.key,
                format!("has another model than {}", std::any::type_name::<B>()),
            )),
            None => Ok(()),
        }
    }

    /// Key of the first effect that [`of`](Self::of) never returned, if any.
    pub(super) fn unused(&self) -> Option<&'static str> {
        self.0.iter().find(|effect| !effect.used.load(Ordering::Relaxed)).map(|effect| effect.key)
    }

    /// Key of the first effect, if any.
    pub(super) fn first(&self) -> Option<&'static str> {
        self.0.first().map(|effect| effect.key)
    }

    /// Moves the sections of registered effects out of the settings of a scene.
    pub(super) fn take(
        registered: &[(&'static str, &'static dyn AnyEffectSpec)],
        table: &mut Table,
    ) -> Result<Self, ConfigError> {
        let Some(Value::Table(sections)) = table.get_mut("effects") else {
            return Ok(Self::default());
        };
        let mut effects = Vec::new();
        for &(key, spec) in registered {
            match sections.remove(spec.info().name) {
                Some(Value::Table(section)) => effects.push(spec.read(key, section)?),
                Some(other) => {
                    return Err(ConfigError::new(key, format!("is {other}; allowed: a section")));
                }
                None => {}
            }
        }
        Ok(Self(effects))
    }

    /// Adds the sections to the settings of a scene.
    pub(super) fn put(&self, table: &mut Table) {
        for SceneEffect { key, section, .. } in &self.0 {
            let sections = table.entry("effects").or_insert_with(|| Value::Table(Table::new()));
            let name = key.trim_start_matches("effects.");
            sections
                .as_table_mut()
                .expect("effects are a section")
                .insert(name.into(), Value::Table(section.clone()));
        }
    }
}

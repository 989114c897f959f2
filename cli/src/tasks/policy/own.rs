//! [`ProgramPolicy`]: a policy of the user, with its settings.

use super::{Controlled, PolicyKind};
use crate::settings::config_error::ConfigError;
use crate::tasks::Section;
use physgrad::Policy;
use physgrad::policy::DynPolicy;
use toml::Table;

/// Settings of a policy that scenes choose by its name, as `policy.kind`.
///
/// The fields are the other settings of the section `policy`. `Default` gives their default values.
/// Every task accepts the policy, with its sizes from the scene.
///
/// [`Program::policy`](crate::Program::policy) registers the policy.
pub trait ProgramPolicy: Section + Default {
    /// The policy.
    type Policy: Policy + 'static;
    /// Name of the policy in scenes: lower case letters, digits and underscores.
    const NAME: &'static str;
    /// Description in one line.
    const ABOUT: &'static str = "A policy of this program.";

    /// Checks the settings. Default: all values are valid.
    ///
    /// # Errors
    /// The name of a field and its allowed values, for instance `("units", "1 to 1000")`.
    fn validate(&self) -> Result<(), (&'static str, &'static str)> {
        Ok(())
    }
    /// The policy with as many observations and controls as the scene has.
    ///
    /// # Errors
    /// Why the policy does not suit the scene, as text after "`policy.kind`".
    fn policy(&self, scene: &Controlled) -> Result<Self::Policy, String>;
}

impl<S: ProgramPolicy> PolicyKind for S {
    const NAME: &'static str = <S as ProgramPolicy>::NAME;
    const ABOUT: &'static str = <S as ProgramPolicy>::ABOUT;

    fn validate(&self) -> Result<(), ConfigError> {
        let section = Table::try_from(self).expect("settings are plain tables");
        ProgramPolicy::validate(self)
            .map_err(|(field, allowed)| ConfigError::invalid(field, section.get(field), allowed))
    }

    fn build(&self, of: &Controlled) -> Result<DynPolicy, ConfigError> {
        let policy = self.policy(of).map_err(|what| ConfigError::new("kind", what))?;
        Ok(DynPolicy::new(policy))
    }
}

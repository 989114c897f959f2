//! The `effects` section of a task: each effect is declared once.

use crate::settings::Info;
use crate::settings::config_error::ConfigError;
use physgrad::effect::Named;

/// An `effects` section.
pub trait EffectsSection {
    /// Documentation of every effect, in order of evaluation.
    const INFO: &'static [Info];

    /// Checks the values of the effects that are present.
    fn validate_values(&self) -> Result<(), ConfigError>;
}

/// Conversion of a section's effects to elements of type `E`.
pub trait Present<E> {
    /// Effects that are present, with their keys, in order of evaluation.
    fn present(&self) -> Vec<Named<E>>;
}

/// An effect with its key in scenes, if it is present.
pub fn named<T, E: From<T>>(name: &'static str, effect: Option<T>) -> Option<Named<E>> {
    effect.map(|effect| Named { name, effect: effect.into() })
}

/// Declares an `effects` section: key and type of each effect, its documentation, and the limits of
/// its values.
///
/// A limit is a function of key and value. Every value needs a limit.
macro_rules! effects_section {
    (
        $(#[$doc:meta])*
        $section:ident {
            $(
                $(#[$about:meta])*
                $key:ident: $effect:ident {
                    equation: $equation:literal,
                    derivative: $derivative:literal,
                    limits: { $($value:ident: $limit:expr),+ },
                }
            )*
        }
    ) => {
        $(#[$doc])*
        #[derive(Clone, Debug, Default, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
        #[serde(deny_unknown_fields)]
        pub struct $section {
            $($(#[$about])* #[serde(skip_serializing_if = "Option::is_none")] $key: Option<$effect>,)*
        }

        impl crate::tasks::effects::EffectsSection for $section {
            const INFO: &'static [crate::settings::Info] =
                &[$(crate::settings::Info { name: stringify!($key), equation: $equation, derivative: $derivative }),*];

            fn validate_values(&self) -> Result<(), crate::settings::config_error::ConfigError> {
                $(if let Some($effect { $($value),+ }) = &self.$key {
                    $($limit(concat!("effects.", stringify!($key), ".", stringify!($value)), $value.clone())?;)+
                })*
                Ok(())
            }
        }

        impl<E> crate::tasks::effects::Present<E> for $section
        where
            $(E: From<$effect>),*
        {
            fn present(&self) -> Vec<physgrad::effect::Named<E>> {
                let effects = [
                    $(crate::tasks::effects::named(concat!("effects.", stringify!($key)), self.$key.clone())),*
                ];
                effects.into_iter().flatten().collect()
            }
        }
    };
}
pub(super) use effects_section;

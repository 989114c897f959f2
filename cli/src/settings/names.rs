//! Settings with a fixed set of values.

use crate::settings::config_error::one_of;
use physgrad::Field;
use physgrad::train::OptimizerKind;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{Deserializer, Error, Visitor};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::fmt;

#[derive(
    Clone,
    Copy,
    Debug,
    PartialEq,
    Eq,
    Serialize,
    Deserialize,
    JsonSchema,
    clap::ValueEnum,
    strum::IntoStaticStr,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
#[allow(missing_docs, reason = "doc comments would enter the schema of scenes")]
pub enum Precision {
    F32,
    F64,
}

impl Precision {
    /// Name in scenes and options.
    pub fn name(self) -> &'static str {
        self.into()
    }

    /// Machine epsilon: distance from 1 to the next larger number.
    pub fn epsilon(self) -> f64 {
        match self {
            Self::F32 => f64::from(f32::EPSILON),
            Self::F64 => f64::EPSILON,
        }
    }
}

/// Format of the metrics of a run, besides `metrics.csv`.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
pub enum LogFormat {
    /// `metrics.jsonl`: one JSON object per epoch.
    Jsonl,
    /// `events.out.tfevents.physgrad`: an event file of TensorBoard.
    Tensorboard,
}

impl LogFormat {
    pub const ALL: [Self; 2] = [Self::Jsonl, Self::Tensorboard];
}

/// [`Field`], read as name or letter and written as name.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct FieldName(pub Field);

impl JsonSchema for FieldName {
    fn schema_name() -> Cow<'static, str> {
        "Field".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let names = Field::ALL
            .iter()
            .map(|field| field.name())
            .chain(Field::ALL.iter().map(|field| field.letter()));
        json_schema!({ "type": "string", "enum": names.collect::<Vec<_>>() })
    }
}

impl TryFrom<String> for FieldName {
    type Error = physgrad::train::UnknownField;
    fn try_from(name: String) -> Result<Self, Self::Error> {
        name.parse().map(Self)
    }
}

impl From<FieldName> for String {
    fn from(field: FieldName) -> String {
        field.0.name().into()
    }
}

#[derive(
    Clone,
    Copy,
    Debug,
    PartialEq,
    Eq,
    Serialize,
    Deserialize,
    JsonSchema,
    clap::ValueEnum,
    strum::IntoStaticStr,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum ClipName {
    None,
    Value,
    Norm,
}

impl ClipName {
    /// Name in scenes and options.
    pub fn name(self) -> &'static str {
        self.into()
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DecayName {
    Constant,
    Cosine,
    Exponential,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EstimatorName {
    Exact,
    FirstOrder,
    ZerothOrder,
    InverseVariance,
    AlphaOrder,
}

/// [`OptimizerKind`] with default parameters, by name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(into = "String")]
pub struct OptimizerName(String);

impl OptimizerName {
    /// The optimizer.
    pub fn kind(&self) -> OptimizerKind {
        OptimizerKind::named(&self.0).expect("every name is an optimizer")
    }
}

impl Default for OptimizerName {
    fn default() -> Self {
        Self(OptimizerKind::NAMES[0].into())
    }
}

impl<'de> Deserialize<'de> for OptimizerName {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        const NAMES: &[&str] = &OptimizerKind::NAMES;
        struct Name;
        impl Visitor<'_> for Name {
            type Value = OptimizerName;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(&one_of(NAMES))
            }

            fn visit_str<E: Error>(self, name: &str) -> Result<OptimizerName, E> {
                let known = NAMES.contains(&name);
                if known {
                    Ok(OptimizerName(name.into()))
                } else {
                    Err(E::unknown_variant(name, NAMES))
                }
            }
        }
        deserializer.deserialize_string(Name)
    }
}

impl From<OptimizerName> for String {
    fn from(name: OptimizerName) -> Self {
        name.0
    }
}

impl JsonSchema for OptimizerName {
    fn schema_name() -> Cow<'static, str> {
        "Optimizer".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "string", "enum": OptimizerKind::NAMES })
    }
}

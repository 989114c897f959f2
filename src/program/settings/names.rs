//! Settings with a fixed set of values.

use physgrad::Field;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Precision {
    F32,
    F64,
}

impl Precision {
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }

    /// Machine epsilon: distance from 1 to the next larger number.
    pub fn epsilon(self) -> f64 {
        match self {
            Self::F32 => f64::from(f32::EPSILON),
            Self::F64 => f64::EPSILON,
        }
    }

    /// Smallest tolerance of an integrator: 100 machine epsilons.
    pub fn tolerance_floor(self) -> f64 {
        100.0 * self.epsilon()
    }
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
        let names = Field::ALL.iter().map(|field| field.name()).chain(Field::ALL.iter().map(|field| field.letter()));
        json_schema!({ "type": "string", "enum": names.collect::<Vec<_>>() })
    }
}

impl TryFrom<String> for FieldName {
    type Error = physgrad::UnknownField;
    fn try_from(name: String) -> Result<Self, Self::Error> {
        name.parse().map(Self)
    }
}

impl From<FieldName> for String {
    fn from(field: FieldName) -> String {
        field.0.name().into()
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum ClipName {
    None,
    Value,
    Norm,
}

impl ClipName {
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Value => "value",
            Self::Norm => "norm",
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum OptimizerName {
    Adam,
    Sgd,
    Momentum,
    RmsProp,
    Adagrad,
    Adadelta,
}

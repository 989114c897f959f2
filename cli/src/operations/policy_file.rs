//! Policy files: parameters of a policy as named tensors in the safetensors format.

use crate::platform::terminal::listed;
use crate::settings::reading::flat;
use anyhow::{Context, Result, bail};
use physgrad::Float;
use physgrad::policy::{AnyPolicy, NetworkLayer};
use physgrad::rng::{Purpose, stream};
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet};
use toml::Table;

/// Key of the description in the metadata of policy files and ONNX models.
pub const METADATA: &str = "physgrad";

/// Description of a policy, for other programs.
#[derive(Clone, Debug, Serialize)]
pub struct About {
    /// Version of physgrad.
    pub physgrad: &'static str,
    /// Name of the task.
    pub task: String,
    /// Names of the components of the observation.
    pub observations: Vec<String>,
    /// Names of the components of the control.
    pub controls: Vec<String>,
    /// Numbers that the scene trains. Their entries in the tensor `trained_params` are on a scale
    /// that depends on the bounds.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub trained: Vec<TrainedNumber>,
    /// Kind of the policy, for messages.
    #[serde(skip)]
    pub kind: String,
    /// What the parameters mean: the settings of the policy, without those of initial parameters and
    /// fixed numbers.
    pub policy: Table,
}

/// Number that a scene trains. An infinite bound is None.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainedNumber {
    pub name: String,
    pub min: Option<f64>,
    pub max: Option<f64>,
}

impl About {
    /// The description and the layers of the policy, as JSON.
    pub fn json<F: Float>(&self, policy: &dyn AnyPolicy<F>) -> Result<String> {
        #[derive(Serialize)]
        struct Described<'a> {
            #[serde(flatten)]
            about: &'a About,
            layers: Option<Vec<NetworkLayer>>,
        }
        Ok(serde_json::to_string(&Described { about: self, layers: policy.network() })?)
    }
}

/// Serializes the parameters of a policy.
pub fn write<F: Float>(about: &About, policy: &dyn AnyPolicy<F>, theta: &[F]) -> Result<Vec<u8>> {
    let bytes: Vec<u8> = theta.iter().flat_map(|t| t.to_le_bytes().as_ref().to_vec()).collect();
    let dtype = if F::NAME == "f32" { Dtype::F32 } else { Dtype::F64 };
    let width = size_of::<F>();
    let views = policy.tensors().into_iter().map(|t| {
        let view =
            TensorView::new(dtype, t.shape, &bytes[t.range.start * width..t.range.end * width])?;
        Ok((t.name, view))
    });
    let views: Vec<_> = views.collect::<Result<_, safetensors::SafeTensorError>>()?;
    // Writes a single entry, because the iteration order of the map is not fixed.
    let metadata = [(METADATA.to_owned(), about.json(policy)?)].into_iter().collect();
    Ok(safetensors::serialize(views, Some(metadata))?)
}

/// Name of the tensor with the trained numbers of a scene.
const NUMBERS: &str = "trained_params";

/// Description in a file. Files of other programs lack some of it.
#[derive(Default, Deserialize)]
struct Described {
    task: Option<String>,
    observations: Option<Vec<String>>,
    controls: Option<Vec<String>>,
    #[serde(default)]
    trained: Vec<TrainedNumber>,
    layers: Option<Vec<Map<String, Value>>>,
    policy: Option<Table>,
}

impl Described {
    fn read(bytes: &[u8]) -> Self {
        let header = SafeTensors::read_metadata(bytes)
            .ok()
            .and_then(|(_, header)| header.metadata().clone());
        let text = header.and_then(|mut header| header.remove(METADATA));
        text.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default()
    }
}

/// Checks that a file and a scene have one task, one meaning of observations and controls, and one
/// function of every layer: tensors of equal shapes have another meaning otherwise. Accepts a file
/// without a description.
///
/// # Errors
/// One of them differs.
fn check_meaning(bytes: &[u8], about: &About, policy: &dyn AnyPolicy<f64>) -> Result<()> {
    let Described { task, observations, controls, layers, policy: settings, .. } =
        Described::read(bytes);
    check_names(task, observations, controls, about)?;
    let own = serde_json::to_value(policy.network())?;
    for (i, (found, own)) in
        layers.iter().flatten().zip(own.as_array().into_iter().flatten()).enumerate()
    {
        if let Some((key, value)) = found.iter().find(|(key, value)| own.get(key) != Some(*value)) {
            let own = own.get(key).unwrap_or(&Value::Null);
            bail!(
                "the {key} of its layer {} is {value}, but {own} in the scene; use the `policy` section of its run, as in \
                 `policy.activation = \"relu\"`",
                i + 1
            );
        }
    }
    settings.map_or(Ok(()), |found| check_settings(&found, &about.policy))
}

/// Checks that parameters have one meaning with two settings of a policy, those of the parameters
/// first.
///
/// # Errors
/// The settings differ.
pub fn check_settings(found: &Table, own: &Table) -> Result<()> {
    let [found, own] = [found, own].map(|table| BTreeMap::from_iter(flat(table)));
    let keys: BTreeSet<&String> = found.keys().chain(own.keys()).collect();
    let Some(key) = keys.into_iter().find(|key| found.get(*key) != own.get(*key)) else {
        return Ok(());
    };
    let shown = |table: &BTreeMap<String, toml::Value>| {
        table.get(key).map_or("absent".to_owned(), toml::Value::to_string)
    };
    bail!(
        "its parameters belong to a policy whose `{key}` is {}, but {} in the scene; use the `policy` section of its run",
        shown(&found),
        shown(&own)
    )
}

/// Checks that a policy and a scene have one task, and one meaning of observations and controls.
///
/// # Errors
/// One of them differs.
pub fn check_names(
    task: Option<String>,
    observations: Option<Vec<String>>,
    controls: Option<Vec<String>>,
    about: &About,
) -> Result<()> {
    if let Some(task) = task.filter(|task| *task != about.task) {
        bail!(
            "it is a policy of the task `{task}`, but the task of the scene is `{}`; choose a policy of this task",
            about.task
        );
    }
    for (what, found, own) in [
        ("observations", observations, &about.observations),
        ("controls", controls, &about.controls),
    ] {
        if let Some(found) = found.filter(|found| found != own) {
            bail!(
                "its {what} are {}, but those of the scene are {}; use the system, effects and actuator of its run",
                listed(&found),
                listed(own)
            );
        }
    }
    Ok(())
}

/// Checks that a file and a scene train the same numbers within the same bounds. Accepts a file
/// without a list of numbers, and a scene that trains none.
///
/// # Errors
/// The numbers or bounds differ.
fn check_numbers(bytes: &[u8], about: &About) -> Result<()> {
    let Described { trained, .. } = Described::read(bytes);
    if trained.is_empty() || about.trained.is_empty() || trained == about.trained {
        return Ok(());
    }
    let listed = |numbers: &[TrainedNumber]| {
        let bound = |name: &str, bound: Option<f64>| {
            bound.map_or_else(String::new, |bound| format!(" {name} {bound}"))
        };
        let number = |TrainedNumber { name, min, max }: &_| {
            format!("{name}{}{}", bound("min", *min), bound("max", *max))
        };
        numbers.iter().map(number).collect::<Vec<_>>().join(", ")
    };
    bail!(
        "it has the trained numbers {}, but the scene trains {}; use the numbers and bounds of its run",
        listed(&trained),
        listed(&about.trained)
    )
}

/// Random parameters of the policy.
pub fn random(policy: &dyn AnyPolicy<f64>, seed: u64) -> Vec<f64> {
    let mut theta = vec![0.0; policy.param_count()];
    policy.init(&mut stream(seed, Purpose::Policy, 0), &mut theta);
    theta
}

/// Parameters of the policy of a scene from a file. Numbers that the scene trains keep their initial
/// values if the file has no tensor of trained numbers. Ignores this tensor if the scene trains no
/// numbers.
///
/// # Errors
/// The bytes are not in the safetensors format. A tensor is missing, is unknown, has another shape,
/// or has a type other than F32 and F64. A parameter is not finite. The description in the file
/// names another task, other observations, controls, trained numbers, or other functions of layers.
pub fn read(
    bytes: &[u8],
    about: &About,
    policy: &dyn AnyPolicy<f64>,
    seed: u64,
) -> Result<Vec<f64>> {
    check_numbers(bytes, about)?;
    let theta = tensors(bytes, policy, seed)?;
    check_meaning(bytes, about, policy)?;
    Ok(theta)
}

/// Parameters from the tensors of a file.
fn tensors(bytes: &[u8], policy: &dyn AnyPolicy<f64>, seed: u64) -> Result<Vec<f64>> {
    let file =
        SafeTensors::deserialize(bytes).context("it is not a file in the safetensors format")?;
    let tensors = policy.tensors();
    let is_unknown = |name: &&str| *name != NUMBERS && tensors.iter().all(|own| own.name != **name);
    // Names the alphabetically first unknown tensor, because the order of the names is not fixed.
    if let Some(name) = file.names().into_iter().filter(is_unknown).min() {
        let own: Vec<&str> = tensors.iter().map(|own| &*own.name).collect();
        bail!(
            "it has the tensor {name}, but the policy of the scene has {}; use the `policy` section of its run",
            if own.is_empty() { "none".to_owned() } else { own.join(", ") }
        );
    }
    let mut theta = random(policy, seed);
    for own in tensors {
        let found = match file.tensor(&own.name) {
            Err(_) if own.name == NUMBERS => continue,
            found => found.with_context(|| {
                format!("it has no tensor {}, but the policy of the scene does; use the `policy` section of its run", own.name)
            })?,
        };
        if found.shape() != own.shape {
            bail!(
                "its tensor {} has the shape {:?}, but the policy of the scene has {:?}; use the `policy` section of its run, and \
                 as many observations and controls",
                own.name,
                found.shape(),
                own.shape
            );
        }
        let values: Vec<f64> = match found.dtype() {
            Dtype::F32 => found
                .data()
                .as_chunks()
                .0
                .iter()
                .map(|&bytes| f32::from_le_bytes(bytes).into())
                .collect(),
            Dtype::F64 => {
                found.data().as_chunks().0.iter().map(|&bytes| f64::from_le_bytes(bytes)).collect()
            }
            other => bail!("its tensor {} has the type {other:?}; allowed: F32, F64", own.name),
        };
        if let Some(i) = values.iter().position(|value| !value.is_finite()) {
            bail!(
                "its tensor {} contains {} at index {i}; allowed: finite numbers",
                own.name,
                values[i]
            );
        }
        theta[own.range].copy_from_slice(&values);
    }
    Ok(theta)
}

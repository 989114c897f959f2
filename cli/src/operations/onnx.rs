//! ONNX models of policies. A model maps a batch of observations to a batch of controls.
//!
//! Every operator in the model has an f64 implementation in ONNX Runtime, so a model has the
//! precision of its run. The operator `Conv` has no f64 implementation. A convolution is therefore
//! a matrix product of its windows with its kernel.

mod messages;

use crate::operations::policy_file::{About, METADATA};
use anyhow::{Context, Result};
use messages::{
    Attribute, DOUBLE, Dimension, Entry, FLOAT, Graph, INT, INT64, Length, Model, Node,
    OperatorSet, Shape, TensorType, Type, ValueInfo,
};
use physgrad::Float;
use physgrad::policy::{Activation, AnyPolicy, Bound, LayerKind, NetworkLayer, Tensor};
use prost::Message;

/// Name of the input of a model.
pub const INPUT: &str = "observation";
/// Name of the output of a model.
pub const OUTPUT: &str = "control";

/// Version of the operators.
const OPERATORS: i64 = 13;
/// First version of the format with these operators.
const FORMAT: i64 = 7;

/// Serializes the policy with the parameters `theta`. Trained numbers of the system are not part of
/// the model.
///
/// # Errors
/// The policy is not a sequence of layers.
pub fn write<F: Float>(about: &About, policy: &dyn AnyPolicy<F>, theta: &[F]) -> Result<Vec<u8>> {
    let layers = policy.network().with_context(|| {
        format!(
            "the policy is of the kind {}, which is not a sequence of layers, so it has no ONNX model; those of the kinds mlp \
             and conv, without `base`, have one",
            about.kind
        )
    })?;
    let mut builder = Builder {
        theta,
        tensors: policy.tensors(),
        graph: Graph { name: about.task.clone(), ..Graph::default() },
    };
    let mut width = policy.observation_dim();
    let mut last = INPUT.to_owned();
    for layer in &layers {
        last = builder.layer(layer, last, &mut width)?;
    }
    let mut graph = builder.graph;
    if let Some(node) = graph.node.last_mut() {
        node.output = vec![OUTPUT.into()];
    }
    graph.input.push(batch::<F>(INPUT, &about.observations));
    graph.output.push(batch::<F>(OUTPUT, &about.controls));
    let model = Model {
        ir_version: FORMAT,
        producer_name: "physgrad".into(),
        producer_version: about.physgrad.into(),
        graph: Some(graph),
        opset_import: vec![OperatorSet { domain: String::new(), version: OPERATORS }],
        metadata_props: vec![Entry { key: METADATA.into(), value: about.json(policy)? }],
    };
    Ok(model.encode_to_vec())
}

/// Input or output with one row per sample and one column per name.
fn batch<F: Float>(name: &str, columns: &[String]) -> ValueInfo {
    let dim = [Length::Name("batch".into()), Length::Value(columns.len() as i64)];
    let shape = Shape { dim: dim.map(|value| Dimension { value: Some(value) }).into() };
    let tensor_type = TensorType { elem_type: data_type::<F>(), shape: Some(shape) };
    ValueInfo {
        name: name.into(),
        kind: Some(Type { tensor_type: Some(tensor_type) }),
        doc_string: columns.join(", "),
    }
}

fn data_type<F: Float>() -> i32 {
    if F::NAME == "f32" { FLOAT } else { DOUBLE }
}

/// Graph under construction. Methods that add nodes or constants return the name of the resulting
/// value.
struct Builder<'a, F> {
    theta: &'a [F],
    tensors: Vec<Tensor>,
    graph: Graph,
}

impl<F: Float> Builder<'_, F> {
    /// Adds a layer. `width` is the length of the input before the call, and the length of the
    /// output after the call.
    fn layer(&mut self, layer: &NetworkLayer, input: String, width: &mut usize) -> Result<String> {
        let find = |name: &String| self.tensors.iter().find(|tensor| tensor.name == *name).cloned();
        let kernel = find(&layer.kernel)
            .with_context(|| format!("the policy has no tensor {}", layer.kernel))?;
        let outputs = kernel.shape[kernel.shape.len() - 1];
        let bias = layer.bias.as_ref().and_then(find);
        // One row per number that an output reads, one column per output.
        let weights = self.parameters(&kernel, vec![kernel.range.len() / outputs, outputs]);
        let bias = bias.map(|bias| self.parameters(&bias, bias.shape.clone()));
        let (value, positions) = match layer.kind {
            LayerKind::Dense => {
                let inputs = [input, weights].into_iter().chain(bias).collect();
                (self.node("Gemm", inputs, None), 1)
            }
            LayerKind::Conv { stride } => {
                let (window, channels) =
                    (kernel.shape[0], kernel.range.len() / outputs / kernel.shape[0]);
                let positions = (*width / channels - window) / stride + 1;
                let places = (0..positions)
                    .flat_map(|q| (0..window).map(move |k| (stride * q + k) as i64))
                    .collect();
                let places = self.integers("windows", vec![positions, window], places);
                let grid = self.reshape(input, vec![0, -1, channels as i64]);
                let windows = self.node("Gather", vec![grid, places], Some(("axis", 1)));
                let rows = self.reshape(windows, vec![0, positions as i64, -1]);
                let product = self.node("MatMul", vec![rows, weights], None);
                let sum = match bias {
                    Some(bias) => self.node("Add", vec![product, bias], None),
                    None => product,
                };
                (self.reshape(sum, vec![0, -1]), positions)
            }
        };
        *width = positions * outputs;
        let value = match layer.activation {
            Some(activation) => self.activate(activation, value),
            None => value,
        };
        Ok(match &layer.bounds {
            Some(bounds) => self.bound(bounds, value),
            None => value,
        })
    }

    /// `middle + half_width tanh((v - origin) / half_width)` of each output.
    fn bound(&mut self, bounds: &[Bound], value: String) -> String {
        let row = |number: fn(&Bound) -> f64| bounds.iter().map(number).collect::<Vec<_>>();
        let steps = [
            ("Sub", "origin", row(|bound| bound.origin)),
            ("Mul", "inverse_half_width", row(|bound| 1.0 / bound.half_width)),
            ("Tanh", "", Vec::new()),
            ("Mul", "half_width", row(|bound| bound.half_width)),
            ("Add", "middle", row(|bound| bound.middle)),
        ];
        steps.into_iter().fold(value, |value, (op, name, numbers)| {
            let constant = (!numbers.is_empty()).then(|| self.numbers(name, &numbers));
            self.node(op, [value].into_iter().chain(constant).collect(), None)
        })
    }

    fn activate(&mut self, activation: Activation, z: String) -> String {
        match activation {
            Activation::Tanh => self.node("Tanh", vec![z], None),
            Activation::Relu => self.node("Relu", vec![z], None),
            Activation::Silu => {
                let sigma = self.node("Sigmoid", vec![z.clone()], None);
                self.node("Mul", vec![z, sigma], None)
            }
            // The operator `Gelu` needs version 20.
            Activation::Gelu => {
                let [scale, cube, half, one] = [
                    ("gelu_scale", Activation::GELU.0),
                    ("gelu_cube", Activation::GELU.1),
                    ("half", 0.5),
                    ("one", 1.0),
                ]
                .map(|(name, value)| self.number(name, value));
                let square = self.node("Mul", vec![z.clone(), z.clone()], None);
                let third = self.node("Mul", vec![square, z.clone()], None);
                let third = self.node("Mul", vec![third, cube], None);
                let sum = self.node("Add", vec![z.clone(), third], None);
                let inner = self.node("Mul", vec![sum, scale], None);
                let tanh = self.node("Tanh", vec![inner], None);
                let factor = self.node("Add", vec![tanh, one], None);
                let halved = self.node("Mul", vec![z, half], None);
                self.node("Mul", vec![halved, factor], None)
            }
        }
    }

    fn node(&mut self, op: &str, input: Vec<String>, attribute: Option<(&str, i64)>) -> String {
        let output = format!("value{}", self.graph.node.len() + 1);
        let attribute = attribute
            .map(|(name, i)| Attribute { name: name.into(), i, kind: INT })
            .into_iter()
            .collect();
        self.graph.node.push(Node {
            input,
            output: vec![output.clone()],
            op_type: op.into(),
            attribute,
        });
        output
    }

    /// Changes the shape. A length of 0 keeps the length of the input. A length of -1 stands for
    /// the remaining length.
    fn reshape(&mut self, input: String, shape: Vec<i64>) -> String {
        let shape = self.integers("shape", vec![shape.len()], shape);
        self.node("Reshape", vec![input, shape], None)
    }

    fn parameters(&mut self, tensor: &Tensor, shape: Vec<usize>) -> String {
        let bytes = self.theta[tensor.range.clone()]
            .iter()
            .flat_map(|t| t.to_le_bytes().as_ref().to_vec())
            .collect();
        self.constant(tensor.name.clone(), shape, data_type::<F>(), bytes)
    }

    fn number(&mut self, name: &str, value: f64) -> String {
        self.floats(name, Vec::new(), &[value])
    }

    fn numbers(&mut self, name: &str, values: &[f64]) -> String {
        self.floats(name, vec![values.len()], values)
    }

    fn floats(&mut self, name: &str, shape: Vec<usize>, values: &[f64]) -> String {
        let bytes = values.iter().flat_map(|&x| F::from_f64(x).to_le_bytes().as_ref().to_vec());
        self.constant(name.into(), shape, data_type::<F>(), bytes.collect())
    }

    fn integers(&mut self, name: &str, shape: Vec<usize>, values: Vec<i64>) -> String {
        let name = format!("{name}{}", self.graph.initializer.len() + 1);
        self.constant(
            name,
            shape,
            INT64,
            values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        )
    }

    /// Adds a constant, unless there is one of this name.
    fn constant(
        &mut self,
        name: String,
        shape: Vec<usize>,
        data_type: i32,
        raw_data: Vec<u8>,
    ) -> String {
        if self.graph.initializer.iter().all(|constant| constant.name != name) {
            let dims = shape.into_iter().map(|length| length as i64).collect();
            self.graph.initializer.push(messages::Tensor {
                dims,
                data_type,
                name: name.clone(),
                raw_data,
            });
        }
        name
    }
}

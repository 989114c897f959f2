//! [`Graph`]: scalar operations in the order of their evaluation.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::mem::discriminant;

/// Index of a number of a graph.
pub(super) type Id = u32;

/// One operation. Its arguments are earlier numbers.
///
/// These are the methods of [`Scalar`](crate::Scalar), a few functions that equations need, and the
/// derivatives of the functions of two arguments.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Op {
    /// An input of the graph.
    Input,
    /// A constant, as the bits of an `f64`.
    Const(u64),
    /// `a + b`
    Add(Id, Id),
    /// `a - b`
    Sub(Id, Id),
    /// `a b`
    Mul(Id, Id),
    /// `a / b`
    Div(Id, Id),
    /// `-a`
    Neg(Id),
    /// Absolute value.
    Abs(Id),
    /// Square root.
    Sqrt(Id),
    /// Exponential.
    Exp(Id),
    /// Natural logarithm.
    Ln(Id),
    /// Sine.
    Sin(Id),
    /// Cosine.
    Cos(Id),
    /// Hyperbolic tangent.
    Tanh(Id),
    /// Arcsine.
    Asin(Id),
    /// Arccosine.
    Acos(Id),
    /// Angle of the point with the coordinates `b` and `a`, as [`Scalar::atan2`](crate::Scalar).
    Atan2(Id, Id),
    /// `sqrt(a² + b²)`
    Hypot(Id, Id),
    /// `a / (a² + b²)`, a derivative of `Atan2`.
    PerSquare(Id, Id),
    /// `a / sqrt(a² + b²)`, a derivative of `Hypot`; 0 at the origin.
    Unit(Id, Id),
    /// `a` to the power of a constant.
    Powf(Id, Id),
    /// The smaller number; NaN if one of them is NaN.
    Min(Id, Id),
    /// The larger number; NaN if one of them is NaN.
    Max(Id, Id),
    /// The third number where the first is less than the second, else the fourth.
    Select(Id, Id, Id, Id),
    /// The third number where the first is less than the second or equal to it, else the fourth.
    SelectLe(Id, Id, Id, Id),
    /// The number without its derivative.
    Detach(Id),
}

impl Op {
    /// The arguments.
    pub fn args(&self) -> impl Iterator<Item = Id> + use<> {
        let (args, count) = match *self {
            Op::Input | Op::Const(_) => ([0; 4], 0),
            Op::Neg(a) | Op::Abs(a) | Op::Sqrt(a) | Op::Exp(a) | Op::Ln(a) | Op::Sin(a) => {
                ([a, 0, 0, 0], 1)
            }
            Op::Cos(a) | Op::Tanh(a) | Op::Asin(a) | Op::Acos(a) | Op::Detach(a) => {
                ([a, 0, 0, 0], 1)
            }
            Op::Add(a, b) | Op::Sub(a, b) | Op::Mul(a, b) | Op::Div(a, b) | Op::Atan2(a, b) => {
                ([a, b, 0, 0], 2)
            }
            Op::Hypot(a, b) | Op::PerSquare(a, b) | Op::Unit(a, b) | Op::Powf(a, b) => {
                ([a, b, 0, 0], 2)
            }
            Op::Min(a, b) | Op::Max(a, b) => ([a, b, 0, 0], 2),
            Op::Select(a, b, yes, no) | Op::SelectLe(a, b, yes, no) => ([a, b, yes, no], 4),
        };
        args.into_iter().take(count)
    }

    /// Arguments through which the result has a derivative.
    pub(super) fn differentiable_args(&self) -> impl Iterator<Item = Id> + use<> {
        let (skip, take) = match self {
            Op::Detach(_) => (0, 0),
            Op::Powf(..) => (0, 1),
            Op::Select(..) | Op::SelectLe(..) => (2, 2),
            _ => (0, 4),
        };
        self.args().skip(skip).take(take)
    }
}

/// Operations in the order of their evaluation. The first numbers are the inputs.
///
/// Equal operations are one number. Simplifications change no bit of a result, in f32 and in f64,
/// except the payload of a NaN. They therefore neither reassociate nor compute with constants.
#[derive(Clone, Debug, Default)]
pub(super) struct Graph {
    ops: Vec<Op>,
    known: HashMap<Op, Id>,
    inputs: usize,
    /// Number of calls of [`add`](Self::add).
    added: usize,
}

impl Graph {
    /// A graph of inputs alone.
    pub fn new(inputs: usize) -> Self {
        Self { ops: vec![Op::Input; inputs], known: HashMap::new(), inputs, added: 0 }
    }

    /// Number of inputs.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Number of operations that were added, equal and simplified ones included.
    pub(super) fn added(&self) -> usize {
        self.added
    }

    /// All operations.
    pub fn ops(&self) -> &[Op] {
        &self.ops
    }

    pub(super) fn op(&self, id: Id) -> Op {
        self.ops[id as usize]
    }

    /// The number of this operation, if the graph contains it.
    pub(super) fn find(&self, op: Op) -> Option<Id> {
        self.known.get(&op).copied()
    }

    /// A constant.
    pub fn constant(&mut self, value: f64) -> Id {
        self.push(Op::Const(value.to_bits()))
    }

    /// The value of a constant.
    pub fn as_constant(&self, id: Id) -> Option<f64> {
        if let Op::Const(bits) = self.op(id) { Some(f64::from_bits(bits)) } else { None }
    }

    fn push(&mut self, op: Op) -> Id {
        *self.known.entry(op).or_insert_with(|| {
            self.ops.push(op);
            self.ops.len() as Id - 1
        })
    }

    /// Adds an operation, or returns an equal number of the graph.
    ///
    /// # Panics
    /// If an argument is not a number of the graph.
    pub fn add(&mut self, op: Op) -> Id {
        assert!(op.args().all(|arg| (arg as usize) < self.ops.len()), "arguments precede results");
        self.added += 1;
        match self.simplified(op) {
            Simplified::Known(id) => id,
            // Sums and products commute.
            Simplified::New(Op::Add(a, b)) if a > b => self.push(Op::Add(b, a)),
            Simplified::New(Op::Mul(a, b)) if a > b => self.push(Op::Mul(b, a)),
            Simplified::New(op) => self.push(op),
        }
    }

    fn simplified(&mut self, op: Op) -> Simplified {
        use Simplified::{Known, New};
        let constant = |id: Id| self.as_constant(id);
        // 0.0 and -0.0 differ.
        let is = |id: Id, value: f64| constant(id).map(f64::to_bits) == Some(value.to_bits());
        let negated = |id: Id| if let Op::Neg(a) = self.op(id) { Some(a) } else { None };
        match op {
            Op::Add(a, b) if is(a, -0.0) => return Known(b),
            Op::Add(a, b) if is(b, -0.0) => return Known(a),
            Op::Sub(a, b) if is(b, 0.0) => return Known(a),
            Op::Sub(a, b) if is(a, -0.0) => return New(Op::Neg(b)),
            Op::Mul(a, b) if is(a, 1.0) => return Known(b),
            Op::Mul(a, b) | Op::Div(a, b) if is(b, 1.0) => return Known(a),
            Op::Mul(a, b) if is(a, -1.0) => return self.simplified(Op::Neg(b)),
            Op::Mul(a, b) if is(b, -1.0) => return self.simplified(Op::Neg(a)),
            Op::Detach(a) if constant(a).is_some() => return Known(a),
            Op::Min(a, b) | Op::Max(a, b) | Op::Select(_, _, a, b) | Op::SelectLe(_, _, a, b)
                if a == b =>
            {
                return Known(a);
            }
            _ => {}
        }
        match op {
            Op::Add(a, b) => match (negated(a), negated(b)) {
                (_, Some(b)) => New(Op::Sub(a, b)),
                (Some(a), None) => New(Op::Sub(b, a)),
                _ => New(op),
            },
            Op::Sub(a, b) => negated(b).map_or(New(op), |b| New(Op::Add(a, b))),
            Op::Neg(a) => match (negated(a), constant(a)) {
                (Some(a), _) => Known(a),
                (None, Some(value)) => Known(self.constant(-value)),
                _ => New(op),
            },
            Op::Div(a, b) => match constant(b) {
                Some(divisor) if is_power_of_two(divisor) => {
                    New(Op::Mul(a, self.constant(1.0 / divisor)))
                }
                _ => New(op),
            },
            // Of a constant and a number, NaN stays NaN without a test.
            Op::Min(a, b) => match (constant(a), constant(b)) {
                (Some(_), None) => New(Op::Select(a, b, a, b)),
                (None, Some(_)) => New(Op::Select(b, a, b, a)),
                _ => New(op),
            },
            Op::Max(a, b) => match (constant(a), constant(b)) {
                (Some(_), None) => New(Op::Select(b, a, a, b)),
                (None, Some(_)) => New(Op::Select(a, b, b, a)),
                _ => New(op),
            },
            _ => New(op),
        }
    }

    /// Which numbers the `roots` need, themselves included.
    pub(super) fn needed(&self, roots: impl IntoIterator<Item = Id>) -> Vec<bool> {
        let mut needed = vec![false; self.ops.len()];
        roots.into_iter().for_each(|id| needed[id as usize] = true);
        for i in (0..self.ops.len()).rev().filter(|&i| self.ops[i] != Op::Input) {
            if needed[i] {
                self.ops[i].args().for_each(|arg| needed[arg as usize] = true);
            }
        }
        needed
    }

    /// A hash of what the `roots` compute, equal for graphs that differ only in the order of their
    /// numbers.
    pub(super) fn structure(&self, roots: &[Id]) -> Vec<u64> {
        let mut hashes: Vec<u64> = Vec::with_capacity(self.ops.len());
        for (i, op) in self.ops.iter().enumerate() {
            let mut args: Vec<u64> = op.args().map(|arg| hashes[arg as usize]).collect();
            if let Op::Add(..) | Op::Mul(..) = op {
                args.sort_unstable();
            }
            let mut hasher = DefaultHasher::new();
            match op {
                Op::Input => i.hash(&mut hasher),
                Op::Const(bits) => bits.hash(&mut hasher),
                op => (discriminant(op), args).hash(&mut hasher),
            }
            hashes.push(hasher.finish());
        }
        roots.iter().map(|&id| hashes[id as usize]).collect()
    }
}

enum Simplified {
    Known(Id),
    New(Op),
}

/// Returns whether the reciprocal is exact in f32 and f64. The quotient then has the bits of the
/// product with the reciprocal.
fn is_power_of_two(value: f64) -> bool {
    let mantissa = value.to_bits() << 12;
    mantissa == 0 && (2f64.powi(-100)..=2f64.powi(100)).contains(&value.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_operations_are_one_number_and_simplifications_keep_signs_of_zeros() {
        let mut graph = Graph::new(2);
        let [zero, minus_zero, one, four] =
            [0.0, -0.0, 1.0, 4.0].map(|value| graph.constant(value));
        let sum = graph.add(Op::Add(0, 1));
        assert_eq!(sum, graph.add(Op::Add(1, 0)));
        assert_eq!(graph.add(Op::Add(0, minus_zero)), 0);
        assert_ne!(graph.add(Op::Add(0, zero)), 0, "-0.0 + 0.0 is 0.0");
        assert_eq!(graph.add(Op::Sub(0, zero)), 0);
        assert_ne!(graph.add(Op::Sub(0, minus_zero)), 0, "-0.0 - -0.0 is 0.0");
        assert_eq!(graph.add(Op::Mul(one, 0)), 0);
        assert_ne!(graph.add(Op::Mul(zero, 0)), zero, "0 times infinity is NaN");
        let (negated, quotient) = (graph.add(Op::Neg(1)), graph.add(Op::Div(0, four)));
        assert_eq!(graph.add(Op::Neg(negated)), 1);
        let difference = graph.add(Op::Add(0, negated));
        assert_eq!(graph.op(difference), Op::Sub(0, 1));
        assert!(matches!(graph.op(quotient), Op::Mul(..)));
    }
}

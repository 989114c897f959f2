//! [`adjoint`]: the reverse derivative of a graph, as a list of operations on cotangents.
//!
//! A cotangent can be added to another one and multiplied by a number, as
//! [`Cotangent`](crate::Cotangent) demands. One list therefore serves one cotangent or a pack of
//! several, and slopes are numbers of the graph, computed once.

use super::op::{Graph, Id, Op};

/// Index of a cotangent.
pub(super) type Bar = u32;

/// One operation on cotangents. Slopes are numbers of the graph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum BarOp {
    /// The cotangent of an output.
    Output,
    /// `a + b`
    Add(Bar, Bar),
    /// `a - b`
    Sub(Bar, Bar),
    /// `a slope`
    Mul(Bar, Id),
    /// `a + b slope`
    MulAdd(Bar, Bar, Id),
    /// `a - b slope`
    MulSub(Bar, Bar, Id),
}

impl BarOp {
    pub(super) fn bars(&self) -> impl Iterator<Item = Bar> + use<> {
        let bars = match *self {
            BarOp::Output => [None, None],
            BarOp::Mul(a, _) => [Some(a), None],
            BarOp::Add(a, b)
            | BarOp::Sub(a, b)
            | BarOp::MulAdd(a, b, _)
            | BarOp::MulSub(a, b, _) => [Some(a), Some(b)],
        };
        bars.into_iter().flatten()
    }

    pub(super) fn slope(&self) -> Option<Id> {
        match *self {
            BarOp::Mul(_, slope) | BarOp::MulAdd(_, _, slope) | BarOp::MulSub(_, _, slope) => {
                Some(slope)
            }
            _ => None,
        }
    }
}

/// A cotangent with a sign, so that no operation negates.
#[derive(Clone, Copy, Debug)]
pub(super) struct Signed {
    pub(super) bar: Bar,
    pub(super) minus: bool,
}

impl Signed {
    fn negated(self) -> Self {
        Self { minus: !self.minus, ..self }
    }
}

/// Operations on cotangents. The first ones are those of the outputs.
pub(super) struct Adjoint {
    pub(super) ops: Vec<BarOp>,
    /// Cotangents of the requested inputs. None where no output depends on the input.
    pub(super) inputs: Vec<Option<Signed>>,
}

/// Appends slopes to the graph, and returns the derivative of the `outputs` with respect to the
/// inputs `wrt`. Only numbers on a path between both have cotangents.
pub(super) fn adjoint(graph: &mut Graph, outputs: &[Id], wrt: &[Id]) -> Adjoint {
    let count = graph.ops().len();
    let mut active = vec![false; count];
    wrt.iter().for_each(|&id| active[id as usize] = true);
    for i in graph.inputs()..count {
        active[i] = graph.ops()[i].differentiable_args().any(|arg| active[arg as usize]);
    }
    let ops = vec![BarOp::Output; outputs.len()];
    let mut back = Backward { ops, bars: vec![None; count], active };
    for (k, &output) in outputs.iter().enumerate() {
        back.add(output, Signed { bar: k as Bar, minus: false });
    }
    for id in (graph.inputs()..count).rev() {
        if let Some(bar) = back.bars[id] {
            back.propagate(graph, id as Id, bar);
        }
    }
    let inputs = wrt.iter().map(|&id| back.bars[id as usize]).collect();
    Adjoint { ops: back.ops, inputs }
}

struct Backward {
    ops: Vec<BarOp>,
    /// Cotangents of the numbers of the graph, so far.
    bars: Vec<Option<Signed>>,
    active: Vec<bool>,
}

impl Backward {
    fn push(&mut self, op: BarOp) -> Bar {
        self.ops.push(op);
        self.ops.len() as Bar - 1
    }

    /// Adds a cotangent to that of the number `to`.
    fn add(&mut self, to: Id, bar: Signed) {
        let to = to as usize;
        if !self.active[to] {
            return;
        }
        self.bars[to] = Some(match self.bars[to] {
            None => bar,
            Some(sum) if sum.minus == bar.minus => {
                Signed { bar: self.push(BarOp::Add(sum.bar, bar.bar)), ..sum }
            }
            Some(sum) => Signed { bar: self.push(BarOp::Sub(sum.bar, bar.bar)), ..sum },
        });
    }

    /// Adds `bar slope` to the cotangent of the number `to`.
    fn add_product(&mut self, graph: &Graph, to: Id, bar: Signed, slope: Id) {
        if !self.active[to as usize] {
            return;
        }
        match graph.as_constant(slope) {
            Some(1.0) => return self.add(to, bar),
            Some(-1.0) => return self.add(to, bar.negated()),
            _ => {}
        }
        if let Op::Neg(slope) = graph.op(slope) {
            return self.add_product(graph, to, bar.negated(), slope);
        }
        self.bars[to as usize] = Some(match self.bars[to as usize] {
            None => Signed { bar: self.push(BarOp::Mul(bar.bar, slope)), ..bar },
            Some(sum) if sum.minus == bar.minus => {
                Signed { bar: self.push(BarOp::MulAdd(sum.bar, bar.bar, slope)), ..sum }
            }
            Some(sum) => Signed { bar: self.push(BarOp::MulSub(sum.bar, bar.bar, slope)), ..sum },
        });
    }

    /// Adds the cotangent of the number `id` to those of its arguments.
    fn propagate(&mut self, graph: &mut Graph, id: Id, bar: Signed) {
        match graph.op(id) {
            Op::Add(a, b) => {
                self.add(a, bar);
                self.add(b, bar);
            }
            Op::Sub(a, b) => {
                self.add(a, bar);
                self.add(b, bar.negated());
            }
            Op::Neg(a) => self.add(a, bar.negated()),
            Op::Mul(a, b) if a == b => {
                let twice = graph.add(Op::Add(a, a));
                self.add_product(graph, a, bar, twice);
            }
            Op::Mul(a, b) => {
                self.add_product(graph, a, bar, b);
                self.add_product(graph, b, bar, a);
            }
            Op::Div(a, b) => self.quotient(graph, [a, b, id], bar),
            Op::Atan2(y, x) => {
                let slopes = [graph.add(Op::PerSquare(x, y)), graph.add(Op::PerSquare(y, x))];
                self.add_product(graph, y, bar, slopes[0]);
                self.add_product(graph, x, bar.negated(), slopes[1]);
            }
            Op::Hypot(a, b) => {
                let slopes = [graph.add(Op::Unit(a, b)), graph.add(Op::Unit(b, a))];
                self.add_product(graph, a, bar, slopes[0]);
                self.add_product(graph, b, bar, slopes[1]);
            }
            Op::Select(a, b, yes, no) => self.branches(graph, [yes, no], bar, |graph, yes, no| {
                graph.add(Op::Select(a, b, yes, no))
            }),
            Op::SelectLe(a, b, yes, no) => {
                self.branches(graph, [yes, no], bar, |graph, yes, no| {
                    graph.add(Op::SelectLe(a, b, yes, no))
                })
            }
            Op::Min(a, b) => self.branches(graph, [a, b], bar, |graph, yes, no| {
                graph.add(Op::Select(a, b, yes, no))
            }),
            Op::Max(a, b) => self.branches(graph, [a, b], bar, |graph, yes, no| {
                graph.add(Op::Select(b, a, yes, no))
            }),
            op => {
                if let Some(a) = op.differentiable_args().next()
                    && self.active[a as usize]
                {
                    let (slope, bar) = match unary_slope(graph, op, id) {
                        (slope, false) => (slope, bar),
                        (slope, true) => (slope, bar.negated()),
                    };
                    self.add_product(graph, a, bar, slope);
                }
            }
        }
    }

    /// Cotangents of the numerator and the divisor of the quotient `q = a / b`: `bar / b` and
    /// `-bar / b q`.
    fn quotient(&mut self, graph: &mut Graph, [a, b, q]: [Id; 3], bar: Signed) {
        let one = graph.constant(1.0);
        let inverse = graph.add(Op::Div(one, b));
        if !self.active[b as usize] {
            return self.add_product(graph, a, bar, inverse);
        }
        let scaled = Signed { bar: self.push(BarOp::Mul(bar.bar, inverse)), ..bar };
        self.add(a, scaled);
        self.add_product(graph, b, scaled.negated(), q);
    }

    /// Cotangents of two numbers of which one is selected. `select` returns its second argument
    /// where the first number is selected, else the third.
    fn branches(
        &mut self,
        graph: &mut Graph,
        [yes, no]: [Id; 2],
        bar: Signed,
        select: impl Fn(&mut Graph, Id, Id) -> Id,
    ) {
        let [zero, one] = [0.0, 1.0].map(|value| graph.constant(value));
        for (number, slopes) in [(yes, [one, zero]), (no, [zero, one])] {
            if self.active[number as usize] {
                let slope = select(graph, slopes[0], slopes[1]);
                self.add_product(graph, number, bar, slope);
            }
        }
    }
}

/// Derivative of a function of one number, without its sign, and whether it is negative. `id` is
/// the value of the function.
fn unary_slope(graph: &mut Graph, op: Op, id: Id) -> (Id, bool) {
    let slope = match op {
        Op::Abs(a) => {
            let [zero, one, minus] = [0.0, 1.0, -1.0].map(|value| graph.constant(value));
            graph.add(Op::Select(a, zero, minus, one))
        }
        Op::Sqrt(_) => {
            let half = graph.constant(0.5);
            graph.add(Op::Div(half, id))
        }
        Op::Exp(_) => id,
        Op::Ln(a) => {
            let one = graph.constant(1.0);
            graph.add(Op::Div(one, a))
        }
        Op::Sin(a) => graph.add(Op::Cos(a)),
        Op::Cos(a) => return (graph.add(Op::Sin(a)), true),
        Op::Tanh(_) => {
            let one = graph.constant(1.0);
            let square = graph.add(Op::Mul(id, id));
            graph.add(Op::Sub(one, square))
        }
        Op::Asin(a) => arcsine_slope(graph, a),
        Op::Acos(a) => return (arcsine_slope(graph, a), true),
        Op::Powf(a, exponent) => {
            let power = graph.as_constant(exponent).expect("exponents are constants");
            let less = graph.constant(power - 1.0);
            let rest = graph.add(Op::Powf(a, less));
            graph.add(Op::Mul(exponent, rest))
        }
        op => unreachable!("{op:?} is not a function of one number"),
    };
    (slope, false)
}

/// `1 / sqrt((1 - a) (1 + a))`
fn arcsine_slope(graph: &mut Graph, a: Id) -> Id {
    let one = graph.constant(1.0);
    let (less, more) = (graph.add(Op::Sub(one, a)), graph.add(Op::Add(a, one)));
    let square = graph.add(Op::Mul(less, more));
    let root = graph.add(Op::Sqrt(square));
    graph.add(Op::Div(one, root))
}

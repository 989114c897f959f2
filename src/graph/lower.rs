//! [`lower`]: a graph as instructions on registers, grouped by kind.

use super::adjoint::{Adjoint, Bar, BarOp, Signed};
use super::op::{Graph, Id, Op};
use crate::numbers::kernels::interpreter::{
    BarCode, BarProgram, NumberCode, NumberProgram, Registers,
};
use std::collections::BTreeSet;

/// Instructions within this distance in the order of the graph may change their order. A bound
/// keeps the numbers of registers small.
const WINDOW: usize = 256;

/// The graph needs more registers than instructions can name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TooLarge;

/// Numbers of a graph as a program.
#[derive(Clone, Debug)]
pub(super) struct Numbers {
    pub(super) program: NumberProgram,
    /// Registers of the requested numbers.
    pub(super) outputs: Vec<u16>,
}

/// Instructions that compute the `outputs`. The registers of the inputs follow the constants.
pub(super) fn numbers(graph: &Graph, outputs: &[Id]) -> Result<Numbers, TooLarge> {
    let needed = graph.needed(outputs.iter().copied());
    let of_constants = (0..graph.ops().len() as Id)
        .filter(|&id| needed[id as usize] && matches!(graph.op(id), Op::Const(_)));
    let constants: Vec<Id> = of_constants.collect();
    let mut emitter = Emitter::new(graph, &needed, outputs);
    for id in 0..graph.ops().len() as Id {
        if needed[id as usize] && !emitter.is_part_of_its_reader(id) {
            emitter.emit(id);
        }
    }
    outputs.iter().for_each(|&id| emitter.emit(id));
    let pinned: Vec<Id> = constants.iter().copied().chain(0..graph.inputs() as Id).collect();
    let steps = grouped(emitter.steps, graph.ops().len());
    let Allocated { list, registers, of } = allocate(&steps, graph.ops().len(), &pinned, outputs)?;
    let values = constants.iter().map(|&id| graph.as_constant(id).expect("a constant"));
    Ok(Numbers {
        program: NumberProgram::new(&list, values.collect(), registers),
        outputs: outputs.iter().map(|&id| of[id as usize]).collect(),
    })
}

/// Cotangents of an adjoint as a program, and the numbers that it needs.
#[derive(Clone, Debug)]
pub(super) struct Bars {
    pub(super) numbers: NumberProgram,
    pub(super) program: BarProgram,
    /// Registers of the cotangents of the requested inputs, and whether they are negative.
    pub(super) inputs: Vec<Option<(u16, bool)>>,
}

/// Instructions that compute the cotangents of the inputs.
pub(super) fn bars(graph: &Graph, adjoint: &Adjoint) -> Result<Bars, TooLarge> {
    let roots: Vec<Bar> = adjoint.inputs.iter().flatten().map(|signed| signed.bar).collect();
    let mut needed = vec![false; adjoint.ops.len()];
    roots.iter().for_each(|&bar| needed[bar as usize] = true);
    for i in (0..adjoint.ops.len()).rev().filter(|&i| adjoint.ops[i] != BarOp::Output) {
        if needed[i] {
            adjoint.ops[i].bars().for_each(|bar| needed[bar as usize] = true);
        }
    }
    let ops = || adjoint.ops.iter().enumerate().filter(|(i, _)| needed[*i]);
    let mut slopes: Vec<Id> = ops().filter_map(|(_, op)| op.slope()).collect();
    slopes.sort_unstable();
    slopes.dedup();
    let numbers = numbers(graph, &slopes)?;
    let slope = |id: Option<Id>| {
        let at = id.map(|id| slopes.binary_search(&id).expect("a slope of an operation"));
        at.map_or(0, |at| numbers.outputs[at])
    };
    let outputs: Vec<Bar> = (0..adjoint.ops.len() as Bar)
        .take_while(|&bar| adjoint.ops[bar as usize] == BarOp::Output)
        .collect();
    let steps = ops().filter_map(|(i, op)| {
        let (code, args) = match *op {
            BarOp::Output => return None,
            BarOp::Add(a, b) => (BarCode::Add, [a, NONE, b, NONE]),
            BarOp::Sub(a, b) => (BarCode::Sub, [a, NONE, b, NONE]),
            BarOp::Mul(a, _) => (BarCode::Mul, [a, NONE, NONE, NONE]),
            BarOp::MulAdd(sum, a, _) => (BarCode::MulAdd, [a, NONE, sum, NONE]),
            BarOp::MulSub(sum, a, _) => (BarCode::MulSub, [a, NONE, sum, NONE]),
        };
        Some(Instruction { code, args, results: [i as Bar, NONE], fixed: slope(op.slope()) })
    });
    let steps = grouped(steps.collect(), adjoint.ops.len());
    let allocated = allocate(&steps, adjoint.ops.len(), &outputs, &roots)?;
    let inputs = adjoint
        .inputs
        .iter()
        .map(|input| input.map(|Signed { bar, minus }| (allocated.of[bar as usize], minus)));
    let count = numbers.program.registers::<f64>().len();
    Ok(Bars {
        inputs: inputs.collect(),
        program: BarProgram::new(&allocated.list, count, allocated.registers),
        numbers: numbers.program,
    })
}

/// No number.
const NONE: u32 = u32::MAX;
/// A result that nothing reads.
const UNREAD: u32 = u32::MAX - 1;

/// An instruction on numbers or cotangents, before registers are allocated.
#[derive(Clone, Copy, Debug)]
struct Instruction<Code> {
    code: Code,
    /// Operands `a`, `b`, `c` and `e`.
    args: [u32; 4],
    /// Results `d` and `e`.
    results: [u32; 2],
    /// Register `b`, if it is not that of an operand.
    fixed: u16,
}

impl<Code> Instruction<Code> {
    fn args(&self) -> impl Iterator<Item = usize> + use<Code> {
        self.args.into_iter().filter(|&arg| arg != NONE).map(|arg| arg as usize)
    }

    fn results(&self) -> impl Iterator<Item = usize> + use<Code> {
        self.results.into_iter().filter(|&result| result < UNREAD).map(|result| result as usize)
    }
}

/// Chooses instructions for the numbers of a graph.
struct Emitter<'a> {
    graph: &'a Graph,
    /// Number of needed operations that read each number. Outputs count twice.
    readers: Vec<u32>,
    done: Vec<bool>,
    steps: Vec<Instruction<NumberCode>>,
}

impl<'a> Emitter<'a> {
    fn new(graph: &'a Graph, needed: &[bool], outputs: &[Id]) -> Self {
        let mut readers = vec![0; graph.ops().len()];
        outputs.iter().for_each(|&id| readers[id as usize] += 2);
        let mut done = vec![false; graph.ops().len()];
        for (i, op) in graph.ops().iter().enumerate() {
            done[i] = matches!(op, Op::Input | Op::Const(_));
            if needed[i] {
                op.args().for_each(|arg| readers[arg as usize] += 1);
            }
        }
        Self { graph, readers, done, steps: Vec::new() }
    }

    /// Arguments of a sum, a difference or a product that only one operation reads.
    fn single(&self, id: Id) -> Option<Op> {
        let is_single = self.readers[id as usize] == 1 && !self.done[id as usize];
        is_single.then(|| self.graph.op(id))
    }

    /// Returns whether the operation that reads this number may compute it too. If it does not,
    /// it emits the number before itself.
    fn is_part_of_its_reader(&self, id: Id) -> bool {
        matches!(self.single(id), Some(Op::Add(..) | Op::Sub(..) | Op::Mul(..)))
    }

    /// Instruction of a number, with its operands.
    fn select(&self, id: Id) -> (NumberCode, [Id; 4]) {
        use NumberCode as Code;
        let op = self.graph.op(id);
        match op {
            Op::Add(a, b) => match (self.single(a), self.single(b)) {
                (Some(Op::Mul(x, y)), _) => (Code::MulAdd, [x, y, b, NONE]),
                (_, Some(Op::Mul(x, y))) => (Code::MulAdd, [x, y, a, NONE]),
                _ => (Code::Add, [a, b, NONE, NONE]),
            },
            Op::Sub(a, b) => match (self.single(a), self.single(b)) {
                (Some(Op::Mul(x, y)), _) => (Code::MulSub, [x, y, b, NONE]),
                (_, Some(Op::Mul(x, y))) => (Code::SubMul, [x, y, a, NONE]),
                _ => (Code::Sub, [a, b, NONE, NONE]),
            },
            Op::Mul(a, b) => match (self.single(a), self.single(b)) {
                (Some(Op::Add(x, y)), _) => (Code::AddMul, [x, y, b, NONE]),
                (Some(Op::Sub(x, y)), _) => (Code::DiffMul, [x, y, b, NONE]),
                (_, Some(Op::Add(x, y))) => (Code::AddMul, [x, y, a, NONE]),
                (_, Some(Op::Sub(x, y))) => (Code::DiffMul, [x, y, a, NONE]),
                _ => (Code::Mul, [a, b, NONE, NONE]),
            },
            op => (plain(op), {
                let mut args = [NONE; 4];
                args.iter_mut().zip(op.args()).for_each(|(arg, id)| *arg = id);
                args
            }),
        }
    }

    /// Emits a number after its operands, unless it exists.
    fn emit(&mut self, id: Id) {
        let mut stack = vec![id];
        while let Some(&id) = stack.last() {
            if self.done[id as usize] {
                stack.pop();
                continue;
            }
            let (code, args) = self.select(id);
            let missing = |arg: &&Id| **arg != NONE && !self.done[**arg as usize];
            let before = stack.len();
            stack.extend(args.iter().filter(missing).rev());
            if stack.len() == before {
                let results = match self.graph.op(id) {
                    Op::Sin(a) | Op::Cos(a) => {
                        [Op::Sin(a), Op::Cos(a)].map(|op| self.graph.find(op).unwrap_or(UNREAD))
                    }
                    _ => [id, NONE],
                };
                let step = Instruction { code, args, results, fixed: 0 };
                step.results().for_each(|result| self.done[result] = true);
                self.steps.push(step);
            }
        }
    }
}

/// Instruction of an operation that is not combined with another one.
fn plain(op: Op) -> NumberCode {
    match op {
        Op::Input | Op::Const(_) => unreachable!("inputs and constants have no instruction"),
        Op::Add(..) => NumberCode::Add,
        Op::Sub(..) => NumberCode::Sub,
        Op::Mul(..) => NumberCode::Mul,
        Op::Div(..) => NumberCode::Div,
        Op::Neg(_) => NumberCode::Neg,
        Op::Abs(_) => NumberCode::Abs,
        Op::Sqrt(_) => NumberCode::Sqrt,
        Op::Exp(_) => NumberCode::Exp,
        Op::Ln(_) => NumberCode::Ln,
        Op::Sin(_) | Op::Cos(_) => NumberCode::SinCos,
        Op::Tanh(_) => NumberCode::Tanh,
        Op::Asin(_) => NumberCode::Asin,
        Op::Acos(_) => NumberCode::Acos,
        Op::Atan2(..) => NumberCode::Atan2,
        Op::Hypot(..) => NumberCode::Hypot,
        Op::PerSquare(..) => NumberCode::PerSquare,
        Op::Unit(..) => NumberCode::Unit,
        Op::Powf(..) => NumberCode::Powf,
        Op::Min(..) => NumberCode::Min,
        Op::Max(..) => NumberCode::Max,
        Op::Select(..) => NumberCode::Select,
        Op::SelectLe(..) => NumberCode::SelectLe,
        Op::Detach(_) => NumberCode::Detach,
    }
}

/// Changes the order so that equal instructions follow each other, within a window of the given
/// order. Operands still precede results. `count` is the number of numbers.
fn grouped<Code: Copy + PartialEq>(
    steps: Vec<Instruction<Code>>,
    count: usize,
) -> Vec<Instruction<Code>> {
    let mut written_by = vec![usize::MAX; count];
    let mut kinds: Vec<Code> = Vec::new();
    let mut followers: Vec<Vec<usize>> = vec![Vec::new(); steps.len()];
    let mut waits = vec![0; steps.len()];
    for (at, step) in steps.iter().enumerate() {
        step.results().for_each(|result| written_by[result] = at);
        for before in step.args().map(|arg| written_by[arg]).filter(|&at| at != usize::MAX) {
            waits[at] += 1;
            followers[before].push(at);
        }
        if !kinds.contains(&step.code) {
            kinds.push(step.code);
        }
    }
    let kind = |at: usize| kinds.iter().position(|&kind| kind == steps[at].code).expect("listed");
    let mut ready = vec![BTreeSet::new(); kinds.len()];
    for at in (0..steps.len()).filter(|&at| waits[at] == 0) {
        ready[kind(at)].insert(at);
    }
    let (mut order, mut done) = (Vec::with_capacity(steps.len()), vec![false; steps.len()]);
    let (mut oldest, mut current) = (0, 0);
    while order.len() < steps.len() {
        while done[oldest] {
            oldest += 1;
        }
        let end = oldest + WINDOW;
        let Some(at) = ready[current].first().copied().filter(|&at| at < end) else {
            // The kind with most instructions; among equals, the first.
            current = (0..kinds.len())
                .rev()
                .max_by_key(|&kind| ready[kind].range(..end).count())
                .expect("the oldest instruction is ready");
            continue;
        };
        ready[current].remove(&at);
        done[at] = true;
        order.push(steps[at]);
        for &follower in &followers[at] {
            waits[follower] -= 1;
            if waits[follower] == 0 {
                ready[kind(follower)].insert(follower);
            }
        }
    }
    order
}

struct Allocated<Code> {
    list: Vec<(Code, Registers)>,
    /// Number of registers.
    registers: usize,
    /// Register of each number.
    of: Vec<u16>,
}

/// Registers that are free, and the number of all.
#[derive(Default)]
struct Pool {
    free: Vec<u16>,
    count: usize,
}

impl Pool {
    fn take(&mut self) -> Result<u16, TooLarge> {
        self.free.pop().map_or_else(
            || {
                self.count += 1;
                u16::try_from(self.count - 1).map_err(|_| TooLarge)
            },
            Ok,
        )
    }
}

/// Assigns registers. The `pinned` numbers have the first ones, and keep them. A register is free
/// again after the last instruction that reads it, unless it is that of an output.
fn allocate<Code: Copy>(
    steps: &[Instruction<Code>],
    count: usize,
    pinned: &[u32],
    outputs: &[u32],
) -> Result<Allocated<Code>, TooLarge> {
    let mut last = vec![0; count];
    for (at, step) in steps.iter().enumerate() {
        step.args().chain(step.results()).for_each(|number| last[number] = at);
    }
    pinned.iter().chain(outputs).for_each(|&number| last[number as usize] = usize::MAX);
    let (mut pool, mut of) = (Pool::default(), vec![0; count]);
    for &number in pinned {
        of[number as usize] = pool.take()?;
    }
    let mut list = Vec::with_capacity(steps.len());
    for (at, step) in steps.iter().enumerate() {
        let arg = |k: usize| if step.args[k] == NONE { 0 } else { of[step.args[k] as usize] };
        let b = if step.args[1] == NONE { step.fixed } else { arg(1) };
        let mut registers = Registers { a: arg(0), b, c: arg(2), d: 0, e: arg(3) };
        let mut ended: Vec<usize> = step.args().filter(|&arg| last[arg] == at).collect();
        ended.sort_unstable();
        ended.dedup();
        pool.free.extend(ended.into_iter().map(|arg| of[arg]));
        let mut ended = Vec::new();
        for (result, k) in step.results.into_iter().zip(0..) {
            if result == NONE {
                continue;
            }
            let register = pool.take()?;
            *(if k == 0 { &mut registers.d } else { &mut registers.e }) = register;
            if result == UNREAD || last[result as usize] == at {
                ended.push(register);
            }
            if result != UNREAD {
                of[result as usize] = register;
            }
        }
        pool.free.extend(ended);
        list.push((step.code, registers));
    }
    Ok(Allocated { list, registers: pool.count, of })
}

//! Interpreters of instructions on registers: [`NumberProgram`] for numbers of any scalar, and
//! [`BarProgram`] for cotangents, whose slopes are such numbers.
//!
//! Equal instructions that follow each other form a run, which is dispatched once. The constructors
//! check all registers, so that the execution needs no bounds checks.

use crate::numbers::scalar::{Cotangent, Scalar, Scaled};

/// Kind of an instruction on numbers, with the operands `a`, `b`, `c` and `e`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NumberCode {
    Add,
    Sub,
    Mul,
    Div,
    Neg,
    Abs,
    Sqrt,
    Exp,
    Ln,
    /// Sine and cosine of `a`. The cosine goes to `e`.
    SinCos,
    Tanh,
    Asin,
    Acos,
    Atan2,
    Hypot,
    /// `a / (a² + b²)`
    PerSquare,
    /// `a / sqrt(a² + b²)`
    Unit,
    /// `a` to the power of the constant number `b`.
    Powf,
    Min,
    Max,
    /// `a < b ? c : e`
    Select,
    /// `a <= b ? c : e`
    SelectLe,
    Detach,
    /// `a * b + c`, with two roundings.
    MulAdd,
    /// `a * b - c`
    MulSub,
    /// `c - a * b`
    SubMul,
    /// `(a + b) * c`
    AddMul,
    /// `(a - b) * c`
    DiffMul,
}

/// Kind of an instruction on cotangents: `a` and `c` are cotangents, `b` is a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BarCode {
    /// `a + c`
    Add,
    /// `a - c`
    Sub,
    /// `a * b`
    Mul,
    /// `c + a * b`
    MulAdd,
    /// `c - a * b`
    MulSub,
}

/// Registers of an instruction: operands, and `d` for the result.
#[derive(Clone, Copy, Debug, Default)]
pub struct Registers {
    pub a: u16,
    pub b: u16,
    pub c: u16,
    pub d: u16,
    pub e: u16,
}

/// Instructions in runs of equal kind.
#[derive(Clone, Debug)]
struct Runs<Code> {
    runs: Vec<(Code, usize)>,
    instructions: Vec<Registers>,
}

impl<Code: Copy + PartialEq> Runs<Code> {
    fn new(list: &[(Code, Registers)]) -> Self {
        let runs = list.chunk_by(|a, b| a.0 == b.0).map(|run| (run[0].0, run.len())).collect();
        Self { runs, instructions: list.iter().map(|(_, registers)| *registers).collect() }
    }
}

/// Instructions on numbers.
#[derive(Clone, Debug)]
pub struct NumberProgram {
    runs: Runs<NumberCode>,
    constants: Vec<f64>,
    registers: usize,
}

impl NumberProgram {
    /// A program on `registers` numbers, of which the first ones are the `constants`.
    ///
    /// # Panics
    /// If an instruction has a register out of range.
    pub fn new(list: &[(NumberCode, Registers)], constants: Vec<f64>, registers: usize) -> Self {
        assert!(constants.len() <= registers);
        for (code, Registers { a, b, c, d, e }) in list {
            let mut all = [a, b, c, d, e].into_iter();
            assert!(all.all(|register| usize::from(*register) < registers));
            assert!(*code != NumberCode::Powf || usize::from(*b) < constants.len());
        }
        Self { runs: Runs::new(list), constants, registers }
    }

    /// Number of constants.
    pub fn constants(&self) -> usize {
        self.constants.len()
    }

    /// Registers with the constants.
    pub fn registers<T: Scalar>(&self) -> Vec<T> {
        let constants = self.constants.iter().map(|&value| T::from(value));
        let others = std::iter::repeat_n(T::zero(), self.registers - self.constants.len());
        constants.chain(others).collect()
    }

    /// Executes all instructions.
    ///
    /// # Panics
    /// If there are fewer registers than those of the program.
    #[inline(always)]
    pub fn run<T: Scalar>(&self, registers: &mut [T]) {
        assert!(registers.len() >= self.registers);
        let all = registers.as_mut_ptr();
        // SAFETY: `new` compares all registers with their number, and the slice is not shorter.
        let get = |register: u16| unsafe { *all.add(usize::from(register)) };
        let put = |register: u16, value: T| unsafe { *all.add(usize::from(register)) = value };
        let mut rest = &self.runs.instructions[..];
        for &(code, count) in &self.runs.runs {
            let (run, others) = rest.split_at(count);
            rest = others;
            macro_rules! unary {
                ($f:expr) => {
                    run.iter().for_each(|i| put(i.d, $f(get(i.a))))
                };
            }
            macro_rules! binary {
                ($f:expr) => {
                    run.iter().for_each(|i| put(i.d, $f(get(i.a), get(i.b))))
                };
            }
            macro_rules! ternary {
                ($f:expr) => {
                    run.iter().for_each(|i| put(i.d, $f(get(i.a), get(i.b), get(i.c))))
                };
            }
            match code {
                NumberCode::Add => binary!(|a: T, b: T| a + b),
                NumberCode::Sub => binary!(|a: T, b: T| a - b),
                NumberCode::Mul => binary!(|a: T, b: T| a * b),
                NumberCode::Div => binary!(|a: T, b: T| a / b),
                NumberCode::MulAdd => ternary!(|a: T, b: T, c: T| a * b + c),
                NumberCode::MulSub => ternary!(|a: T, b: T, c: T| a * b - c),
                NumberCode::SubMul => ternary!(|a: T, b: T, c: T| c - a * b),
                NumberCode::AddMul => ternary!(|a: T, b: T, c: T| (a + b) * c),
                NumberCode::DiffMul => ternary!(|a: T, b: T, c: T| (a - b) * c),
                NumberCode::Neg => unary!(|a: T| -a),
                NumberCode::Abs => unary!(T::abs),
                NumberCode::Sqrt => unary!(T::sqrt),
                NumberCode::Exp => unary!(T::exp),
                NumberCode::Ln => unary!(T::ln),
                NumberCode::Tanh => unary!(T::tanh),
                NumberCode::Asin => unary!(T::asin),
                NumberCode::Acos => unary!(T::acos),
                NumberCode::Detach => unary!(T::detach),
                NumberCode::SinCos => run.iter().for_each(|i| {
                    let (sin, cos) = get(i.a).sin_cos();
                    put(i.d, sin);
                    put(i.e, cos);
                }),
                NumberCode::Atan2 => binary!(T::atan2),
                NumberCode::Hypot => binary!(T::hypot),
                NumberCode::PerSquare => binary!(|a, b| Scaled::new(a, b).per_square()[0]),
                NumberCode::Unit => binary!(|a, b| Scaled::new(a, b).direction()[0]),
                NumberCode::Min => binary!(|a, b| ordered(a, T::select_lt(a, b, a, b), a)),
                NumberCode::Max => binary!(|a, b| ordered(a, T::select_lt(b, a, a, b), a)),
                NumberCode::Powf => run.iter().for_each(|i| {
                    put(i.d, get(i.a).powf(self.constants[usize::from(i.b)]));
                }),
                NumberCode::Select => run.iter().for_each(|i| {
                    put(i.d, T::select_lt(get(i.a), get(i.b), get(i.c), get(i.e)));
                }),
                NumberCode::SelectLe => run.iter().for_each(|i| {
                    let (a, b, yes, no) = (get(i.a), get(i.b), get(i.c), get(i.e));
                    let if_ordered = ordered(a, ordered(b, yes, no), no);
                    put(i.d, T::select_lt(b, a, no, if_ordered));
                }),
            }
        }
    }
}

/// `yes`, or `no` if the number is NaN.
#[inline(always)]
fn ordered<T: Scalar>(number: T, yes: T, no: T) -> T {
    let infinity = T::from(f64::INFINITY);
    T::select_lt(number, infinity, yes, T::select_lt(-infinity, number, yes, no))
}

/// Instructions on cotangents.
#[derive(Clone, Debug)]
pub struct BarProgram {
    runs: Runs<BarCode>,
    numbers: usize,
    bars: usize,
}

impl BarProgram {
    /// A program on `bars` cotangents and `numbers` numbers.
    ///
    /// # Panics
    /// If an instruction has a register out of range.
    pub fn new(list: &[(BarCode, Registers)], numbers: usize, bars: usize) -> Self {
        for (code, Registers { a, b, c, d, .. }) in list {
            assert!([a, c, d].into_iter().all(|register| usize::from(*register) < bars));
            let has_slope = !matches!(code, BarCode::Add | BarCode::Sub);
            assert!(!has_slope || usize::from(*b) < numbers);
        }
        Self { runs: Runs::new(list), numbers, bars }
    }

    /// Number of registers of cotangents.
    pub fn bars(&self) -> usize {
        self.bars
    }

    /// Executes all instructions.
    ///
    /// # Panics
    /// If there are fewer registers than those of the program.
    #[inline(always)]
    pub fn run<T: Scalar, C: Cotangent<T>>(&self, numbers: &[T], bars: &mut [C]) {
        assert!(numbers.len() >= self.numbers && bars.len() >= self.bars);
        let (numbers, all) = (numbers.as_ptr(), bars.as_mut_ptr());
        // SAFETY: `new` compares all registers with their numbers, and the slices are not shorter.
        let slope = |register: u16| unsafe { *numbers.add(usize::from(register)) };
        let get = |register: u16| unsafe { *all.add(usize::from(register)) };
        let put = |register: u16, value: C| unsafe { *all.add(usize::from(register)) = value };
        let mut rest = &self.runs.instructions[..];
        for &(code, count) in &self.runs.runs {
            let (run, others) = rest.split_at(count);
            rest = others;
            match code {
                BarCode::Add => run.iter().for_each(|i| put(i.d, get(i.a) + get(i.c))),
                BarCode::Sub => run.iter().for_each(|i| put(i.d, get(i.a) - get(i.c))),
                BarCode::Mul => run.iter().for_each(|i| put(i.d, get(i.a) * slope(i.b))),
                BarCode::MulAdd => {
                    run.iter().for_each(|i| put(i.d, get(i.c) + get(i.a) * slope(i.b)));
                }
                BarCode::MulSub => {
                    run.iter().for_each(|i| put(i.d, get(i.c) - get(i.a) * slope(i.b)));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[should_panic(expected = "registers")]
    fn a_register_out_of_range_is_refused() {
        let beyond = Registers { c: 2, ..Registers::default() };
        NumberProgram::new(&[(NumberCode::Neg, beyond)], vec![1.0], 2);
    }

    #[test]
    #[should_panic(expected = "constants")]
    fn an_exponent_that_is_no_constant_is_refused() {
        let variable = Registers { b: 1, ..Registers::default() };
        NumberProgram::new(&[(NumberCode::Powf, variable)], vec![1.0], 2);
    }

    #[test]
    #[should_panic(expected = "numbers")]
    fn a_slope_out_of_range_is_refused() {
        BarProgram::new(&[(BarCode::Mul, Registers { b: 1, ..Registers::default() })], 1, 1);
    }

    #[test]
    fn comparisons_with_nan_take_the_second_branch() {
        let [inf, nan] = [f64::INFINITY, f64::NAN];
        let numbers = [-inf, -1.0, -0.0, 0.0, 1.0, inf, nan];
        for (a, b) in numbers.into_iter().flat_map(|a| numbers.map(|b| (a, b))) {
            let at = Registers { a: 0, b: 1, c: 2, d: 4, e: 3 };
            let value = |code: NumberCode| {
                let mut registers = [a, b, 10.0, 20.0, 0.0];
                NumberProgram::new(&[(code, at)], vec![], 5).run(&mut registers);
                registers[4]
            };
            let selected = |yes: bool| if yes { 10.0 } else { 20.0 };
            assert_eq!(value(NumberCode::Select), selected(a < b), "{a} < {b}");
            assert_eq!(value(NumberCode::SelectLe), selected(a <= b), "{a} <= {b}");
            let is_nan = a.is_nan() || b.is_nan();
            let equal = |found: f64, expected: f64| {
                if is_nan { found.is_nan() } else { found == expected }
            };
            assert!(equal(value(NumberCode::Min), a.min(b)), "min of {a} and {b}");
            assert!(equal(value(NumberCode::Max), a.max(b)), "max of {a} and {b}");
        }
    }
}

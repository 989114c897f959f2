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
        // Macros and loops instead of closures, which might not be inlined into code for wide
        // registers.
        macro_rules! get {
            ($register:expr) => {
                // SAFETY: `new` compares all registers with their number, and the slice is not
                // shorter.
                unsafe { *all.add(usize::from($register)) }
            };
        }
        macro_rules! put {
            ($register:expr, $value:expr) => {{
                let value = $value;
                // SAFETY: as above.
                unsafe { *all.add(usize::from($register)) = value }
            }};
        }
        let mut rest = &self.runs.instructions[..];
        for &(code, count) in &self.runs.runs {
            let (run, others) = rest.split_at(count);
            rest = others;
            macro_rules! each {
                (|$a:ident| $value:expr) => {
                    for i in run {
                        let $a = get!(i.a);
                        put!(i.d, $value);
                    }
                };
                (|$a:ident, $b:ident| $value:expr) => {
                    for i in run {
                        let ($a, $b) = (get!(i.a), get!(i.b));
                        put!(i.d, $value);
                    }
                };
                (|$a:ident, $b:ident, $c:ident| $value:expr) => {
                    for i in run {
                        let ($a, $b, $c) = (get!(i.a), get!(i.b), get!(i.c));
                        put!(i.d, $value);
                    }
                };
                (|$a:ident, $b:ident, $c:ident, $e:ident| $value:expr) => {
                    for i in run {
                        let ($a, $b, $c, $e) = (get!(i.a), get!(i.b), get!(i.c), get!(i.e));
                        put!(i.d, $value);
                    }
                };
            }
            match code {
                NumberCode::Add => each!(|a, b| a + b),
                NumberCode::Sub => each!(|a, b| a - b),
                NumberCode::Mul => each!(|a, b| a * b),
                NumberCode::Div => each!(|a, b| a / b),
                NumberCode::MulAdd => each!(|a, b, c| a * b + c),
                NumberCode::MulSub => each!(|a, b, c| a * b - c),
                NumberCode::SubMul => each!(|a, b, c| c - a * b),
                NumberCode::AddMul => each!(|a, b, c| (a + b) * c),
                NumberCode::DiffMul => each!(|a, b, c| (a - b) * c),
                NumberCode::Neg => each!(|a| -a),
                NumberCode::Abs => each!(|a| a.abs()),
                NumberCode::Sqrt => each!(|a| a.sqrt()),
                NumberCode::Exp => each!(|a| a.exp()),
                NumberCode::Ln => each!(|a| a.ln()),
                NumberCode::Tanh => each!(|a| a.tanh()),
                NumberCode::Asin => each!(|a| a.asin()),
                NumberCode::Acos => each!(|a| a.acos()),
                NumberCode::Detach => each!(|a| a.detach()),
                NumberCode::SinCos => {
                    for i in run {
                        let (sin, cos) = get!(i.a).sin_cos();
                        put!(i.d, sin);
                        put!(i.e, cos);
                    }
                }
                NumberCode::Atan2 => each!(|a, b| a.atan2(b)),
                NumberCode::Hypot => each!(|a, b| a.hypot(b)),
                NumberCode::PerSquare => each!(|a, b| Scaled::new(a, b).per_square()[0]),
                NumberCode::Unit => each!(|a, b| Scaled::new(a, b).direction()[0]),
                NumberCode::Min => each!(|a, b| ordered(a, T::select_lt(a, b, a, b), a)),
                NumberCode::Max => each!(|a, b| ordered(a, T::select_lt(b, a, a, b), a)),
                NumberCode::Powf => {
                    for i in run {
                        put!(i.d, get!(i.a).powf(self.constants[usize::from(i.b)]));
                    }
                }
                NumberCode::Select => each!(|a, b, c, e| T::select_lt(a, b, c, e)),
                NumberCode::SelectLe => {
                    each!(|a, b, yes, no| {
                        let if_ordered = ordered(a, ordered(b, yes, no), no);
                        T::select_lt(b, a, no, if_ordered)
                    });
                }
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
        macro_rules! slope {
            ($register:expr) => {
                // SAFETY: `new` compares all registers with their numbers, and the slices are not
                // shorter.
                unsafe { *numbers.add(usize::from($register)) }
            };
        }
        macro_rules! get {
            ($register:expr) => {
                // SAFETY: as above.
                unsafe { *all.add(usize::from($register)) }
            };
        }
        let mut rest = &self.runs.instructions[..];
        for &(code, count) in &self.runs.runs {
            let (run, others) = rest.split_at(count);
            rest = others;
            macro_rules! each {
                (|$i:ident| $value:expr) => {
                    for $i in run {
                        let value: C = $value;
                        // SAFETY: as above.
                        unsafe { *all.add(usize::from($i.d)) = value }
                    }
                };
            }
            match code {
                BarCode::Add => each!(|i| get!(i.a) + get!(i.c)),
                BarCode::Sub => each!(|i| get!(i.a) - get!(i.c)),
                BarCode::Mul => each!(|i| get!(i.a) * slope!(i.b)),
                BarCode::MulAdd => each!(|i| get!(i.c) + get!(i.a) * slope!(i.b)),
                BarCode::MulSub => each!(|i| get!(i.c) - get!(i.a) * slope!(i.b)),
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

//! [`Function`]: outputs of a graph for any scalar, and their transposed Jacobian product.

use super::adjoint::adjoint;
use super::lower::{Bars, Numbers, TooLarge, bars, numbers};
use super::op::{Graph, Id};
use crate::dynamics::default_vjp::{self, Add, default_vjp};
use crate::numbers::kernels::{Vectorized, dispatch_lanes};
use crate::numbers::pool::lend;
use crate::numbers::scalar::{Cotangent, Over, Real, Scalar};
use std::ops::Range;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

/// Lists of inputs of every function: state, control, parameters, next state, and numbers that
/// depend on time alone.
pub(super) const LISTS: usize = 5;
/// Lists with cotangents: all but the last.
const WITH_BARS: usize = LISTS - 1;

/// The set of all lists with cotangents.
const ALL: usize = (1 << WITH_BARS) - 1;

/// Inputs of a function, in the order of the graph.
pub(super) type Lists<'a, T> = [&'a [T]; LISTS];

/// Outputs of a graph, as programs. A function reads a list only if an output depends on it, and
/// accepts an empty list otherwise.
#[derive(Debug)]
pub(super) struct Function {
    graph: Graph,
    outputs: Vec<Id>,
    /// Inputs of the graph by list.
    ranges: [Range<usize>; LISTS],
    /// Lists that the outputs depend on.
    reads: [bool; LISTS],
    forward: Compiled<Numbers>,
    /// Programs of the cotangents, by the set of requested lists.
    backward: [OnceLock<Compiled<Bars>>; 1 << WITH_BARS],
}

/// A program with a number of its own, by which threads keep its registers.
#[derive(Debug)]
struct Compiled<P> {
    id: u64,
    program: P,
}

impl<P> Compiled<P> {
    fn new(program: P) -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        Self { id: NEXT.fetch_add(1, Ordering::Relaxed), program }
    }
}

impl Function {
    /// The outputs of a graph whose inputs are lists of these lengths.
    pub(super) fn new(
        graph: Graph,
        outputs: Vec<Id>,
        lengths: [usize; LISTS],
    ) -> Result<Self, TooLarge> {
        assert_eq!(lengths.iter().sum::<usize>(), graph.inputs(), "lists contain all inputs");
        let first = |list: usize| lengths[..list].iter().sum::<usize>();
        let ranges: [_; LISTS] = std::array::from_fn(|k| first(k)..first(k) + lengths[k]);
        let needed = graph.needed(outputs.iter().copied());
        let reads = ranges.clone().map(|range| needed[range].contains(&true));
        let forward = Compiled::new(numbers(&graph, &outputs)?);
        let function =
            Self { graph, outputs, ranges, reads, forward, backward: Default::default() };
        // A derivative has more registers than the function.
        function.lowered(ALL)?;
        Ok(function)
    }

    /// Numbers of the graph that are the outputs.
    pub(super) fn outputs(&self) -> &[Id] {
        &self.outputs
    }

    /// Number of outputs.
    pub(super) fn len(&self) -> usize {
        self.outputs.len()
    }

    /// Returns whether an output depends on a list.
    pub(super) fn reads(&self, list: usize) -> bool {
        self.reads[list]
    }

    fn lowered(&self, requested: usize) -> Result<Bars, TooLarge> {
        let wrt = (0..WITH_BARS).filter(|list| requested >> list & 1 == 1);
        let wrt: Vec<Id> =
            wrt.flat_map(|list| self.ranges[list].clone()).map(|id| id as Id).collect();
        let mut graph = self.graph.clone();
        let adjoint = adjoint(&mut graph, &self.outputs, &wrt);
        bars(&graph, &adjoint)
    }

    fn backward(&self, requested: usize) -> &Compiled<Bars> {
        self.backward[requested].get_or_init(|| {
            // Instructions that join others may keep more numbers at once than those of all lists.
            Compiled::new(self.lowered(requested).unwrap_or_else(|_| {
                let mut bars =
                    self.lowered(ALL).expect("`new` lowered the derivative of all lists");
                let lists = self.ranges[..WITH_BARS].iter().enumerate();
                let mut is_requested = lists.flat_map(|(list, range)| {
                    range.clone().map(move |_| requested >> list & 1 == 1)
                });
                bars.inputs.retain(|_| is_requested.next() == Some(true));
                bars
            }))
        })
    }

    /// Writes the outputs.
    #[inline(never)]
    pub(super) fn eval<T: Scalar>(&self, lists: Lists<'_, T>, outputs: &mut [T]) {
        let Compiled { id, program } = &self.forward;
        with_frame::<T, ()>(
            *id,
            || (program.program.registers(), Vec::new()),
            |(frame, _)| {
                let work = Eval { function: self, lists, outputs, frame };
                if T::VECTORIZED { dispatch_lanes(work) } else { work.run::<false>() }
            },
        );
    }

    #[inline(always)]
    fn load<T: Scalar>(&self, lists: Lists<'_, T>, constants: usize, frame: &mut [T]) {
        for ((list, range), reads) in lists.iter().zip(&self.ranges).zip(self.reads) {
            if reads {
                let range = constants + range.start..constants + range.end;
                frame[range].copy_from_slice(list);
            }
        }
    }

    /// Adds the transposed Jacobian product to the requested cotangents.
    #[inline(never)]
    pub(super) fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        lists: Lists<'_, R>,
        output_bars: &[C],
        mut cotangents: [Option<&mut [C]>; WITH_BARS],
    ) {
        let requested =
            cotangents.iter().enumerate().map(|(k, list)| usize::from(list.is_some()) << k).sum();
        let Compiled { id, program } = self.backward(requested);
        let new = || {
            let bars = program.program.bars().max(output_bars.len());
            (program.numbers.registers(), vec![C::null(); bars])
        };
        with_frame(*id, new, |(numbers, bars)| {
            let work = Pull { function: self, program, lists, output_bars, numbers, bars };
            if R::VECTORIZED {
                dispatch_lanes(work)
            } else {
                work.run::<false>()
            }
            let product = |input: &Option<(u16, bool)>| {
                input.map(|(register, minus)| (bars[usize::from(register)], minus))
            };
            let is_finite = |input| product(input).is_none_or(|(bar, _)| bar.all_finite());
            if program.inputs.iter().all(is_finite) {
                let lists = cotangents.iter_mut().flatten().flat_map(|list| list.iter_mut());
                for (to, input) in lists.zip(&program.inputs) {
                    match product(input) {
                        Some((bar, false)) => *to += bar,
                        Some((bar, true)) => *to -= bar,
                        None => {}
                    }
                }
            } else {
                let of: Vec<Option<C>> = program
                    .inputs
                    .iter()
                    .map(|input| product(input).map(|(bar, minus)| if minus { -bar } else { bar }))
                    .collect();
                self.singular_vjp(lists, output_bars, cotangents, &of);
            }
        });
    }

    /// Adds the product `of`, and where it is not finite, that of the rules of the library for
    /// products of 0 and an infinite slope.
    #[cold]
    fn singular_vjp<R: Real, C: Cotangent<R>>(
        &self,
        lists: Lists<'_, R>,
        output_bars: &[C],
        mut cotangents: [Option<&mut [C]>; WITH_BARS],
        of: &[Option<C>],
    ) {
        let lengths: [_; WITH_BARS] =
            std::array::from_fn(|k| cotangents[k].as_ref().map_or(0, |list| list.len()));
        let mut exact = lengths.map(|length| vec![C::null(); length]);
        let [x, u, p, next] = &mut exact;
        let list = |k: usize, list| cotangents[k].is_some().then_some(list);
        let requested = [
            list(0, &mut x[..]),
            list(1, &mut u[..]),
            list(2, &mut p[..]),
            list(3, &mut next[..]),
            None,
        ];
        // A list that no output depends on may be empty.
        default_vjp(&Singular(self), lists, output_bars, requested, Add::Sum);
        let lists = cotangents.iter_mut().flatten().flat_map(|list| list.iter_mut());
        for ((to, exact), of) in lists.zip(exact.iter().flatten()).zip(of) {
            if let Some(product) = of {
                *to += product.finite_or(*exact);
            }
        }
    }
}

/// [`Function::eval`] as a function of the default derivatives.
struct Singular<'a>(&'a Function);

impl<R> default_vjp::Function<R, LISTS> for Singular<'_> {
    fn eval<T: Over<R>>(&self, lists: [&[T]; LISTS], outputs: &mut [T]) {
        self.0.eval(lists, outputs);
    }
}

struct Eval<'a, T> {
    function: &'a Function,
    lists: Lists<'a, T>,
    outputs: &'a mut [T],
    frame: &'a mut [T],
}

impl<T: Scalar> Vectorized for Eval<'_, T> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { function, lists, outputs, frame } = self;
        let Numbers { program, outputs: registers } = &function.forward.program;
        function.load(lists, program.constants(), frame);
        program.run(frame);
        for (output, &register) in outputs.iter_mut().zip(registers) {
            *output = frame[usize::from(register)];
        }
    }
}

struct Pull<'a, R, C> {
    function: &'a Function,
    program: &'a Bars,
    lists: Lists<'a, R>,
    output_bars: &'a [C],
    numbers: &'a mut [R],
    bars: &'a mut [C],
}

impl<R: Real, C: Cotangent<R>> Vectorized for Pull<'_, R, C> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { function, program, lists, output_bars, numbers, bars } = self;
        function.load(lists, program.numbers.constants(), numbers);
        program.numbers.run(numbers);
        bars[..output_bars.len()].copy_from_slice(output_bars);
        program.program.run(numbers, bars);
    }
}

/// Registers of programs, by their numbers, with constants in place. The newest is first.
struct Frames<T, C>(Vec<(u64, Frame<T, C>)>);

/// Registers of numbers and of cotangents.
type Frame<T, C> = (Vec<T>, Vec<C>);

impl<T, C> Default for Frames<T, C> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

/// Programs whose registers a thread keeps, per type of number.
const KEPT: usize = 64;

/// Calls `work` with the registers of a program, which the current thread keeps.
#[inline(always)]
fn with_frame<T: 'static, C: 'static>(
    id: u64,
    new: impl FnOnce() -> Frame<T, C>,
    work: impl FnOnce(&mut Frame<T, C>),
) {
    lend(|Frames(frames): &mut Frames<T, C>| {
        let at = frames.iter().position(|(key, _)| *key == id).unwrap_or_else(|| {
            frames.truncate(KEPT - 1);
            frames.insert(0, (id, new()));
            0
        });
        work(&mut frames[at].1);
    });
}

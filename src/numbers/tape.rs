//! [`Tape`]: the operations of one evaluation in the order of their execution, for reverse mode.
//!
//! [`Reverse`](crate::numbers::scalar::Reverse) appends to the tape of the current thread. An entry
//! refers to numbers of the evaluation by index: variables first, then the results of the entries.

use crate::numbers::scalar::{Cotangent, Lanes, Real};
use std::cell::{Cell, RefCell};
use std::thread::LocalKey;

/// Slopes of an entry: derivatives of the result with respect to the numbers `a` and `b`.
#[derive(Clone, Copy, Debug)]
enum Rule {
    /// `a + b`: slopes 1 and 1, not stored.
    Sum,
    /// `a - b`: slopes 1 and -1, not stored.
    Difference,
    /// One stored slope: with respect to `a`.
    One,
    /// Two stored slopes: with respect to `a` and to `b`.
    Two,
}

/// Meaning of a stored slope of 0. It matters only where a path has an infinite slope too.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Zero {
    /// A derivative of 0, as any other slope.
    Slope,
    /// No path: the branch is not selected.
    Unselected,
    /// No path if the first slope, the reciprocal of the divisor, is 0. If the numerator is a
    /// constant, the only slope decides.
    Quotient,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    rule: Rule,
    zero: Zero,
    /// Indices of `a` and `b`. Equal if the rule has only `a`.
    of: [u32; 2],
}

/// Operations of one evaluation. Only operations whose result depends on a variable have an entry.
#[derive(Debug)]
pub struct Tape<R> {
    inputs: usize,
    entries: Vec<Entry>,
    /// Slopes of all entries, in order. A separate list, since sums and differences have none.
    slopes: Vec<R>,
}

impl<R> Default for Tape<R> {
    fn default() -> Self {
        Self { inputs: 0, entries: Vec::new(), slopes: Vec::new() }
    }
}

impl<R> Tape<R> {
    /// Appends a variable and returns its index. The tape must have no entries yet.
    #[inline(always)]
    pub(crate) fn variable(&mut self) -> usize {
        self.inputs += 1;
        self.inputs - 1
    }

    /// Removes all variables and entries.
    pub(crate) fn reset(&mut self) {
        self.inputs = 0;
        self.entries.clear();
        self.slopes.clear();
    }

    /// Number of variables.
    pub(crate) fn inputs(&self) -> usize {
        self.inputs
    }

    /// Number of variables and results, the length of the cotangents of [`sweep`](Tape::sweep).
    pub(crate) fn numbers(&self) -> usize {
        self.inputs + self.entries.len()
    }

    /// Appends an entry. Returns the index of its result.
    ///
    /// Indices have 32 bits. An overflow would need 2^32 entries, more than 50 GB.
    #[inline(always)]
    fn push(&mut self, rule: Rule, zero: Zero, of: [u32; 2]) -> u32 {
        let index = self.numbers() as u32;
        self.entries.push(Entry { rule, zero, of });
        index
    }

    /// Appends `a + b`.
    #[inline(always)]
    pub(crate) fn sum(&mut self, of: [u32; 2]) -> u32 {
        self.push(Rule::Sum, Zero::Slope, of)
    }

    /// Appends `a - b`.
    #[inline(always)]
    pub(crate) fn difference(&mut self, of: [u32; 2]) -> u32 {
        self.push(Rule::Difference, Zero::Slope, of)
    }

    /// Appends a function of one number with the given derivative.
    #[inline(always)]
    pub(crate) fn one(&mut self, zero: Zero, of: u32, slope: R) -> u32 {
        self.slopes.push(slope);
        self.push(Rule::One, zero, [of; 2])
    }

    /// Appends a function of two numbers with the given derivatives.
    #[inline(always)]
    pub(crate) fn two(&mut self, zero: Zero, of: [u32; 2], [a, b]: [R; 2]) -> u32 {
        self.slopes.push(a);
        self.slopes.push(b);
        self.push(Rule::Two, zero, of)
    }
}

impl<R: Real> Tape<R> {
    /// Propagates the cotangents of all results to the variables, in reverse order.
    #[inline(always)]
    pub(crate) fn sweep<C: Cotangent<R>>(&self, cotangents: &mut [C]) {
        let mut slopes = self.slopes.iter().rev();
        let mut slope = || *slopes.next().expect("the tape stores the slopes of all entries");
        for (i, entry) in self.entries.iter().enumerate().rev() {
            let bar = cotangents[self.inputs + i];
            let [a, b] = entry.of;
            let (a, b) = (a as usize, b as usize);
            match entry.rule {
                Rule::Sum => {
                    cotangents[a] += bar;
                    cotangents[b] += bar;
                }
                Rule::Difference => {
                    cotangents[a] += bar;
                    cotangents[b] -= bar;
                }
                Rule::One => cotangents[a] += bar * slope(),
                Rule::Two => {
                    cotangents[b] += bar * slope();
                    cotangents[a] += bar * slope();
                }
            }
        }
    }

    /// [`sweep`](Self::sweep) for non-finite slopes, with the rule of [`Scalar`](crate::Scalar) for
    /// 0 times infinity, which forward mode obeys without a guard. Walking inwards, an infinite
    /// cotangent vanishes at a slope of 0. A cotangent of 0 becomes NaN at an infinite slope, and
    /// vanishes only if a later slope is 0. A number that no path reaches keeps its
    /// [`null`](Cotangent::null), -0.0, and passes it on.
    #[inline(always)]
    pub(crate) fn sweep_guarded<C: Cotangent<R>>(&self, cotangents: &mut [C]) {
        let one = R::one();
        let mut slopes = self.slopes.iter().rev();
        let mut slope = || *slopes.next().expect("the tape stores the slopes of all entries");
        for (i, entry) in self.entries.iter().enumerate().rev() {
            let bar = cotangents[self.inputs + i];
            let [a, b] = entry.of.map(|index| index as usize);
            let (by_b, by_a) = match entry.rule {
                Rule::Sum => (Some(one), one),
                Rule::Difference => (Some(-one), one),
                Rule::One => (None, slope()),
                Rule::Two => (Some(slope()), slope()),
            };
            let open = |slope: R| match entry.zero {
                Zero::Slope => one,
                Zero::Unselected => slope,
                Zero::Quotient => by_a,
            };
            if let Some(by_b) = by_b {
                cotangents[b] += bar.along(by_b, open(by_b));
            }
            cotangents[a] += bar.along(by_a, open(by_a));
        }
    }
}

/// Active tapes of one thread for lanes of `F`, by number of lanes.
#[derive(Debug)]
pub struct Tapes<F> {
    pub(crate) one: RefCell<Tape<Lanes<F, 1>>>,
    pub(crate) two: RefCell<Tape<Lanes<F, 2>>>,
    pub(crate) four: RefCell<Tape<Lanes<F, 4>>>,
    pub(crate) eight: RefCell<Tape<Lanes<F, 8>>>,
}

// Not derived, since `F` needs no default.
impl<F> Default for Tapes<F> {
    fn default() -> Self {
        Self {
            one: RefCell::default(),
            two: RefCell::default(),
            four: RefCell::default(),
            eight: RefCell::default(),
        }
    }
}

/// Thread-local slot of the active tape, with `T` = `RefCell<Tape<R>>` or [`Tapes`].
///
/// The small content is never freed: a thread-local reference without destructor is faster to read
/// in every operation. The tape in the slot is empty except while a function is recorded.
pub(crate) type Place<T> = Cell<Option<&'static T>>;

/// Returns the content of a slot. The first call of a thread creates it.
#[inline(always)]
pub(crate) fn content<T: Default>(place: &'static LocalKey<Place<T>>) -> &'static T {
    #[cold]
    #[inline(never)]
    fn create<T: Default>(place: &'static LocalKey<Place<T>>) -> &'static T {
        let content = Box::leak(Box::<T>::default());
        place.set(Some(content));
        content
    }
    match place.get() {
        Some(content) => content,
        None => create(place),
    }
}

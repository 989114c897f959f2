//! [`Number`]: a physical number that is fixed, drawn for each sample or step, or trained.

mod noise;
mod settings;
mod vjp;

pub use noise::{Noise, NoiseNumbers};
pub(crate) use noise::{draw_key, key_of_epoch};
pub(crate) use vjp::{ParamDual, param_vjp};

use crate::numbers::rng::Rng;
use crate::numbers::scalar::Scalar;
use rand::RngExt as _;
use rand_distr::{Distribution as _, StandardNormal};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// A physical number of a system or effect: fixed, drawn for each sample or step, or trained.
///
/// A fixed number is a constant of the equations. Any other number varies: it is an entry of the
/// parameters `p` of a sample. The entry of [`Noise`] changes during a rollout. A scene contains a fixed number as such, and any other as a table:
/// `cart_mass = { uniform = [0.8, 1.2] }`.
///
/// ```
/// use physgrad::{Inputs, Number, Numbers, Scalar, System, check};
///
/// /// A mass that a force pushes: x = [position in m, velocity in m/s].
/// struct Puck { mass: Number }
///
/// impl System for Puck {
///     fn state_dim(&self) -> usize { 2 }
///     fn control_dim(&self) -> usize { 1 }
///     fn numbers(&self) -> Numbers<'_> { Numbers::new([("mass", &self.mass)]) }
///     fn step<T: Scalar>(&self, Inputs { x, u, p, .. }: Inputs<'_, T>, next: &mut [T]) {
///         let [mass] = self.numbers().last_of(p);
///         next[1] = x[1] + u[0] / mass * 0.05;
///         next[0] = x[0] + next[1] * 0.05;
///     }
/// }
///
/// check::system(&Puck { mass: Number::Uniform { low: 0.5, high: 2.0 } }).unwrap();
/// assert_eq!(Puck { mass: 1.0.into() }.param_dim(), 0);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Number {
    /// A constant.
    Fixed(f64),
    /// Drawn uniformly between two bounds.
    Uniform {
        /// Lower bound.
        low: f64,
        /// Upper bound.
        high: f64,
    },
    /// Drawn from a normal distribution, truncated at three standard deviations.
    Normal {
        /// Mean.
        mean: f64,
        /// Standard deviation before truncation.
        deviation: f64,
    },
    /// Drawn between two positive bounds. The logarithm is uniform.
    LogUniform {
        /// Lower bound.
        low: f64,
        /// Upper bound.
        high: f64,
    },
    /// Drawn from a list, each entry with equal probability.
    Choice(Choice),
    /// Drawn anew during a rollout.
    Noise(Noise),
    /// Trained from an initial value, within bounds. An infinite bound is no restriction. A finite
    /// upper bound requires a finite lower bound.
    Trained {
        /// Initial value.
        start: f64,
        /// Lower bound.
        min: f64,
        /// Upper bound.
        max: f64,
    },
}

/// List of one or more values. Equal lists share their memory, which remains allocated until the
/// program ends, so that numbers and systems are `Copy`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice(&'static [f64]);

impl Choice {
    /// Creates a list; `None` if it is empty.
    pub fn new(list: &[f64]) -> Option<Self> {
        static LISTS: Mutex<BTreeMap<Vec<u64>, Choice>> = Mutex::new(BTreeMap::new());
        let key = list.iter().map(|value| value.to_bits()).collect();
        let mut lists = LISTS.lock().unwrap_or_else(PoisonError::into_inner);
        let shared = || *lists.entry(key).or_insert_with(|| Self(Box::leak(list.into())));
        (!list.is_empty()).then(shared)
    }

    /// The values.
    pub fn values(&self) -> &'static [f64] {
        self.0
    }
}

impl From<f64> for Number {
    fn from(value: f64) -> Self {
        Self::Fixed(value)
    }
}

impl Number {
    /// Returns whether this number is a constant of the equations, rather than an entry of `p`.
    #[inline(always)]
    pub fn is_fixed(&self) -> bool {
        matches!(self, Self::Fixed(_))
    }

    /// Returns a typical value: the constant, the median of a distribution, the mean of noise, the initial value, or
    /// the middle entry of a choice. Among two middle entries, returns the second.
    #[inline(always)]
    pub fn nominal(&self) -> f64 {
        match *self {
            Self::Fixed(value) => value,
            Self::Uniform { low, high } => 0.5 * (low + high),
            Self::Normal { mean, .. } | Self::Noise(Noise { mean, .. }) => mean,
            Self::LogUniform { low, high } => (low * high).sqrt(),
            Self::Choice(Choice(values)) => values[values.len() / 2],
            Self::Trained { start, .. } => start,
        }
    }

    /// Returns values that include the smallest and the largest possible value, for validation.
    /// Omits infinite bounds of a trained number. Noise leaves six standard deviations with
    /// probability 2e-9.
    pub fn extremes(&self) -> Vec<f64> {
        match *self {
            Self::Fixed(value) => vec![value],
            Self::Uniform { low, high } | Self::LogUniform { low, high } => vec![low, high],
            Self::Normal { mean, deviation } => {
                vec![mean - TRUNCATION * deviation, mean + TRUNCATION * deviation]
            }
            Self::Choice(Choice(values)) => values.to_vec(),
            Self::Noise(Noise { mean, deviation, .. }) => {
                vec![mean - EXTREME * deviation, mean + EXTREME * deviation]
            }
            Self::Trained { start, min, max } => {
                let bounds = [min, max].into_iter().filter(|value| !value.is_infinite());
                [start].into_iter().chain(bounds).collect()
            }
        }
    }

    /// Draws a value. A fixed number yields its constant, a trained number its initial value, and
    /// noise its mean.
    ///
    /// # Panics
    /// If bounds are not in ascending order, or if those of [`LogUniform`](Self::LogUniform) are not
    /// positive.
    pub fn draw(&self, rng: &mut Rng) -> f64 {
        match *self {
            Self::Uniform { low, high } => {
                assert!(low <= high, "{self:?} has no values: `low` is above `high`");
                low + (high - low) * rng.random::<f64>()
            }
            Self::Normal { mean, deviation } => loop {
                let normal: f64 = StandardNormal.sample(rng);
                if normal.abs() <= TRUNCATION {
                    break mean + deviation * normal;
                }
            },
            Self::LogUniform { low, high } => {
                let is_valid = 0.0 < low && low <= high;
                assert!(is_valid, "{self:?} has no values: `low` is not positive, or above `high`");
                low * (high / low).powf(rng.random())
            }
            Self::Choice(Choice(values)) => values[rng.random_range(0..values.len())],
            Self::Fixed(value)
            | Self::Trained { start: value, .. }
            | Self::Noise(Noise { mean: value, .. }) => value,
        }
    }
}

/// Truncation of normal distributions, in standard deviations.
const TRUNCATION: f64 = 3.0;

/// Extremes of noise, in standard deviations.
const EXTREME: f64 = 6.0;

/// Named numbers of a system or effect, in order.
///
/// Numbers that are not fixed are entries of `p`, in the same order. For a system they are the last
/// entries of `p`, for an effect the last of its own entries.
///
/// [`new`](Self::new) takes up to eight fields of a type. A type that stores a list of numbers, of
/// any length, returns it with [`all`](Self::all).
#[derive(Clone, Copy, Debug)]
pub struct Numbers<'a> {
    fields: [(&'a str, &'a Number); FIELDS],
    count: usize,
    list: &'a [(Cow<'static, str>, Number)],
}

/// Largest number of fields in [`Numbers::new`]. They are passed by value in every step.
const FIELDS: usize = 8;

impl Default for Numbers<'_> {
    #[inline(always)]
    fn default() -> Self {
        Self::all(&[])
    }
}

impl<'a> Numbers<'a> {
    /// Lists names and numbers, up to eight.
    #[inline(always)]
    pub fn new<const N: usize>(numbers: [(&'a str, &'a Number); N]) -> Self {
        const {
            assert!(N <= FIELDS, "`Numbers::new` takes up to 8 numbers, `Numbers::all` any number");
        }
        let mut all = Self { count: N, ..Self::default() };
        all.fields[..N].copy_from_slice(&numbers);
        all
    }

    /// Lists the names and numbers of a list, of any length.
    #[inline(always)]
    pub fn all(list: &'a [(Cow<'static, str>, Number)]) -> Self {
        Self { fields: [("", &Number::Fixed(0.0)); FIELDS], count: 0, list }
    }

    /// Count of all numbers.
    #[inline(always)]
    fn len(&self) -> usize {
        self.count + self.list.len()
    }

    #[inline(always)]
    fn get(&self, i: usize) -> (&'a str, &'a Number) {
        if i < self.count {
            self.fields[i]
        } else {
            let (name, number) = &self.list[i - self.count];
            (name, number)
        }
    }

    /// Names and numbers, in order.
    pub fn listed(&self) -> impl Iterator<Item = (&'a str, &'a Number)> + use<'a> {
        let all = *self;
        (0..all.len()).map(move |i| all.get(i))
    }

    /// Count of the numbers that are not fixed.
    #[inline(always)]
    pub fn varied(&self) -> usize {
        let mut varied = 0;
        for i in 0..self.len() {
            varied += usize::from(!self.get(i).1.is_fixed());
        }
        varied
    }

    /// Values of all numbers: constants, and the first entries of `p`.
    ///
    /// # Panics
    /// If `N` is not the count of numbers, or if `p` has too few entries.
    #[inline(always)]
    pub fn of<T: Scalar, const N: usize>(&self, p: &[T]) -> [T; N] {
        let mut values = [T::zero(); N];
        self.write(p, &mut values);
        values
    }

    /// Writes the values of all numbers: constants, and the first entries of `p`.
    ///
    /// # Panics
    /// If the length of `values` is not the count of numbers, or if `p` has too few entries.
    #[inline(always)]
    pub fn write<T: Scalar>(&self, p: &[T], values: &mut [T]) {
        assert_eq!(
            self.len(),
            values.len(),
            "numbers in the list, and values requested from it; list each number once"
        );
        let mut entry = 0;
        for (i, value) in values.iter_mut().enumerate() {
            *value = match self.get(i).1 {
                Number::Fixed(constant) => T::from(*constant),
                _ => {
                    entry += 1;
                    p[entry - 1]
                }
            };
        }
    }

    /// Values of all numbers: constants, and the last entries of `p`.
    ///
    /// # Panics
    /// If `N` is not the count of numbers, or if `p` has too few entries.
    #[inline(always)]
    pub fn last_of<T: Scalar, const N: usize>(&self, p: &[T]) -> [T; N] {
        let first = p
            .len()
            .checked_sub(self.varied())
            .expect("`p` has fewer entries than numbers that vary");
        self.of(&p[first..])
    }

    /// The numbers that are not fixed, as entries of `p` from `first`.
    pub fn placed(&self, first: usize) -> Vec<Varied> {
        let varied = self.listed().filter(|(_, number)| !number.is_fixed());
        varied
            .enumerate()
            .map(|(i, (name, &number))| Varied { index: first + i, name: name.into(), number })
            .collect()
    }
}

/// A number that is not fixed, and its place in the parameters of a sample.
#[derive(Clone, Debug, PartialEq)]
pub struct Varied {
    /// Index in `p`.
    pub index: usize,
    /// Name of the number. If the effect is [`Named`](crate::effect::Named), the name of the effect
    /// precedes it: `wind.speed`.
    pub name: String,
    /// The number.
    pub number: Number,
}

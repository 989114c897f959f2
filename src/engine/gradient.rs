//! [`Gradient`]: a vector over the parameters, with a common exponent.

use crate::numbers::extended::{ExtendedF64, exponent_of, scaled, scaled_with_sign};
use crate::numbers::kernels::{SimdLevel, elementwise};
use crate::numbers::scalar::Float;
use crate::numbers::zip::zip;
use std::ops::Range;

/// Gradient `values · 2^exponent`. The exponent is 0 unless the values approach the limits of `F`.
///
/// If an adjoint explodes or vanishes, the values are scaled: the largest absolute value is then
/// between 1 and 2. A value that underflows keeps its sign and becomes the smallest subnormal
/// number.
#[derive(Clone, Debug)]
pub struct Gradient<F> {
    values: Vec<F>,
    /// Common exponent, valid unless `spread`.
    exponent: i32,
    /// Exponent of each value, valid if `spread`.
    exponents: Vec<i32>,
    /// True while every value has its own exponent.
    spread: bool,
}

/// Compares values and common exponent.
impl<F: Float> PartialEq for Gradient<F> {
    fn eq(&self, other: &Self) -> bool {
        (&self.values, self.exponent) == (&other.values, other.exponent)
    }
}

/// Bound on the binary exponents of partial sums. Far from the limits of f32, 2^-126 and 2^128.
const MAX_EXPONENT: i32 = 60;

impl<F: Float> Gradient<F> {
    /// Creates a zero gradient.
    pub fn zeros(params: usize) -> Self {
        Self {
            values: vec![F::zero(); params],
            exponent: 0,
            exponents: vec![0; params],
            spread: false,
        }
    }

    /// The gradient with these values, for a vector from elsewhere.
    pub fn new(values: &[F]) -> Self {
        Self { values: values.to_vec(), ..Self::zeros(values.len()) }
    }

    /// Values, to be multiplied by 2 to the power of [`exponent`](Gradient::exponent).
    /// [`to_vec`](Gradient::to_vec) returns plain numbers.
    pub fn values(&self) -> &[F] {
        &self.values
    }

    /// Common binary exponent.
    pub fn exponent(&self) -> i32 {
        self.exponent
    }

    /// Euclidean norm.
    pub fn norm(&self) -> ExtendedF64 {
        let square = elementwise::moments(SimdLevel::best(), &self.values, &self.values).0;
        ExtendedF64::new(square.sqrt(), self.exponent)
    }

    /// Returns the values times 2^exponent, which become infinite, or 0, beyond the range of `F`.
    pub fn to_vec(&self) -> Vec<F> {
        self.values.iter().map(|&value| scaled(value, self.exponent)).collect()
    }

    /// Returns [`to_vec`](Gradient::to_vec) in f64, whose range is larger than that of f32.
    pub fn to_f64(&self) -> Vec<f64> {
        self.values.iter().map(|value| scaled(value.as_(), self.exponent)).collect()
    }

    /// Bytes on the heap of a gradient of `params` parameters.
    pub(crate) const fn bytes_of(params: usize) -> usize {
        params * (size_of::<F>() + size_of::<i32>())
    }

    pub(crate) fn stored_bytes(&self) -> usize {
        size_of_val(&self.values[..]) + size_of_val(&self.exponents[..])
    }

    /// Sets the common exponent and returns the values for writing.
    pub(crate) fn values_mut(&mut self, exponent: i32) -> &mut [F] {
        (self.spread, self.exponent) = (false, exponent);
        &mut self.values
    }

    pub(crate) fn clear(&mut self) {
        self.values_mut(0).fill(F::zero());
    }

    /// Returns the partial sum for in-place addition, unless every value has its own exponent.
    pub(crate) fn unscaled_sum(&mut self) -> Option<&mut [F]> {
        (!self.spread).then_some(&mut self.values)
    }

    /// Adds `part · 2^exponent`.
    pub(crate) fn add_part(&mut self, part: &[F], exponent: i32) {
        self.spread();
        for (i, &part) in part.iter().enumerate() {
            self.add_to(i, part, exponent);
        }
    }

    /// Adds another sum, normalized or not, to a sum that is not normalized.
    pub(crate) fn add(&mut self, other: &Self) {
        if !self.spread && !other.spread && other.exponent == 0 {
            for (sum, &part) in zip(self.values.iter_mut(), &other.values) {
                *sum += part;
            }
            return;
        }
        self.spread();
        for (i, &part) in other.values.iter().enumerate() {
            self.add_to(i, part, if other.spread { other.exponents[i] } else { other.exponent });
        }
    }

    /// Copies `other` if `set` is true, otherwise adds it.
    pub(crate) fn set_or_add(&mut self, other: &Self, set: bool) {
        if set { self.copy_from(other) } else { self.add(other) }
    }

    /// Copies another gradient of equal length without allocating.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.values.copy_from_slice(&other.values);
        (self.exponent, self.spread) = (other.exponent, other.spread);
        if self.spread {
            self.exponents.copy_from_slice(&other.exponents);
        }
    }

    /// Appends the bytes of a range of values, with their exponents.
    pub(crate) fn write_slice(&self, range: Range<usize>, bytes: &mut Vec<u8>) {
        bytes.reserve(8 + range.len() * (size_of::<F>() + if self.spread { 4 } else { 0 }));
        bytes.push(u8::from(self.spread));
        bytes.extend(self.exponent.to_le_bytes());
        // Every f32 is an f64.
        let is_f32 = size_of::<F>() == size_of::<f32>();
        for value in &self.values[range.clone()] {
            let value: f64 = value.as_();
            if is_f32 {
                bytes.extend((value as f32).to_le_bytes())
            } else {
                bytes.extend(value.to_le_bytes())
            }
        }
        if self.spread {
            self.exponents[range].iter().for_each(|exponent| bytes.extend(exponent.to_le_bytes()));
        }
    }

    /// Reads a range of values and their exponents, as [`write_slice`](Self::write_slice) writes
    /// them, from the start of `bytes`. Removes the bytes that it reads.
    ///
    /// # Panics
    /// If `bytes` is too short.
    pub(crate) fn read_slice(&mut self, range: Range<usize>, bytes: &mut &[u8]) {
        fn take<const N: usize>(bytes: &mut &[u8]) -> [u8; N] {
            let (first, rest) =
                bytes.split_first_chunk().expect("the message of another rank is complete");
            *bytes = rest;
            *first
        }
        self.spread = take::<1>(bytes) == [1];
        self.exponent = i32::from_le_bytes(take(bytes));
        let is_f32 = size_of::<F>() == size_of::<f32>();
        for value in &mut self.values[range.clone()] {
            *value = F::from_f64(if is_f32 {
                f32::from_le_bytes(take(bytes)).into()
            } else {
                f64::from_le_bytes(take(bytes))
            });
        }
        if self.spread {
            self.exponents[range]
                .iter_mut()
                .for_each(|exponent| *exponent = i32::from_le_bytes(take(bytes)));
        }
    }

    /// Switches from the common exponent 0 to one exponent per value.
    fn spread(&mut self) {
        if !self.spread {
            self.spread = true;
            self.exponents.fill(0);
        }
    }

    /// Adds `part · 2^exponent` to one value.
    pub(crate) fn add_at(&mut self, i: usize, part: F, exponent: i32) {
        if exponent == 0 && !self.spread {
            self.values[i] += part;
        } else {
            self.spread();
            self.add_to(i, part, exponent);
        }
    }

    /// One value with its exponent.
    pub(crate) fn part(&self, i: usize) -> (F, i32) {
        (self.values[i], if self.spread { self.exponents[i] } else { self.exponent })
    }

    fn add_to(&mut self, i: usize, part: F, exponent: i32) {
        let (value, own) = (&mut self.values[i], &mut self.exponents[i]);
        if part == F::zero() {
            return;
        }
        if *value == F::zero() || exponent > *own {
            (*value, *own) = (scaled(*value, own.saturating_sub(exponent)) + part, exponent);
        } else {
            *value += scaled(part, exponent.saturating_sub(*own));
        }
        let size: f64 = value.as_();
        if size.is_finite() && size != 0.0 && exponent_of(size).abs() > MAX_EXPONENT {
            let by = exponent_of(size);
            (*value, *own) = (scaled(*value, -by), *own + by);
        }
    }

    /// Common exponent of values whose largest exponent is `largest`: 0 if plain numbers suffice.
    fn common(largest: i32) -> i32 {
        // Below 2^reach, the sum of squares is finite. Above 2^-reach, most of the range remains
        // for smaller values.
        let reach = if F::EPSILON < 1e-10 { 500 } else { 60 };
        if (-reach..reach).contains(&largest) { 0 } else { largest }
    }

    /// Replaces all values, with a common exponent.
    pub(crate) fn set(&mut self, values: &[f64]) {
        let finite = values.iter().copied().filter(|value| *value != 0.0 && value.is_finite());
        let exponent = Self::common(finite.map(exponent_of).max().unwrap_or(0));
        for (own, &value) in zip(self.values_mut(exponent).iter_mut(), values) {
            let rounded = F::from_f64(scaled(value, -exponent));
            // An underflow keeps the sign.
            let sign = F::from_f64(value.signum());
            *own = if rounded == F::zero() && value != 0.0 {
                scaled_with_sign(sign, -10_000)
            } else {
                rounded
            };
        }
    }

    /// Brings all values to a common exponent, 0 if plain numbers suffice.
    pub(crate) fn normalize(&mut self) {
        if !std::mem::take(&mut self.spread) {
            return;
        }
        let finite = |value: F| value.as_().is_finite();
        let leading = |(&value, &exponent): (&F, &i32)| {
            let size: f64 = value.as_();
            (size != 0.0 && size.is_finite()).then(|| exponent + exponent_of(size))
        };
        let largest =
            zip(self.values.iter(), &self.exponents).filter_map(leading).max().unwrap_or(0);
        self.exponent = Self::common(largest);
        for (value, &exponent) in zip(self.values.iter_mut(), &self.exponents) {
            if finite(*value) {
                *value = scaled_with_sign(*value, exponent - self.exponent);
            }
        }
    }

    /// Sets the gradient to 0 if only signs remain, because every nonzero value has underflowed.
    pub(crate) fn drop_signs(&mut self) {
        let smallest = scaled_with_sign(F::one(), -10_000);
        if self.exponent != 0 && self.values.iter().all(|value| value.as_().abs() <= smallest.as_())
        {
            self.clear();
        }
    }

    /// Returns the gradient with another common exponent.
    pub(crate) fn with_exponent(mut self, exponent: i32) -> Self {
        let by = self.exponent.saturating_sub(exponent);
        self.values.iter_mut().for_each(|value| *value = scaled_with_sign(*value, by));
        self.exponent = exponent;
        self
    }

    /// Sets the exponent to 0. Values become infinite, or 0, beyond the range of `F`.
    pub(crate) fn flatten(&mut self) {
        let exponent = std::mem::take(&mut self.exponent);
        if exponent != 0 {
            self.values.iter_mut().for_each(|value| *value = scaled(*value, exponent));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terms_from_2_to_the_minus_5000_to_2_to_the_3000_add_up_and_keep_their_sign() {
        let mut sum = Gradient::<f32>::zeros(4);
        sum.add_part(&[1.0, 1.0, 0.0, -1.0], 3000);
        sum.add_part(&[3.0, -1.0, -1.0, 1.0], 2999);
        sum.add_part(&[0.0, 0.0, 1.0, 0.0], -5000);
        sum.normalize();
        // 2.5, 0.5, -0.5 and -0.5, times 2^3000.
        assert_eq!((sum.exponent(), sum.values()), (3001, &[1.25, 0.25, -0.25, -0.25][..]));
        let mut tiny = Gradient::<f32>::zeros(2);
        tiny.add_part(&[1.0, 0.0], 3000);
        tiny.add_part(&[0.0, -1.0], -3000);
        tiny.normalize();
        assert_eq!((tiny.exponent(), tiny.values()), (3000, &[1.0, -f32::from_bits(1)][..]));
        approx::assert_relative_eq!(
            tiny.norm().log10(),
            3000.0 * 2f64.log10(),
            max_relative = 1e-12
        );
    }

    #[test]
    fn sums_within_the_range_of_the_type_have_exponent_0() {
        let mut sum = Gradient::<f32>::zeros(2);
        sum.unscaled_sum().expect("plain").copy_from_slice(&[1.0, 2.0]);
        sum.add_part(&[1.0, 1.0], 3);
        sum.normalize();
        assert_eq!((sum.exponent(), sum.values()), (0, &[9.0, 10.0][..]));
        let (mut a, mut b) = (Gradient::<f64>::zeros(1), Gradient::zeros(1));
        a.add_part(&[1.0], 2000);
        b.add_part(&[-1.0], 2000);
        a.add(&b);
        a.normalize();
        assert_eq!((a.exponent(), a.values()), (0, &[0.0][..]));
    }
}

//! Effects known at compile time: tuples of up to six, applied in order.

use super::Effect;
use crate::dynamics::inputs::{Cotangents, OdeInputs};
use crate::dynamics::number::Varied;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Real, Scalar};

/// No effect.
impl<B> Effect<B> for () {
    #[inline(always)]
    fn add_forces<T: Scalar>(&self, _model: &B, _inputs: OdeInputs<'_, T>, _forces: &mut [T]) {}
    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        _model: &B,
        _inputs: OdeInputs<'_, R>,
        _forces_bar: &[C],
        _bars: Cotangents<'_, C>,
    ) {
    }
    #[inline(always)]
    fn state_dependent(&self) -> bool {
        false
    }
    fn diagnose<R: Real>(
        &self,
        _model: &B,
        _inputs: OdeInputs<'_, R>,
        _forces: usize,
    ) -> Option<&'static str> {
        None
    }
}

macro_rules! both {
    ($($effect:ident $i:tt),+) => {
        /// Applies all effects in order. Parameters follow each other in the same order.
        impl<B, $($effect: Effect<B>),+> Effect<B> for ($($effect,)+) {
            #[inline(always)]
            fn param_dim(&self) -> usize {
                0 $(+ self.$i.param_dim())+
            }
            fn varied(&self, mut first: usize) -> Vec<Varied> {
                let mut all = Vec::new();
                $(
                    all.extend(self.$i.varied(first));
                    first += self.$i.param_dim();
                )+
                let _ = first;
                all
            }
            fn draw_params(&self, rng: &mut Rng, p: &mut [f64]) {
                let mut first = 0;
                $(
                    let count = self.$i.param_dim();
                    self.$i.draw_params(rng, &mut p[first..first + count]);
                    first += count;
                )+
                debug_assert_eq!(first, p.len());
            }
            #[inline(always)]
            fn add_forces<T: Scalar>(&self, model: &B, mut inputs: OdeInputs<'_, T>, forces: &mut [T]) {
                $(
                    self.$i.add_forces(model, inputs, forces);
                    inputs = inputs.skip_params(self.$i.param_dim());
                )+
                let _ = inputs;
            }
            #[inline(always)]
            fn vjp<R: Real, C: Cotangent<R>>(
                &self,
                model: &B,
                mut inputs: OdeInputs<'_, R>,
                forces_bar: &[C],
                mut cotangents: Cotangents<'_, C>,
            ) {
                $(
                    self.$i.vjp(model, inputs, forces_bar, cotangents.reborrow());
                    inputs = inputs.skip_params(self.$i.param_dim());
                    cotangents = cotangents.skip_params(self.$i.param_dim());
                )+
                let _ = (inputs, cotangents);
            }
            #[inline(always)]
            fn state_dependent(&self) -> bool {
                false $(|| self.$i.state_dependent())+
            }
            fn diagnose<R: Real>(&self, model: &B, mut inputs: OdeInputs<'_, R>, forces: usize) -> Option<&'static str> {
                $(
                    if let Some(name) = self.$i.diagnose(model, inputs, forces) {
                        return Some(name);
                    }
                    inputs = inputs.skip_params(self.$i.param_dim());
                )+
                let _ = inputs;
                None
            }
        }
    };
}
both!(E0 0);
both!(E0 0, E1 1);
both!(E0 0, E1 1, E2 2);
both!(E0 0, E1 1, E2 2, E3 3);
both!(E0 0, E1 1, E2 2, E3 3, E4 4);
both!(E0 0, E1 1, E2 2, E3 3, E4 4, E5 5);

//! [`system_without_effects`]: a [`ForcedSystem`](super::ForcedSystem) as a system on its own.

/// Implements [`System`] and [`HasModel`] for a [`ForcedSystem`] without effects.
macro_rules! system_without_effects {
    ($system:ty) => {
        impl crate::dynamics::system::System for $system {
            fn state_dim(&self) -> usize {
                crate::dynamics::effect::ForcedSystem::state_dim(self)
            }

            fn control_dim(&self) -> usize {
                crate::dynamics::effect::ForcedSystem::control_dim(self)
            }

            fn param_dim(&self) -> usize {
                use crate::dynamics::effect::ForcedSystem;
                ForcedSystem::param_dim(self) + ForcedSystem::numbers(self).varied()
            }

            #[inline(always)]
            fn numbers(&self) -> crate::dynamics::number::Numbers<'_> {
                crate::dynamics::effect::ForcedSystem::numbers(self)
            }

            #[inline(always)]
            fn step<T: crate::numbers::scalar::Scalar>(
                &self,
                inputs: crate::dynamics::inputs::Inputs<'_, T>,
                next: &mut [T],
            ) {
                crate::dynamics::effect::ForcedSystem::forced_step(self, &(), inputs, next);
            }

            #[inline(always)]
            fn vjp<R: crate::numbers::scalar::Real, C: crate::numbers::scalar::Cotangent<R>>(
                &self,
                inputs: crate::dynamics::inputs::Inputs<'_, R>,
                next_bar: &[C],
                mut cotangents: crate::dynamics::inputs::Cotangents<'_, C>,
            ) {
                if cotangents.p.is_some()
                    && crate::dynamics::effect::ForcedSystem::numbers(self).varied() > 0
                {
                    crate::dynamics::effect::step_param_vjp(
                        self,
                        inputs,
                        next_bar,
                        cotangents.p.take(),
                    );
                }
                crate::dynamics::effect::ForcedSystem::forced_vjp(
                    self,
                    &(),
                    inputs,
                    next_bar,
                    cotangents,
                );
            }
        }

        impl
            crate::dynamics::effect::HasModel<
                <$system as crate::dynamics::effect::ForcedSystem>::Model,
            > for $system
        {
            #[inline(always)]
            fn model(&self) -> &<$system as crate::dynamics::effect::ForcedSystem>::Model {
                crate::dynamics::effect::ForcedSystem::model(self)
            }

            fn start_extra(
                &self,
                _rng: &mut crate::numbers::rng::Rng,
                _start: crate::dynamics::inputs::Start<'_>,
            ) {
            }
        }
    };
}
pub(crate) use system_without_effects;

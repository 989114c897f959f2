//! Systems without effects.

/// Implements [`System`] for a [`ForcedSystem`] without effects.
macro_rules! system_without_effects {
    ($host:ty) => {
        impl crate::dynamics::system::System for $host {
            fn state_dim(&self) -> usize {
                crate::dynamics::effect::ForcedSystem::state_dim(self)
            }

            fn control_dim(&self) -> usize {
                crate::dynamics::effect::ForcedSystem::control_dim(self)
            }

            #[inline(always)]
            fn step<T: crate::numbers::scalar::Scalar>(&self, x: &[T], u: &[T], next: &mut [T]) {
                crate::dynamics::effect::ForcedSystem::forced_step(self, &(), x, u, next);
            }

            #[inline(always)]
            fn vjp<R: crate::numbers::scalar::Real, C: crate::numbers::scalar::Cotangent<R>>(
                &self,
                x: &[R],
                u: &[R],
                next_bar: &[C],
                x_bar: &mut [C],
                u_bar: &mut [C],
            ) {
                crate::dynamics::effect::ForcedSystem::reverse(self, &(), x, u, next_bar, Some(x_bar), Some(u_bar));
            }

            #[inline(always)]
            fn vjp_state<R: crate::numbers::scalar::Real, C: crate::numbers::scalar::Cotangent<R>>(
                &self,
                x: &[R],
                u: &[R],
                next_bar: &[C],
                x_bar: &mut [C],
            ) {
                crate::dynamics::effect::ForcedSystem::reverse(self, &(), x, u, next_bar, Some(x_bar), None);
            }

            #[inline(always)]
            fn vjp_control<R: crate::numbers::scalar::Real, C: crate::numbers::scalar::Cotangent<R>>(
                &self,
                x: &[R],
                u: &[R],
                next_bar: &[C],
                u_bar: &mut [C],
            ) {
                crate::dynamics::effect::ForcedSystem::reverse(self, &(), x, u, next_bar, None, Some(u_bar));
            }
        }

        impl crate::dynamics::effect::HasModel<<$host as crate::dynamics::effect::ForcedSystem>::Model> for $host {
            #[inline(always)]
            fn model(&self) -> &<$host as crate::dynamics::effect::ForcedSystem>::Model {
                crate::dynamics::effect::ForcedSystem::model(self)
            }

            fn start_extra(&self, _rng: &mut crate::numbers::rng::Rng, _x: &mut [f64]) {}
        }
    };
}
pub(crate) use system_without_effects;

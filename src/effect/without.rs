//! Systems without effects.

/// Makes a [`Host`] a [`System`] of its own: the one without effects.
macro_rules! system_without_effects {
    ($host:ty) => {
        impl crate::system::System for $host {
            fn state_dim(&self) -> usize {
                crate::effect::Host::state_dim(self)
            }

            fn control_dim(&self) -> usize {
                crate::effect::Host::control_dim(self)
            }

            #[inline(always)]
            fn step<T: crate::scalar::Scalar>(&self, x: &[T], u: &[T], next: &mut [T]) {
                crate::effect::Host::step_with(self, &(), x, u, next);
            }

            #[inline(always)]
            fn vjp<R: crate::scalar::Real, C: crate::scalar::Cotangent<R>>(
                &self,
                x: &[R],
                u: &[R],
                next_bar: &[C],
                x_bar: &mut [C],
                u_bar: &mut [C],
            ) {
                crate::effect::Host::reverse(self, &(), x, u, next_bar, Some(x_bar), Some(u_bar));
            }

            #[inline(always)]
            fn vjp_state<R: crate::scalar::Real, C: crate::scalar::Cotangent<R>>(
                &self,
                x: &[R],
                u: &[R],
                next_bar: &[C],
                x_bar: &mut [C],
            ) {
                crate::effect::Host::reverse(self, &(), x, u, next_bar, Some(x_bar), None);
            }

            #[inline(always)]
            fn vjp_control<R: crate::scalar::Real, C: crate::scalar::Cotangent<R>>(
                &self,
                x: &[R],
                u: &[R],
                next_bar: &[C],
                u_bar: &mut [C],
            ) {
                crate::effect::Host::reverse(self, &(), x, u, next_bar, None, Some(u_bar));
            }
        }

        impl crate::effect::Around<<$host as crate::effect::Host>::Body> for $host {
            #[inline(always)]
            fn body(&self) -> &<$host as crate::effect::Host>::Body {
                crate::effect::Host::body(self)
            }

            fn start_beyond(&self, _rng: &mut crate::rng::Rng, _x: &mut [f64]) {}
        }
    };
}
pub(crate) use system_without_effects;

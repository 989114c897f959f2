//! [`forward`] and [`forward_model`]: methods of wrappers that those of an inner system define.

/// Defines methods of a trait by the methods of equal name of the field `$inner`, a `$trait`.
macro_rules! forward {
    ($trait:ident of $inner:ident: $($method:ident),+) => {
        $($crate::dynamics::forward::forward!(@$method $trait $inner);)+
    };
    (@varied $trait:ident $inner:ident) => {
        fn varied(&self, params: usize) -> Vec<$crate::dynamics::number::Varied> {
            $trait::varied(&self.$inner, params)
        }
    };
    (@control_bounds $trait:ident $inner:ident) => {
        fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
            $trait::control_bounds(&self.$inner)
        }
    };
    (@ended $trait:ident $inner:ident) => {
        fn ended(&self) -> Option<usize> {
            $trait::ended(&self.$inner)
        }
    };
    (@$dimension:ident $trait:ident $inner:ident) => {
        fn $dimension(&self) -> usize {
            $trait::$dimension(&self.$inner)
        }
    };
}

/// Defines the methods of `HasModel<$model>` by those of the field `$inner`.
macro_rules! forward_model {
    ($inner:ident, $model:ty) => {
        #[inline(always)]
        fn model(&self) -> &$model {
            self.$inner.model()
        }

        fn start_extra(
            &self,
            rng: &mut $crate::numbers::rng::Rng,
            start: $crate::dynamics::inputs::Start<'_>,
        ) {
            self.$inner.start_extra(rng, start);
        }
    };
}

pub(crate) use {forward, forward_model};

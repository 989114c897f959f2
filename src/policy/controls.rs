//! [`controls`]: the controls of many observations, outside of rollouts.

use super::{AnyPolicy, PolicyColumns, PolicyPass, Weights};
use crate::numbers::aligned::Aligned;
use crate::numbers::scalar::Float;

/// Largest number of observations in one forward pass.
const BLOCK: usize = 32;

/// Controls for the observations `y` of a policy without a memory, both `[row][component]`.
///
/// # Panics
/// If the policy has a memory, or `y` is not a whole number of rows.
pub fn controls<F: Float>(policy: &dyn AnyPolicy<F>, weights: &Weights<F>, y: &[F]) -> Vec<F> {
    let (width, m) = (policy.observation_dim(), policy.control_dim());
    assert!(policy.memory_dim() == 0, "a policy with a memory acts in rollouts only");
    assert!(y.len().is_multiple_of(width), "`y` has {} numbers; expected rows of {width}", y.len());
    let mut u = vec![F::zero(); y.len() / width * m];
    for (y, u) in y.chunks(BLOCK * width).zip(u.chunks_mut(BLOCK * m)) {
        let columns = y.len() / width;
        let mut tape = Aligned::zeros(policy.sizes(columns).tape);
        policy.forward(
            PolicyPass::new(weights.packed(), PolicyColumns::range(0..columns), y),
            &mut tape,
            u,
        );
    }
    u
}

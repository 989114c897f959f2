//! Reference losses and derivatives in double-double arithmetic.

use super::oracle::rollouts;
use crate::dynamics::task::Task;
use crate::engine::flow::Flow;
use crate::numbers::scalar::{DoubleDouble, Dual};
use crate::policy::Policy;

/// Mean loss of rollouts and its directional derivative, by forward mode in double-double
/// arithmetic.
///
/// `starts` concatenates the initial states of the samples, each followed by its parameters. `flow`
/// selects the differentiated paths. The function ignores a [`cut`](Flow::cut) of the flow.
/// `direction(i)` is the component of the direction along policy parameter i. The function returns
/// `[loss, slope]`, rounded to `f64`.
///
/// Parameters, initial states and physical constants enter as exact `f64` values. Use the result
/// only as a reference: the computation is orders of magnitude slower than in `f64`.
/// ```
/// use physgrad::{Flow, Task, check, policy::Linear, tasks::CartPole};
///
/// let task = CartPole { horizon: 10, ..CartPole::new(1) };
/// let (policy, theta) = (Linear::new(4, 1), [0.1, -0.2, 0.3, -0.4]);
/// let start = [0.0, 0.0, 3.0, 0.0];
/// let [loss, slope] = check::slope(&task, &policy, &theta, &start, Flow::REGULAR, |i| if i == 2 { 1.0 } else { 0.0 });
/// assert!(loss > 0.0 && slope != 0.0);
/// ```
///
/// # Panics
/// If the length of `theta` is not [`Policy::param_count`], or if `starts` is empty or not a whole
/// number of samples.
pub fn slope<T: Task, P: Policy>(
    task: &T,
    policy: &P,
    theta: &[f64],
    starts: &[f64],
    flow: Flow,
    direction: impl Fn(usize) -> f64,
) -> [f64; 2] {
    let seeded = |(i, &value)| Dual {
        value: DoubleDouble::from(value),
        tangents: [DoubleDouble::from(direction(i))],
    };
    let theta: Vec<_> = theta.iter().enumerate().map(seeded).collect();
    let constants: Vec<_> = starts.iter().map(|&x| Dual::from(x)).collect();
    let starts = (&constants[..], starts);
    let Dual { value, tangents: [slope] } = rollouts(task, policy, &theta, starts, flow);
    [value.to_f64(), slope.to_f64()]
}

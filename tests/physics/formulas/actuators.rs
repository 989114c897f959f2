//! Delay, lag and limits of controls.

use super::*;

#[test]
fn limits_lags_and_delays_equal_their_formulas() {
    /// Returns a system that sums the outputs of the actuator.
    fn through<A: Actuator>(actuator: A) -> Actuated<Accumulator, A> {
        Actuated { system: Accumulator { dim: 1 }, actuator }
    }
    steps_as("smooth limit", &through(Limit { bound: 1.7, kind: LimitKind::Smooth }), |x, u| {
        vec![x[0] + 1.7 * (u[0] / 1.7).tanh()]
    });
    steps_as("hard limit", &through(Limit { bound: 1.7, kind: LimitKind::Hard }), |x, u| {
        vec![x[0] + u[0].clamp(-1.7, 1.7)]
    });
    // Solution of df/dt = (u - f) / 0.2 after 0.05 s.
    let late = |x: &[f64], u: &[f64]| u[0] + (x[1] - u[0]) * (-0.05_f64 / 0.2).exp();
    steps_as("lag", &through(Lag::new(0.2, 0.05)), |x, u| vec![x[0] + late(x, u), late(x, u)]);
    steps_as("delay", &through(Delay { steps: 2 }), |x, u| vec![x[0] + x[1], x[2], u[0]]);
    let both = vec![
        AnyActuator::Limit(Limit { bound: 1.7, kind: LimitKind::Smooth }),
        AnyActuator::Lag(Lag::new(0.2, 0.05)),
    ];
    steps_as("limit and lag", &through(both), |x, u| {
        let late = late(x, &[1.7 * (u[0] / 1.7).tanh()]);
        vec![x[0] + late, late]
    });
}

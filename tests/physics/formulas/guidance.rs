//! Guidance and its effects.

use super::*;

/// Acceleration of agent `k` due to agent `i`, as a function of `k`, `i`, their separation and the
/// softened distance.
type Pull = fn(usize, usize, [f64; 2], f64) -> [f64; 2];

/// Returns the effects on pairs of agents, with their accelerations. Agents 0 and 1 are drivers.
fn between() -> Vec<(GuidanceEffect, Pull)> {
    fn times(by: f64, [x, y]: [f64; 2]) -> [f64; 2] {
        [by * x, by * y]
    }
    vec![
        (Spread { strength: 0.7 }.into(), |k, i, r, d| {
            times(if k < 2 && i < 2 { 0.7 / (d * d) } else { 0.0 }, r)
        }),
        (Evade { strength: 3.1 }.into(), |k, i, r, d| {
            times(if k >= 2 && i < 2 { 3.1 / (d * d) } else { 0.0 }, r)
        }),
        (Drive { strength: 1.9 }.into(), |k, i, r, d| {
            times(if k < 2 && i >= 2 { -1.9 / (d * d) } else { 0.0 }, r)
        }),
        (Flock { strength: 0.8, distance: 1.4 }.into(), |k, i, r, d| {
            times(if k >= 2 && i >= 2 { -0.8 * (1.4 / d - 1.0) / d } else { 0.0 }, r)
        }),
    ]
}

/// Acceleration of agent `k` as a function of its state, independent of the other agents.
type Alone = fn(usize, &[f64]) -> [f64; 2];

/// Returns the effects on single agents, with their accelerations. Agents 0 and 1 are drivers.
fn alone() -> Vec<(GuidanceEffect, Alone)> {
    let obstacles =
        Obstacles { centers: vec![[0.5, -0.3], [-1.5, 1.0]], radius: 1.2, stiffness: 9.0 };
    vec![
        (Friction { drivers: 1.3, evaders: 3.7 }.into(), |k, x| {
            let friction = if k < 2 { 1.3 } else { 3.7 };
            [-friction * x[2], -friction * x[3]]
        }),
        (obstacles.into(), |_, x| {
            [[0.5, -0.3], [-1.5, 1.0]].iter().fold([0.0; 2], |sum, center| {
                let r = [x[0] - center[0], x[1] - center[1]];
                let far = (r[0] * r[0] + r[1] * r[1]).sqrt();
                let push = 9.0 * (1.2 - far).max(0.0) / (0.2 + far);
                [sum[0] + push * r[0], sum[1] + push * r[1]]
            })
        }),
        (Walls { half_width: 1.5, half_height: 0.8, stiffness: 7.0 }.into(), |_, x| {
            [(x[0], 1.5), (x[1], 0.8)]
                .map(|(x, half)| -7.0 * x.signum() * (x.abs() - half).max(0.0))
        }),
    ]
}

#[test]
fn steps_of_guidance_with_each_effect_equal_their_formulas() {
    let softening = 0.2;
    for center in [Center::Sum, Center::Mean] {
        let model = GuidanceSystem { drivers: 2, evaders: 3, center, softening, dt: 0.07 };
        // Explicit Euler with the accelerations of the controls and of an effect.
        let next = |x: &[f64], u: &[f64], added: &dyn Fn(usize) -> [f64; 2]| -> Vec<f64> {
            let agents: Vec<&[f64]> = x.chunks_exact(4).collect();
            let share = if matches!(center, Center::Sum) { 1.0 } else { 1.0 / 3.0 };
            let herd =
                [0, 1].map(|axis| share * agents[2..].iter().map(|agent| agent[axis]).sum::<f64>());
            let moved = |(k, agent): (usize, &&[f64])| {
                let mut a = added(k);
                if k < 2 {
                    let (q, c) = ([agent[0] - herd[0], agent[1] - herd[1]], &u[2 * k..]);
                    a = [a[0] + c[0] * q[0] - c[1] * q[1], a[1] + c[0] * q[1] + c[1] * q[0]];
                }
                let [x, y, vx, vy] = [agent[0], agent[1], agent[2], agent[3]];
                [x + 0.07 * vx, y + 0.07 * vy, vx + 0.07 * a[0], vy + 0.07 * a[1]]
            };
            agents.iter().enumerate().flat_map(moved).collect()
        };
        for (effect, pull) in between() {
            steps_as(&format!("{effect:?}"), &Forced { system: model, effects: effect }, |x, u| {
                next(x, u, &|k| {
                    (0..5).filter(|&i| i != k).fold([0.0; 2], |sum, i| {
                        let r = [x[4 * k] - x[4 * i], x[4 * k + 1] - x[4 * i + 1]];
                        let pull = pull(k, i, r, softening + (r[0] * r[0] + r[1] * r[1]).sqrt());
                        [sum[0] + pull[0], sum[1] + pull[1]]
                    })
                })
            });
        }
        for (effect, alone) in alone() {
            let system = Forced { system: model, effects: effect.clone() };
            steps_as(&format!("{effect:?}"), &system, |x, u| {
                next(x, u, &|k| alone(k, &x[4 * k..4 * k + 4]))
            });
        }
    }
}

//! Stability of the time step along test rollouts.

use crate::operations::trajectory::{self, Trajectory};
use physgrad::check::{self, Stability};
use physgrad::rng::Purpose;
use physgrad::{Divergence, DynTask, Inputs, Policy, System, Task, Weights, initial_states};
use std::collections::BTreeMap;

/// Number of test rollouts.
pub const ROLLOUTS: usize = 4;
/// Number of consecutive steps that must ring. A single impact with restitution reverses a
/// perturbation too.
const CONSECUTIVE: usize = 3;
/// Largest number of states after which the growth is computed, and of states between two that
/// alternate.
const WINDOWS: usize = 16;
/// Bound on the number of evaluated states times the cubed number of state components. The time is
/// about 30 multiplications and additions each.
const PRODUCTS: usize = 20_000_000;
/// Smallest number of states that [`amplification`] evaluates, if the rollouts have as many; a
/// quarter of it beyond 100 state components.
const LEAST: usize = 32;
/// Multiplications and additions per component and state of the power iteration, divided by 30.
const ITERATED: usize = 24_000;
/// Largest number of states whose norms of ∂S/∂x are compared.
const CANDIDATES: usize = 4_000;

/// Stability of the steps of test rollouts.
pub struct Amplification {
    /// State with the largest amplification of a perturbation by a step: among those after which
    /// perturbations grow more than [`check::HARMLESS`], otherwise among all.
    pub worst: Place,
    /// Growth of a perturbation over the steps after `worst`, or a bound. NaN if that of `worst` is.
    pub growth: f64,
    /// Largest [norm](check::jacobian_norm) of ∂S/∂x among the states that were evaluated.
    pub norm: f64,
    /// State between two that alternate, if `worst` is there.
    pub chatter: Option<Between>,
    /// State in which a perturbation alternates in sign and decays most slowly, among consecutive
    /// steps that [ring](Stability::rings). `None` if only single steps ring, such as impacts.
    pub ringing: Option<Place>,
    /// Number of states that were evaluated.
    pub evaluated: usize,
    /// Number of states of the test rollouts.
    pub states: usize,
    /// First non-finite number of the test rollouts.
    pub divergence: Option<Divergence>,
}

/// State between two consecutive states of a rollout, with the control of the first one.
#[derive(Clone)]
pub struct Between {
    sample: usize,
    x: Vec<f64>,
    u: Vec<f64>,
    p: Vec<f64>,
    t: usize,
}

impl Between {
    /// The state where component i of the next state decreases most steeply with component i, on the
    /// line from the state of step t to the next one.
    ///
    /// The step exchanges two alternating states, so its mean slope between them is -1. If the slopes
    /// at both ends are larger, that of a state between them is below -1.
    fn steepest(
        task: &DynTask,
        sample: usize,
        Trajectory { states, controls, params }: &Trajectory,
        [t, i]: [usize; 2],
    ) -> Self {
        /// Halvings of the line.
        const HALVINGS: usize = 40;
        let (u, p) = (controls[t].clone(), params[t].clone());
        let at = |share: f64| -> Vec<f64> {
            let pairs = states[t].iter().zip(&states[t + 1]);
            pairs.map(|(a, b)| a + share * (b - a)).collect()
        };
        let next = |share: f64| {
            let (x, mut next) = (at(share), states[t].clone());
            System::step(task.system(), Inputs { x: &x, u: &u, p: &p, t }, &mut next);
            next[i]
        };
        let rise = |[a, b]: [f64; 2]| (next(b) - next(a)) / (states[t + 1][i] - states[t][i]);
        let mut line = [0.0, 1.0];
        for _ in 0..HALVINGS {
            let middle = 0.5 * (line[0] + line[1]);
            let halves = [[line[0], middle], [middle, line[1]]];
            line = if rise(halves[0]) < rise(halves[1]) { halves[0] } else { halves[1] };
            // Rounding errors exceed the differences of shorter lines.
            if line[1] - line[0] < 1e-7 {
                break;
            }
        }
        Self { sample, x: at(0.5 * (line[0] + line[1])), u, p, t }
    }

    fn inputs(&self) -> Inputs<'_, f64> {
        let Self { x, u, p, t, .. } = self;
        Inputs { x, u, p, t: *t }
    }

    fn place(&self, task: &DynTask) -> Place {
        let stability = check::stability(task.system(), self.inputs());
        Place { sample: self.sample, step: self.t, stability }
    }
}

/// Stability of one step of a test rollout.
#[derive(Clone, Copy)]
pub struct Place {
    /// Index of the test rollout.
    pub sample: usize,
    /// Step of the rollout.
    pub step: usize,
    pub stability: Stability,
}

/// Stability in states of test rollouts with the parameters `theta`.
///
/// A step that chatters jumps over a state of rest to and fro, with a stable multiplier on either
/// side: the state between them is unstable. `known` is such a state of a longer step. Without it,
/// the rollouts are searched for alternating states.
///
/// # Errors
/// A rollout diverges in the first step.
pub fn amplification(
    task: &DynTask,
    policy: &impl Policy,
    theta: &[f64],
    seed: u64,
    known: Option<&Between>,
) -> Result<Amplification, Divergence> {
    let weights = Weights::new(policy, theta.to_vec());
    let starts = initial_states(task, seed, Purpose::Test, ROLLOUTS);
    let (rollouts, divergence) =
        trajectory::until_divergence(task, policy, &weights, &starts, 0..ROLLOUTS);
    let visited = Visited::of(task, &rollouts);
    let indices = evaluated(task, &visited.states);
    let places: BTreeMap<usize, Place> =
        indices.into_iter().map(|i| (i, visited.place(i))).collect();
    let horizon = Task::horizon(task);
    let mut worst = worst(&places, horizon, |place| visited.growth_after(place));
    let norm = |inputs: Inputs<'_, f64>| check::jacobian_norm(task.system(), inputs);
    let mut largest =
        places.keys().fold(0.0_f64, |largest, &i| largest.max(norm(visited.states[i].1)));
    let between = match known {
        Some(known) => vec![known.clone()],
        None => { alternating(&rollouts).into_iter() }
            .map(|(sample, place)| Between::steepest(task, sample, &rollouts[sample], place))
            .collect(),
    };
    let mut chatter = None;
    for between in
        between.into_iter().filter(|between| between.x.len() == task.system().state_dim())
    {
        let place = between.place(task);
        largest = largest.max(norm(between.inputs()));
        let Stability { multiplier, lowest, .. } = place.stability;
        let is_chatter = !place.stability.is_stable_within(horizon)
            && (known.is_some() || lowest < -1.0)
            && worst.is_some_and(|(worst, growth)| {
                growth <= check::HARMLESS || multiplier > worst.stability.multiplier
            });
        if is_chatter {
            worst = Some((place, place.stability.growth(horizon)));
            chatter = Some(between);
        }
    }
    let evaluated = places.len();
    let ringing = visited.ringing(places);
    match (worst, divergence) {
        (Some((worst, growth)), _) => Ok(Amplification {
            worst,
            growth,
            norm: largest,
            chatter,
            ringing,
            evaluated,
            states: visited.states.len(),
            divergence,
        }),
        (_, Some(divergence)) => Err(divergence),
        _ => unreachable!("finite rollouts of at least one step have states"),
    }
}

/// The states of test rollouts.
struct Visited<'a> {
    task: &'a DynTask,
    /// Rollout and inputs of each step, in order.
    states: Vec<(usize, Inputs<'a, f64>)>,
}

impl<'a> Visited<'a> {
    fn of(task: &'a DynTask, rollouts: &'a [Trajectory]) -> Self {
        let of_rollout =
            |(sample, Trajectory { states, controls, params }): (_, &'a Trajectory)| {
                let inputs =
                    move |t: usize| Inputs { x: &states[t], u: &controls[t], p: &params[t], t };
                (0..controls.len()).map(move |t| (sample, inputs(t)))
            };
        Self { task, states: rollouts.iter().enumerate().flat_map(of_rollout).collect() }
    }

    fn place(&self, i: usize) -> Place {
        let (sample, inputs) = self.states[i];
        Place { sample, step: inputs.t, stability: check::stability(self.task.system(), inputs) }
    }

    /// Growth of a perturbation over the rest of a rollout.
    fn growth_after(&self, place: &Place) -> f64 {
        let rest = { self.states.iter() }
            .filter(|(sample, inputs)| *sample == place.sample && inputs.t >= place.step);
        let steps: Vec<Inputs<'_, f64>> = rest.map(|(_, inputs)| *inputs).collect();
        check::growth_along(self.task.system(), &steps)
    }

    /// The place of [`Amplification::ringing`]. `seen` has the places that are evaluated already, by
    /// the index of the state.
    fn ringing(&self, mut seen: BTreeMap<usize, Place>) -> Option<Place> {
        let mut candidates: Vec<(usize, Place)> = { seen.iter().map(|(&i, &place)| (i, place)) }
            .filter(|(_, at)| at.stability.rings())
            .collect();
        candidates.sort_by(|a, b| a.1.stability.lowest.total_cmp(&b.1.stability.lowest));
        candidates.into_iter().find_map(|(i, candidate)| {
            let mut rings = |i: usize| {
                i < self.states.len() && {
                    let at = seen.entry(i).or_insert_with(|| self.place(i));
                    at.sample == candidate.sample && at.stability.rings()
                }
            };
            // Lengths of the runs of steps that ring, before and after this one.
            let before = (1..CONSECUTIVE).take_while(|k| i.checked_sub(*k).is_some_and(&mut rings));
            let before = before.count();
            let after = (1..CONSECUTIVE - before).take_while(|k| rings(i + k)).count();
            (before + 1 + after >= CONSECUTIVE).then_some(candidate)
        })
    }
}

/// The place of [`Amplification::worst`], with the growth over the steps after it. `after` computes
/// the growth over the rest of a rollout. A multiplier that is harmless also if every step has it
/// bounds the growth without this computation.
fn worst(
    places: &BTreeMap<usize, Place>,
    horizon: usize,
    after: impl Fn(&Place) -> f64,
) -> Option<(Place, f64)> {
    let mut sorted: Vec<Place> = places.values().copied().collect();
    // `check::stability` returns NaN with a positive sign. `total_cmp` ranks this NaN above every
    // number.
    sorted.sort_by(|a, b| b.stability.multiplier.total_cmp(&a.stability.multiplier));
    let first = *sorted.first()?;
    if first.stability.multiplier.is_nan() {
        return Some((first, f64::NAN));
    }
    sorted.retain(|place| !place.stability.is_stable_within(horizon));
    let mut begins = BTreeMap::new();
    for place in &sorted {
        let begin = begins.entry(place.sample).or_insert(*place);
        *begin = if place.step < begin.step { *place } else { *begin };
    }
    // The largest multipliers, and the longest parts of rollouts.
    let spaced = sorted.iter().step_by(sorted.len().div_ceil(WINDOWS).max(1));
    let mut growth = 0.0_f64;
    for place in spaced.chain(begins.values()) {
        let over = after(place);
        if over > check::HARMLESS {
            return Some((*place, over));
        }
        growth = growth.max(over);
    }
    let is_bound = sorted.is_empty();
    Some((first, if is_bound { first.stability.growth(horizon) } else { growth }))
}

/// Sample, step and component of each run of steps in which a component alternates: its increments
/// change their sign and keep their size. At most [`WINDOWS`], those of the longest runs.
fn alternating(rollouts: &[Trajectory]) -> Vec<(usize, [usize; 2])> {
    /// Smallest increment, relative to the largest value of the component.
    const RESOLVED: f64 = 1e-9;
    let mut found: Vec<(usize, (usize, [usize; 2]))> = Vec::new();
    for (sample, Trajectory { states, controls, .. }) in rollouts.iter().enumerate() {
        for i in 0..states[0].len() {
            let largest = states.iter().fold(0.0_f64, |largest, x| largest.max(x[i].abs()));
            let step = |t: usize| states[t + 1][i] - states[t][i];
            let turns = |t: usize| {
                let (now, next) = (step(t), step(t + 1));
                now * next < 0.0
                    && now.abs().max(next.abs()) <= 2.0 * now.abs().min(next.abs())
                    && now.abs() > RESOLVED * largest
            };
            let mut run = 0;
            for t in 0..controls.len() {
                run = if t + 1 < controls.len() && turns(t) { run + 1 } else { 0 };
                if run >= CONSECUTIVE {
                    // The next state of the same run.
                    if run > CONSECUTIVE {
                        found.pop();
                    }
                    found.push((run, (sample, [t, i])));
                }
            }
        }
    }
    found.sort_by_key(|found| std::cmp::Reverse(found.0));
    found.truncate(WINDOWS);
    found.into_iter().map(|(_, place)| place).collect()
}

/// Indices of the states that [`amplification`] evaluates: all if the cost permits. Otherwise half
/// of them are evenly spaced, and the others have the largest norms of ∂S/∂x.
///
/// A contact may occupy few steps of a rollout, but its stiffness enlarges the norm.
fn evaluated(task: &DynTask, states: &[(usize, Inputs<'_, f64>)]) -> Vec<usize> {
    let n = task.system().state_dim();
    let cost = if n <= check::DENSE { n.pow(3) } else { n * ITERATED };
    let most = (PRODUCTS / cost.max(1)).max(if n <= 100 { LEAST } else { LEAST / 4 });
    if states.len() <= most {
        return (0..states.len()).collect();
    }
    let spaced = |count: usize| (0..states.len()).step_by(states.len().div_ceil(count));
    let candidates = spaced(CANDIDATES.min(states.len()));
    let mut by_norm: Vec<(f64, usize)> =
        candidates.map(|i| (check::jacobian_norm(task.system(), states[i].1), i)).collect();
    by_norm.sort_by(|a, b| b.0.total_cmp(&a.0));
    spaced(most / 2).chain(by_norm.into_iter().take(most / 2).map(|(_, i)| i)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::operations::policy_file;
    use physgrad::policy::Linear;
    use physgrad::rng::Rng;
    use physgrad::tasks::{FrictionScheme, Slider};
    use physgrad::{Scalar, Start};

    /// Components that decay, except in one step of 750, in which the first grows by 3.
    struct Kick {
        components: usize,
    }

    impl System for Kick {
        fn state_dim(&self) -> usize {
            self.components
        }
        fn control_dim(&self) -> usize {
            1
        }
        fn step<T: Scalar>(&self, Inputs { x, u, t, .. }: Inputs<'_, T>, next: &mut [T]) {
            for (next, &x) in next.iter_mut().zip(x) {
                *next = x * 0.5;
            }
            next[0] = x[0] * if t == 7 { 3.0 } else { 0.5 } + u[0];
        }
    }

    impl Task for Kick {
        type System = Self;
        fn system(&self) -> &Self {
            self
        }
        fn horizon(&self) -> usize {
            750
        }
        fn start(&self, _rng: &mut Rng, Start { x, .. }: Start<'_>) {
            x.fill(1.0);
        }
        fn running_cost<T: Scalar>(&self, _inputs: Inputs<'_, T>, next: &[T]) -> T {
            next[0] * next[0]
        }
    }

    fn found(components: usize) -> Amplification {
        let policy = Linear::new(components, 1);
        let (task, theta) = (DynTask::new(Kick { components }), policy_file::random(&policy, 0));
        amplification(&task, &policy, &theta, 0, None)
            .unwrap_or_else(|divergence| panic!("{divergence}"))
    }

    #[test]
    fn a_single_unstable_step_is_found_also_if_only_some_states_are_evaluated() {
        let all = found(2);
        assert_eq!((all.worst.step, all.evaluated, all.states), (7, 3000, 3000));
        assert!((all.worst.stability.multiplier - 3.0).abs() < 1e-6);
        let some = found(40);
        assert!(some.worst.step == 7 && some.evaluated < some.states);
    }

    /// Beyond 200 components, by power iteration.
    #[test]
    #[ignore = "long: several seconds"]
    fn a_single_unstable_step_of_201_components_is_found() {
        let some = found(201);
        assert!(some.worst.step == 7 && some.evaluated < some.states);
    }

    /// Speeds that a brake stops: the first of `self.0` steps lets a perturbation grow by 6 %.
    struct Brake(usize);

    impl System for Brake {
        fn state_dim(&self) -> usize {
            1
        }
        fn control_dim(&self) -> usize {
            1
        }
        fn step<T: Scalar>(&self, Inputs { x, u, t, .. }: Inputs<'_, T>, next: &mut [T]) {
            next[0] = x[0] * if t % self.0 == 0 { 1.06 } else { 0.99 } + u[0];
        }
    }

    impl Task for Brake {
        type System = Self;
        fn system(&self) -> &Self {
            self
        }
        fn horizon(&self) -> usize {
            100
        }
        fn start(&self, _rng: &mut Rng, Start { x, .. }: Start<'_>) {
            x.fill(1.0);
        }
    }

    fn found_in(task: impl Task + 'static) -> Amplification {
        let task = DynTask::new(task);
        let policy = Linear::new(task.system().state_dim(), 1);
        amplification(&task, &policy, &vec![0.0; task.system().state_dim()], 0, None)
            .unwrap_or_else(|divergence| panic!("{divergence}"))
    }

    #[test]
    fn growth_is_that_of_the_steps_that_follow() {
        // One step of 1.06 would be 1.06^100 = 340, if all steps were like it.
        for (every, growth) in [(100, 1.06), (2, 1.06 * (1.06_f64 * 0.99).powi(14))] {
            let found = found_in(Brake(every));
            assert!((found.worst.stability.multiplier - 1.06).abs() < 1e-6);
            assert_eq!(found.growth > check::HARMLESS, every == 2, "{}", found.growth);
            assert!((found.growth / growth - 1.0).abs() < 0.3, "{} {growth}", found.growth);
        }
    }

    /// `1 - dt μ g/ε` at rest, beside multipliers of 1 in all states of the rollouts.
    #[test]
    fn a_step_that_chatters_is_unstable_between_its_states() {
        for (smoothing, scheme, expected) in [
            (0.01, FrictionScheme::Explicit, Some(3.905)),
            (0.001, FrictionScheme::Explicit, Some(48.05)),
            (0.03, FrictionScheme::Explicit, None),
            (0.001, FrictionScheme::Implicit, None),
        ] {
            let mut slider = Slider::default();
            (slider.system.smoothing, slider.system.scheme) = (smoothing, scheme);
            let found = found_in(slider);
            let multiplier = found.chatter.as_ref().map(|_| found.worst.stability.multiplier);
            assert_eq!(multiplier.is_some(), expected.is_some(), "{smoothing}: {multiplier:?}");
            if let (Some(found), Some(expected)) = (multiplier, expected) {
                assert!((found / expected - 1.0_f64).abs() < 1e-3, "{found}, not {expected}");
            }
        }
    }

    /// Speeds that decay slowly, but change their sign in the first `self.0` steps of every `self.1`. There are
    /// `self.2` components.
    struct Reversals(usize, usize, usize);

    impl System for Reversals {
        fn state_dim(&self) -> usize {
            self.2
        }
        fn control_dim(&self) -> usize {
            1
        }
        fn step<T: Scalar>(&self, Inputs { x, u, t, .. }: Inputs<'_, T>, next: &mut [T]) {
            let factor = if t % self.1 < self.0 { -0.8 } else { 0.99 };
            for (next, &x) in next.iter_mut().zip(x) {
                *next = x * 0.5;
            }
            next[0] = x[0] * factor + u[0];
        }
    }

    impl Task for Reversals {
        type System = Self;
        fn system(&self) -> &Self {
            self
        }
        fn horizon(&self) -> usize {
            600
        }
        fn start(&self, _rng: &mut Rng, Start { x, .. }: Start<'_>) {
            x.fill(1.0);
        }
    }

    #[test]
    fn consecutive_steps_ring_and_single_impacts_do_not() {
        fn rings(components: usize, steps: usize, of: usize) -> bool {
            let policy = Linear::new(components, 1);
            let (task, theta) = (Reversals(steps, of, components), policy_file::random(&policy, 0));
            let found = amplification(&DynTask::new(task), &policy, &theta, 0, None)
                .unwrap_or_else(|divergence| panic!("{divergence}"));
            assert!(found.ringing.is_none_or(|at| at.step % of < steps));
            found.ringing.is_some()
        }
        assert!(!rings(2, 1, 30) && !rings(2, 2, 30));
        // The last steps of a rollout and the first ones of the next do not add up.
        assert!(rings(2, 3, 30) && rings(2, 3, 600) && !rings(2, 2, 300));
        // Only some of the states are evaluated at first.
        assert!(!rings(40, 1, 2) && rings(40, 3, 4));
    }
}

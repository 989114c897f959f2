//! [`Windows`]: training by windows of an episode. [`Episodes`]: episodes in progress.

use super::TrainError;
use super::critic::{Critic, CriticState, ValueSettings};
use super::units::{Coordinates, Moments, Units};
use super::window::Window;
use crate::dynamics::dyn_task::DynTask;
use crate::dynamics::number::{draw_key, key_of_epoch};
use crate::dynamics::system::System as _;
use crate::dynamics::task::Task;
use crate::engine::any::AnyTask;
use crate::engine::divergence::Divergence;
use crate::engine::gradient::Gradient;
use crate::engine::initial_states::initial_states;
use crate::engine::rollout::Rollout;
use crate::engine::visited::Visited;
use crate::numbers::aligned::Aligned;
use crate::numbers::rng::{Purpose, stream};
use crate::numbers::scalar::Float;
use crate::policy::{AnyPolicy, PolicyColumns, PolicyPass, Weights};
use crate::train::Training;
use serde::{Deserialize, Serialize};

/// Settings of a training by windows: each update sees `steps` steps of its episodes, and the next one
/// continues where they ended.
///
/// The training set consists of episodes in progress, one per sample. They continue from update to
/// update, and begin anew after the horizon of the task, or when an episode has
/// [ended](crate::episode::Ending), from the same initial states or, with
/// [`Training::resample`](crate::Training::resample), from new ones. An epoch is one horizon: each mini-batch has one update
/// per window. A last window that does not fit into the horizon is left out. The losses of the test set
/// are those of whole episodes.
///
/// With a value function, the first episodes are shortened so that an equal number begins anew before
/// each window, and an update sees all phases of an episode. Without a value function, they begin
/// together, and the gradient of a window knows nothing of later costs. In tasks that depend on the
/// number of the step, this number is that of the epoch, not of the episode.
/// SHAC (Xu et al. 2022, arXiv:2204.07137) is such a training along R.
///
/// ```
/// use physgrad::episode::Windows;
/// use physgrad::{DynTask, Trainer, Training, policy::Mlp, tasks::CartPole};
///
/// let task = CartPole { horizon: 500, ..CartPole::new(1) };
/// let training = Training { batch: 16, train_samples: 16, test_samples: 16, ..Training::default() };
/// let report = Trainer::new(task, Mlp::new([4, 16, 1]))
///     .training(training)
///     .windows(Windows::new(DynTask::new(task), 25))
///     .epochs(1)
///     .run()?;
/// assert!(report.records[0].test_loss.is_finite());
/// # Ok::<(), physgrad::TrainError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Windows {
    /// The task of the training.
    pub task: DynTask,
    /// Steps of a window.
    pub steps: usize,
    /// Weight γ of the next step relative to this one: costs of step t of a window have the factor
    /// γ^t, and its value the factor γ^`steps`. Positive.
    pub discount: f64,
    /// Standard deviation of normal noise on each control, in its unit, during training: one number per
    /// control, or none. Where the policy has bounds, a control with its noise is clipped at them.
    pub noise: Vec<f64>,
    /// Whether policy and value function are trained as networks of the observation in units of its
    /// running mean and standard deviation, and bounded controls in units of half their range. A drawn
    /// policy is drawn in these units; parameters that are given keep their function. The stored policy
    /// is one of the observation and the control themselves.
    pub normalize: bool,
    /// The value function of the last state of a window. `None` for no value.
    pub value: Option<ValueSettings>,
}

/// Smallest factor of the value at the end of a window: the costs of the last steps have to be exact in
/// f32.
const SMALLEST: f64 = 1e-30;

impl Windows {
    /// Windows of this many steps, with a discount of 0.99 and a value function with default
    /// settings.
    pub fn new(task: DynTask, steps: usize) -> Self {
        Self {
            task,
            steps,
            discount: 0.99,
            noise: Vec::new(),
            normalize: false,
            value: Some(ValueSettings::default()),
        }
    }

    /// The first window as a task, with a random value function, for checks of its derivatives.
    #[doc(hidden)]
    pub fn checked(&self, bounds: Option<Vec<[f64; 2]>>, seed: u64) -> DynTask {
        let value = self.value.as_ref().map(|settings| {
            let observed = AnyTask::<f64>::observed_dim(&self.task);
            Critic::<f64>::new(self, settings, observed, 1, seed, 1).random_value()
        });
        DynTask::new(Window::new(self, bounds, value))
    }

    /// The first window as a task without noise and without a value function.
    pub fn first(&self) -> DynTask {
        DynTask::new(Window::new(&Self { noise: Vec::new(), ..self.clone() }, None, None))
    }

    /// The map from parameters of a network in the units of a training to those of the policy. The units
    /// are those of episodes with the parameters `theta`, up to `steps` steps or a divergence. The map is
    /// linear, and the identity without [`normalize`](Self::normalize).
    pub fn coordinates(
        &self,
        policy: &dyn AnyPolicy<f64>,
        theta: &[f64],
        seed: u64,
        steps: usize,
    ) -> impl Fn(&mut [f64]) + use<> {
        /// Number of episodes.
        const SAMPLES: usize = 16;
        let coordinates = Coordinates::of(policy).filter(|_| self.normalize);
        let mut moments = Moments::default();
        if coordinates.is_some() {
            let mut window = Window::new(&Self { noise: Vec::new(), ..self.clone() }, None, None);
            let weights = Weights::new(policy, theta.to_vec());
            let mut rollout = Rollout::new(&window, policy, SAMPLES);
            let mut starts = initial_states(&window, seed, Purpose::Train, SAMPLES);
            let (ended, states) = (Task::ended(&window), AnyTask::<f64>::state_dim(&window));
            let each = AnyTask::<f64>::start_dim(&window);
            let mut visited = Visited::default();
            // Tables of the task end at its horizon.
            let last = steps.min(Task::horizon(&self.task)).max(self.steps) - self.steps;
            while window.origin <= last {
                rollout.start(&starts);
                if rollout.run(&window, policy, &weights).is_err() {
                    break;
                }
                visited.clear();
                visited.append(&window, &rollout);
                moments.add_running(&visited, ended, states);
                let stored = visited.states.chunks_exact((self.steps + 1) * states);
                for (start, stored) in starts.chunks_exact_mut(each).zip(stored) {
                    start[..states].copy_from_slice(&stored[self.steps * states..]);
                }
                window.origin += self.steps;
            }
        }
        move |theta: &mut [f64]| {
            if let Some(coordinates) = coordinates.as_ref().filter(|_| !moments.is_empty()) {
                coordinates.leave(&moments.units(coordinates.is_shifted()), theta);
            }
        }
    }

    /// What a policy has that windows do not carry on. `None` if it has nothing of the kind.
    pub fn problem_of<F: Float>(policy: &dyn AnyPolicy<F>) -> Option<&'static str> {
        if policy.memory_dim() > 0 {
            return Some(
                "has a memory, which begins anew in each window; use one without, or whole rollouts",
            );
        }
        let number = |x: f64| F::from_f64(x);
        let theta = (0..policy.param_count()).map(|i| number((i as f64 + 1.0).sin())).collect();
        let weights = Weights::new(policy, theta);
        let x: Vec<F> = (0..policy.observation_dim()).map(|i| number((i as f64).cos())).collect();
        let control = |t: usize| {
            let pass = PolicyPass::new(weights.packed(), PolicyColumns::range(0..1), &x);
            let mut u = vec![F::zero(); policy.control_dim()];
            let mut tape = Aligned::zeros(policy.sizes(1).tape);
            policy.forward(pass.at_steps(t..t + 1), &mut tape, &mut u);
            u
        };
        let first = control(0);
        let differs = |t: usize| control(t).iter().zip(&first).any(|(a, b)| a != b);
        // A controller may depend on t from some step on.
        let steps = [1, 2, 3, 5, 10, 30, 100, 300, 1_000, 3_000, 10_000, 100_000];
        steps.into_iter().any(differs).then_some(
            "depends on the number of the step, which begins anew in each window; use feedback, or whole rollouts",
        )
    }

    /// Checks the settings for a task with this state and horizon.
    ///
    /// # Errors
    /// [`TrainError::Setting`] for the first invalid setting.
    pub(super) fn validate<F: Float>(
        &self,
        training: &Training,
        policy: &dyn AnyPolicy<F>,
        dims: [usize; 3],
    ) -> Result<(), TrainError> {
        let Self { steps, discount, ref noise, .. } = *self;
        let invalid = |setting, problem| Err(TrainError::Setting { setting, problem });
        let horizon = Task::horizon(&self.task);
        let params = Task::param_dim(&self.task);
        let own = [self.task.system().state_dim(), params, horizon];
        if own != dims {
            let problem = "have another task than the training; pass the same task".into();
            return invalid("windows", problem);
        }
        if steps == 0 || steps > horizon {
            let problem = format!("is {steps}; allowed: 1 to {horizon}, the horizon");
            return invalid("window.steps", problem);
        }
        let allowed = discount > 0.0 && discount <= 1.0;
        if !allowed || (self.value.is_some() && discount == 1.0) {
            let below =
                if self.value.is_some() { "below 1, with a value function" } else { "up to 1" };
            let problem = format!("is {discount}; allowed: a positive number {below}");
            return invalid("discount", problem);
        }
        if let Some(deviation) = noise.iter().find(|noise| !(**noise >= 0.0 && noise.is_finite())) {
            let problem = format!("is {deviation}; allowed: a number of 0 or more");
            return invalid("window.noise", problem);
        }
        let controls = self.task.system().control_dim();
        if !noise.is_empty() && noise.len() != controls {
            let problem = format!("has {} numbers for {controls} controls", noise.len());
            return invalid("window.noise", problem);
        }
        if training.smoothing.is_some() {
            return invalid("estimator", "is for whole rollouts; remove it, or the windows".into());
        }
        if let Some(problem) = Self::problem_of(policy) {
            return invalid("policy", problem.into());
        }
        if discount.powi(steps as i32) < SMALLEST {
            let problem = format!(
                "is {discount}, and {SMALLEST:e} or less after the {steps} steps of a window; use shorter windows, or a number nearer to 1"
            );
            return invalid("discount", problem);
        }
        if self.normalize && policy.input_layer().is_none() {
            let problem = "needs a policy with a layer of the whole observation; use an MLP, or remove the setting";
            return invalid("window.normalize", problem.into());
        }
        match self.value.as_ref().and_then(ValueSettings::problem) {
            Some((setting, problem)) => invalid(setting, problem),
            None => Ok(()),
        }
    }
}

/// Episodes in progress, one per training sample.
#[derive(Debug)]
pub(super) struct Episodes<F: Float> {
    pub(super) window: Window,
    /// Windows per epoch.
    pub(super) windows: usize,
    steps: usize,
    discount: f64,
    critic: Option<Critic<F>>,
    /// Layers of the policy that are trained in other units, if so, and whether the policy was drawn.
    coordinates: Option<(Coordinates, bool)>,
    moments: Moments,
    units: Units,
    /// Initial states of the training set, for windows. Empty if episodes draw new ones.
    given: Vec<F>,
    /// Where the next window of each episode begins.
    carried: Vec<F>,
    progress: Vec<Progress>,
    tally: Tally,
    samples: usize,
    /// Numbers per sample in a list of initial states, and in a state.
    each: usize,
    states: usize,
    is_noisy: bool,
    seed: u64,
}

/// What a checkpoint holds of [`Episodes`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct EpisodesState<F> {
    carried: Vec<F>,
    progress: Vec<Progress>,
    tally: Tally,
    moments: Moments,
    critic: Option<CriticState<F>>,
}

/// Progress of one episode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Progress {
    /// Windows since its start, or those that it counts as at the start of the training.
    windows: usize,
    /// Running costs so far.
    cost: f64,
    /// Whether it began in the middle, so that its costs are not those of an episode.
    is_part: bool,
}

/// Sums over an epoch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Tally {
    /// Running costs of all windows.
    cost: f64,
    /// Episodes that came to an end, and their running costs.
    whole: usize,
    cost_of_whole: f64,
    /// Windows that did not diverge.
    finished: usize,
    error: f64,
    /// Variances of the error of the value function, and of its targets.
    variances: [f64; 2],
    /// Episodes that took part in windows that did not diverge, counted once per window.
    parts: usize,
}

impl<F: Float> Episodes<F> {
    /// Episodes from the initial states `train` of the task.
    pub(super) fn new(
        settings: Windows,
        training: &Training,
        policy: &dyn AnyPolicy<F>,
        is_drawn: bool,
        train: &[F],
    ) -> Self {
        let task: &dyn AnyTask<F> = &settings.task;
        let samples = train.len() / task.start_dim();
        let critic = settings.value.as_ref().map(|value| {
            let batch = training.batch.min(samples);
            let observed = task.observed_dim();
            Critic::new(&settings, value, observed, batch, training.seed, training.workers)
        });
        let (steps, inner) = (settings.steps, task.start_dim());
        let numbers = task.state_dim() + task.param_dim();
        let windows = task.horizon() / steps;
        let coordinates = Coordinates::of(policy);
        let units = Units::default();
        let value = critic.as_ref().map(|critic| critic.value(&units));
        let window = Window::new(&settings, policy.control_bounds(), value);
        let task: &dyn AnyTask<F> = &window;
        let (each, is_noisy) = (task.start_dim(), !task.noise().is_empty());
        let mut given = Vec::new();
        for (sample, start) in train.chunks_exact(inner).enumerate().filter(|_| !training.resample)
        {
            let first = given.len();
            given.extend_from_slice(&start[..numbers]);
            given.resize(first + each, F::zero());
            if is_noisy {
                let own = start.get(numbers).map(|key| key.as_());
                let drawn = || draw_key(&mut stream(training.seed, Purpose::Noise, sample as u64));
                given[first + each - 1] = F::from_f64(own.unwrap_or_else(drawn));
            }
        }
        Self {
            states: task.state_dim(),
            carried: vec![F::zero(); samples * each],
            progress: vec![Progress::default(); samples],
            tally: Tally::default(),
            coordinates: coordinates.filter(|_| settings.normalize).map(|own| (own, is_drawn)),
            moments: Moments::default(),
            units,
            window,
            windows,
            steps,
            discount: settings.discount,
            critic,
            given,
            samples,
            each,
            is_noisy,
            seed: training.seed,
        }
    }

    /// Begins an epoch, counted from 0. In the first one, and without a value function in each, all
    /// episodes begin. With a value function, the first ones count as if they had begun in turn.
    pub(super) fn begin(&mut self, epoch: usize) {
        self.tally = Tally::default();
        if epoch > 0 && self.critic.is_some() {
            return;
        }
        for sample in 0..self.samples {
            self.restart(sample, epoch, 0);
            if self.critic.is_some() {
                let turn = sample * self.windows / self.samples;
                let windows = (self.windows - turn) % self.windows;
                self.progress[sample] = Progress { windows, cost: 0.0, is_part: windows > 0 };
            }
        }
    }

    /// One episode begins anew before this window of this epoch.
    fn restart(&mut self, sample: usize, epoch: usize, window: usize) {
        self.progress[sample] = Progress::default();
        let place = sample * self.each..(sample + 1) * self.each;
        if !self.given.is_empty() {
            self.carried[place.clone()].copy_from_slice(&self.given[place.clone()]);
            if self.is_noisy
                && let Some(key) = self.carried[place].last_mut()
            {
                let number = (epoch * self.windows + window) as u64;
                *key = F::from_f64(key_of_epoch(key.as_(), number));
            }
            return;
        }
        let begun = (epoch as u64 * self.windows as u64 + window as u64) * self.samples as u64;
        let mut start = vec![0.0; self.each];
        let mut rng = stream(self.seed, Purpose::Train, begun + sample as u64);
        AnyTask::<F>::draw(&self.window, &mut rng, &mut start);
        self.carried[place].iter_mut().zip(start).for_each(|(own, x)| *own = F::from_f64(x));
    }

    /// Writes where the windows of a mini-batch begin.
    pub(super) fn select(&mut self, chosen: &[usize], window: usize, starts: &mut Vec<F>) {
        self.window.origin = window * self.steps;
        for &sample in chosen {
            starts.extend_from_slice(&self.carried[sample * self.each..][..self.each]);
        }
    }

    /// Continues the episodes of a mini-batch after a window, and trains the value function.
    ///
    /// # Errors
    /// [`Divergence`] in the training of the value function.
    pub(super) fn finish(
        &mut self,
        chosen: &[usize],
        epoch: usize,
        window: usize,
        visited: &Visited<F>,
    ) -> Result<(), Divergence> {
        let ended = Task::ended(&self.window);
        if let Some(critic) = &mut self.critic {
            let fit = critic.learn(visited, ended, &self.units)?;
            self.tally.error += fit.error;
            self.tally.variances.iter_mut().zip(fit.variances).for_each(|(sum, own)| *sum += own);
            self.window.value = Some(critic.value(&self.units));
        }
        self.tally.finished += 1;
        self.tally.parts += chosen.len();
        if self.coordinates.is_some() {
            self.moments.add_running(visited, ended, self.states);
        }
        let stored = (self.steps + 1) * self.states;
        let states = visited.states.chunks_exact(stored);
        let costs = visited.costs.chunks_exact(self.steps);
        for ((&sample, states), costs) in chosen.iter().zip(states).zip(costs) {
            // The costs of a window are discounted.
            let cost = |(t, cost): (usize, &F)| cost.as_() / self.discount.powi(t as i32);
            let cost: f64 = costs.iter().enumerate().map(cost).sum();
            self.tally.cost += cost;
            let progress = &mut self.progress[sample];
            progress.cost += cost;
            progress.windows += 1;
            let last = &states[self.steps * self.states..];
            let has_ended = ended.is_some_and(|ended| last[ended] != F::zero());
            if has_ended || progress.windows >= self.windows {
                if !progress.is_part {
                    self.tally.whole += 1;
                    self.tally.cost_of_whole += progress.cost;
                }
                self.restart(sample, epoch, window + 1);
            } else {
                self.carried[sample * self.each..][..self.states].copy_from_slice(last);
            }
        }
        Ok(())
    }

    /// Changes a gradient of the policy to one in units of the observations.
    pub(super) fn enter_gradient(&self, gradient: &mut Gradient<F>) {
        if let Some((coordinates, _)) = &self.coordinates {
            let exponent = gradient.exponent();
            coordinates.enter_gradient(&self.units, gradient.values_mut(exponent));
        }
    }

    /// Changes drawn parameters, which are those in units, to those of the policy. There are no
    /// observations yet.
    pub(super) fn begin_drawn(&self, theta: &mut [F]) {
        if let Some((coordinates, true)) = &self.coordinates {
            coordinates.leave(&self.units, theta);
        }
    }

    /// Changes the policy by a step in units of the observations, whose mean and deviation then become
    /// those of all observations. A drawn policy remains the same function of the normalized
    /// observations, and another one the same function of the observations.
    pub(super) fn step(&mut self, theta: &mut [F], step: impl FnOnce(&mut [F])) {
        let Some((coordinates, is_drawn)) = &self.coordinates else { return step(theta) };
        coordinates.enter(&self.units, theta);
        step(theta);
        let units = self.moments.units(coordinates.is_shifted());
        let before = std::mem::replace(&mut self.units, units);
        coordinates.leave(if *is_drawn { &self.units } else { &before }, theta);
        if let Some(critic) = &self.critic {
            self.window.value = Some(critic.value(&self.units));
        }
    }

    /// Begins the episodes of a mini-batch anew after a window that diverged.
    pub(super) fn abandon(&mut self, chosen: &[usize], epoch: usize, window: usize) {
        chosen.iter().for_each(|&sample| self.restart(sample, epoch, window + 1));
    }

    /// Mean running costs, with the noise, of the episodes that came to an end in this epoch. If there is
    /// none, of as many windows as an epoch has. NaN if all of them diverged.
    pub(super) fn loss(&self) -> f64 {
        match self.tally {
            Tally { whole, cost_of_whole, .. } if whole > 0 => cost_of_whole / whole as f64,
            Tally { cost, parts, .. } => cost / parts as f64 * self.windows as f64,
        }
    }

    /// Root mean square error of the value function, and the part of the variance of its targets that
    /// it explained. The latter is absent if the targets did not vary within any window.
    pub(super) fn fit(&self) -> [Option<f64>; 2] {
        let Tally { finished, error, variances: [of_error, of_targets], .. } = self.tally;
        if self.critic.is_none() || finished == 0 {
            return [None; 2];
        }
        let explained = (of_targets > 0.0).then(|| 1.0 - of_error / of_targets);
        [Some((error / finished as f64).sqrt()), explained]
    }

    /// Values of these observations.
    pub(super) fn values(&self, observations: &[F]) -> Option<Vec<f64>> {
        self.critic.as_ref().map(|critic| critic.values(observations, &self.units))
    }

    pub(super) fn state(&self) -> EpisodesState<F> {
        EpisodesState {
            carried: self.carried.clone(),
            progress: self.progress.clone(),
            tally: self.tally,
            moments: self.moments.clone(),
            critic: self.critic.as_ref().map(|critic| critic.state.clone()),
        }
    }

    pub(super) fn set_state(&mut self, state: &EpisodesState<F>) {
        self.carried.copy_from_slice(&state.carried);
        self.progress.copy_from_slice(&state.progress);
        self.tally = state.tally;
        self.moments = state.moments.clone();
        let shifted = self.coordinates.as_ref().is_some_and(|(own, _)| own.is_shifted());
        self.units = self.moments.units(shifted);
        if let (Some(critic), Some(state)) = (&mut self.critic, &state.critic) {
            critic.state = state.clone();
            self.window.value = Some(critic.value(&self.units));
        }
    }

    /// Checks that these episodes can reach this state.
    pub(super) fn validate(&self, state: &EpisodesState<F>) -> Result<(), String> {
        let (found, expected) = (state.carried.len(), self.carried.len());
        if found != expected || state.progress.len() != self.progress.len() {
            return Err(format!(
                "its episodes have {found} numbers, but those of this run {expected}"
            ));
        }
        if let Some(number) = state.carried.iter().find(|number| !number.as_().is_finite()) {
            return Err(format!("a number of its episodes is {number}"));
        }
        if !state.moments.is_valid(self.coordinates.as_ref().map_or(0, |(own, _)| own.inputs())) {
            return Err("its mean observation has another size, or is not finite".into());
        }
        match (&self.critic, &state.critic) {
            (None, None) => Ok(()),
            (Some(critic), Some(state)) => critic.state.validate(state),
            _ => Err("it has a value function, or lacks one, unlike this run".into()),
        }
    }
}

//! Scenes: validated settings with their task and policy, independent of the type of the task.

mod policy;

use crate::operations::amplification::{self, Amplification, Between};
use crate::operations::checks::Results;
use crate::operations::evaluation::AnyEvaluation;
use crate::operations::gradients::{Derived, GradientMethod};
use crate::operations::memory::{self, Needs};
use crate::operations::session::AnyRun;
use crate::operations::simulation::Job;
use crate::operations::trajectory::Trajectory;
use crate::operations::{
    checks, costs, evaluation, gradients, identification, session, simulation,
};
use crate::platform::memory::of_this_machine;
use crate::settings::config_error::ConfigError;
use crate::settings::reading::flat;
use crate::settings::{
    ActuatorSettings, DecayName, EstimatorName, FieldName, IntegratorSettings, LogFormat, OPTIONAL,
    Precision, TrainingSettings, WindowSettings,
};
use crate::tasks::policy::{Controlled, PolicySettings, ScenePolicy, is_kind};
use crate::tasks::settings::{Parts, Physics};
use crate::tasks::{AnyTaskSpec, Conserved, ModelParts, Settings, TaskSpec};
use anyhow::Result;
use physgrad::actuator::Actuator;
use physgrad::check::{Jumps, Kink, Plateau};
use physgrad::count::TaskOpCount;
use physgrad::engine::Cause;
use physgrad::episode::Windows;
use physgrad::graph::Operations;
use physgrad::identify::{Fit, IdentifyError, Options, Segment};
use physgrad::optimize::{self, Initial, OptimizeError, Plan};
use physgrad::policy::{Policy, WithParams};
use physgrad::train::TrainedNumber;
use physgrad::{Divergence, DynTask, Field, Number, System, Task};
use physgrad_plot::{Animation, Channel};
use policy::trained_of;
use std::borrow::Cow;
use std::sync::Arc;
use toml::{Table, Value};

/// Setting with the path of the policy file from which the training starts.
pub const INITIAL_POLICY: &str = "initial_policy";

const CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISCSI);

/// CRC-32C of a file.
pub fn checksum(bytes: &[u8]) -> u32 {
    CRC.checksum(bytes)
}

/// Validated settings of a run, with the task and the policy of these settings.
#[derive(Clone)]
pub struct Scene {
    /// Specification of the task.
    pub task: &'static dyn AnyTaskSpec,
    /// Vector field that the optimizer follows.
    pub field: FieldName,
    /// Floating-point precision.
    pub precision: Precision,
    /// Seed of initial states and parameters.
    pub seed: u64,
    /// Total number of epochs.
    pub epochs: usize,
    /// Time steps of a rollout.
    pub horizon: usize,
    /// Formats of the metrics besides CSV.
    pub logs: Vec<LogFormat>,
    /// Optimizer, data sets and memory.
    pub training: TrainingSettings,
    /// Integrator of the physics.
    pub integrator: IntegratorSettings,
    actuator: ActuatorSettings,
    physics: Arc<Physics>,
    policy: ScenePolicy,
    policy_settings: Arc<PolicySettings>,
    /// Trained numbers of the policy, by their keys.
    policy_numbers: Arc<[TrainedNumber]>,
    /// Path of the policy file from which the training starts.
    initial_policy_file: Option<String>,
    /// Contents of this file.
    initial_policy: Option<Arc<[u8]>>,
    window: Option<WindowSettings>,
    settings: Arc<dyn AnySettings>,
}

/// Why a setting has no effect on an estimator that reads losses only.
const LOSSES: &str = "`training.estimator` is zeroth_order, which follows differences of losses";

/// The part of [`Settings`] that depends on the type of the task, as an object.
trait AnySettings: Send + Sync {
    fn table(&self) -> Table;
    fn dt(&self) -> f64;
    fn controlled(&self, physics: &Physics) -> Controlled;
    fn angles(&self) -> Vec<usize>;
    fn param_names(&self, task: &DynTask) -> Vec<String>;
    fn control_names(&self) -> Vec<String>;
    fn equations(&self) -> Vec<(String, String)>;
    fn operations(&self) -> Option<Operations>;
    fn model_numbers(&self) -> Vec<(String, f64)>;
    fn model(&self) -> Option<ModelParts>;
    /// The physics with these typical values of trained numbers, if it depends on them.
    fn typical_physics(&self, values: &[(String, f64)]) -> Option<DynTask>;
    fn remarks(&self) -> Vec<String>;
    fn smoother(&self) -> Option<(&'static str, &'static str)>;
    fn unused(&self) -> Vec<String>;
    fn expression_of(&self, component: usize, cause: Option<Cause>) -> Option<String>;
    fn conserved(&self) -> Option<Conserved>;
    fn animation(&self, rollout: &Trajectory) -> Animation;
    fn unfinished(&self, rollout: &Trajectory, bounds: Option<&[[f64; 2]]>) -> Animation;
}

impl<K: TaskSpec> AnySettings for Settings<K> {
    fn table(&self) -> Table {
        Settings::table(self)
    }

    fn dt(&self) -> f64 {
        K::dt(self)
    }

    fn controlled(&self, physics: &Physics) -> Controlled {
        Settings::controlled(self, physics)
    }

    fn angles(&self) -> Vec<usize> {
        K::angles(self)
    }

    fn param_names(&self, task: &DynTask) -> Vec<String> {
        Settings::param_names(self, task)
    }

    fn control_names(&self) -> Vec<String> {
        K::control_names(self)
    }

    fn equations(&self) -> Vec<(String, String)> {
        K::equations(self)
    }

    fn operations(&self) -> Option<Operations> {
        K::operations(self)
    }

    fn model_numbers(&self) -> Vec<(String, f64)> {
        K::model_numbers(self)
    }

    fn model(&self) -> Option<ModelParts> {
        K::model(self)
    }

    fn typical_physics(&self, values: &[(String, f64)]) -> Option<DynTask> {
        Some(K::with_typical(self, values)?.physics().ok()?.task)
    }

    fn remarks(&self) -> Vec<String> {
        K::remarks(self)
    }

    fn smoother(&self) -> Option<(&'static str, &'static str)> {
        K::smoother(self)
    }

    fn unused(&self) -> Vec<String> {
        K::unused(self)
    }

    fn expression_of(&self, component: usize, cause: Option<Cause>) -> Option<String> {
        K::expression_of(self, component, cause)
    }

    fn conserved(&self) -> Option<Conserved> {
        K::conserved(self)
    }

    fn animation(&self, rollout: &Trajectory) -> Animation {
        K::animation(self, rollout)
    }

    fn unfinished(&self, rollout: &Trajectory, bounds: Option<&[[f64; 2]]>) -> Animation {
        K::unfinished(self, rollout, bounds)
    }
}

/// Colour of controls in animations.
const CONTROL: &str = "#D55E00";

/// Controls up to this number of steps. The last control holds until the final time.
fn held(controls: &[Vec<f64>], steps: f64) -> Vec<Vec<f64>> {
    let shown = &controls[..controls.len().min(steps.round() as usize)];
    [shown, shown.last().map_or(&[], std::slice::from_ref)].concat()
}

impl Scene {
    /// Creates a scene from validated settings.
    pub fn new<K: TaskSpec>(
        task: &'static dyn AnyTaskSpec,
        settings: Settings<K>,
        parts: Parts,
    ) -> Self {
        let Parts { physics, settings: policy_settings, built } = parts;
        let policy = WithParams::new(built.policy, trained_of(&physics.task));
        // Without parameters, every further epoch would repeat the first.
        let most_epochs = if policy.param_count() == 0 { 1 } else { usize::MAX };
        Self {
            task,
            field: settings.field,
            precision: settings.precision,
            seed: settings.seed,
            epochs: settings.epochs.min(most_epochs),
            horizon: settings.horizon,
            logs: settings.log.clone(),
            training: settings.training.clone(),
            integrator: settings.integrator,
            actuator: settings.actuator.clone(),
            physics: Arc::new(physics),
            policy,
            policy_numbers: built.numbers.into(),
            policy_settings: Arc::new(policy_settings),
            initial_policy_file: settings.initial_policy.clone(),
            initial_policy: None,
            window: settings.window.clone(),
            settings: Arc::new(settings),
        }
    }

    /// All settings, without empty optional sections. A scene file with this table has this scene.
    pub fn table(&self) -> Table {
        let mut table = self.settings.table();
        table.insert("field".into(), Value::String(self.field.into()));
        table.insert("seed".into(), Value::Integer(self.seed as i64));
        table
    }

    /// The scene without its sensor and the end of its episodes, for computations on measured states.
    ///
    /// # Errors
    /// An expression of the scene needs the sensor.
    pub fn without_sensor(self) -> Result<Self, ConfigError> {
        let mut table = self.table();
        if !make_bare(&mut table) {
            return Ok(self);
        }
        self.task.scene(table)
    }

    /// Copy with another field and seed.
    pub fn with(&self, field: FieldName, seed: u64) -> Self {
        Self { field, seed, ..self.clone() }
    }

    /// The task.
    pub fn task(&self) -> &DynTask {
        &self.physics.task
    }

    /// Range of each control, None without bounds: the range to which the actuators limit all
    /// controls, otherwise the bounds of the task.
    pub fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        let limited = self.actuator.chain(self.dt()).range();
        limited
            .map(|range| vec![range; self.physics.task.system().control_dim()])
            .or_else(|| self.physics.task.control_bounds())
    }

    /// Checks the gradients of system, policy and rollout, or of a window with a random value function.
    /// In rollouts, the policy has the parameters `theta`, or random ones. Results carry the name `variant`.
    pub fn check(&self, variant: &str, theta: Option<&[f64]>, results: &mut Results) {
        checks::check(&self.stepped(), &self.policy, theta, variant, results);
    }

    /// Stability of the steps of test rollouts, and at a state between two that alternate with
    /// longer steps.
    ///
    /// # Errors
    /// A rollout diverges in the first step.
    pub fn amplification(
        &self,
        theta: &[f64],
        known: Option<&Between>,
    ) -> Result<Amplification, Divergence> {
        amplification::amplification(&self.stepped(), &self.policy, theta, self.seed, known)
    }

    /// Kinks and jumps of the step, the observation and the costs along test rollouts.
    pub fn kinks(&self, theta: &[f64]) -> Vec<Kink> {
        checks::kinks(&self.stepped(), &self.policy, theta, self.seed)
    }

    /// Numbers of steps of test episodes. None if they cannot end, or if a rollout diverges.
    pub fn lengths(&self, theta: &[f64]) -> Option<Vec<usize>> {
        checks::lengths(&self.physics.task, &self.policy, theta, self.seed)
    }

    /// Loss and gradient at the parameters `theta` and at parameters nearby, of a window without its value
    /// function if updates see windows.
    pub fn plateau(&self, theta: &[f64]) -> Result<Plateau, Divergence> {
        let window = self.windows().map(|windows| windows.first());
        let task = window.unwrap_or_else(|| self.physics.task.clone());
        checks::plateau(&task, &self.policy, theta, self.seed)
    }

    /// Compares R with the derivative of the mean loss over the first steps, and over a ball of parameters
    /// in the units of the training. None if that would take long.
    pub fn jumps(&self, theta: &[f64], steps: usize) -> Option<Result<Jumps, Divergence>> {
        let task = match self.windows() {
            Some(windows) => Windows { steps, ..windows }.first(),
            None => {
                let system = self.physics.task.system().clone();
                self.physics.task.clone().adapted(system, 1, Vec::new(), steps)
            }
        };
        checks::jumps(&task, &self.policy, theta, self.seed, &self.coordinates(theta))
    }

    /// Key and value of a setting with which forces at contact begin without a jump, if the scene has
    /// another value.
    pub fn smoother(&self) -> Option<(&'static str, &'static str)> {
        self.settings.smoother()
    }

    /// Runs a rollout and its adjoints, and prepares them for timing.
    pub fn prepare(&self, theta: &[f64]) -> Job {
        let (task, policy) = (self.physics.task.clone(), self.policy.clone());
        simulation::job(task, policy, theta, self.precision, self.seed)
    }

    /// Gradient and its costs, by the given method in the given precision.
    pub fn derive(&self, theta: &[f64], precision: Precision, method: GradientMethod) -> Derived {
        let (task, policy) = (self.physics.task.clone(), self.policy.clone());
        gradients::derived(task, policy, theta, precision, self.seed, method)
    }

    /// Components of the gradients of R, M and S, in double-double arithmetic. The indices of their
    /// parameters are evenly spaced. Calls `done` after each component.
    pub fn refer(&self, theta: &[f64], done: &(dyn Fn() + Sync)) -> [Vec<f64>; 3] {
        gradients::reference(&self.physics.task, &self.policy, theta, self.seed, done)
    }

    /// Operation counts of a physics step and of its VJPs, and of the costs and the observation.
    pub fn cost(&self) -> TaskOpCount {
        TaskOpCount::of(&self.physics.task)
    }

    /// Bytes of a rollout of 8 samples, for evaluation or with the adjoint of a field.
    pub fn stored(&self, field: Option<Field>) -> usize {
        costs::stored(&self.physics.task, &self.policy, self.precision, field)
    }

    /// Prepares the policy with these parameters for rollouts from new initial states. Numbers that
    /// the scene trains have their initial values.
    pub fn evaluation(&self, theta: &[f64], seed: u64) -> Result<Box<dyn AnyEvaluation>> {
        self.check_memory()?;
        let (task, policy) = (self.physics.task.clone(), self.policy.clone());
        evaluation::new(task, policy, self.precision, theta, seed)
    }

    /// Fits the trained numbers to measured segments.
    ///
    /// If the physics also depends on typical values of these numbers, which are the initial ones,
    /// repeats the fit from its result until both agree.
    pub fn identify(&self, segments: &[Segment], options: &Options) -> Result<Fit, IdentifyError> {
        const REPETITIONS: usize = 4;
        let (names, angles) = (self.param_names(), self.angles());
        let of = |physics: &DynTask| {
            identification::identified(physics, &names, &angles, segments, options)
        };
        let mut fit = of(&self.physics.task)?;
        for _ in 0..REPETITIONS {
            let values: Vec<_> =
                fit.names.iter().cloned().zip(fit.values.iter().copied()).collect();
            let Some(physics) = self.settings.typical_physics(&values) else { break };
            let next = match of(&physics) {
                Err(IdentifyError::Diverged { .. }) => break,
                next => next?,
            };
            let is_close = |i: usize| {
                let error = next.errors[i];
                let width =
                    if error.is_finite() { 0.1 * error } else { 1e-3 * next.values[i].abs() };
                (next.values[i] - fit.values[i]).abs() <= width
            };
            let is_settled = (0..next.values.len()).all(is_close);
            fit = Fit {
                iterations: fit.iterations + next.iterations,
                simulations: fit.simulations + next.simulations,
                jacobians: fit.jacobians + next.jacobians,
                ..next
            };
            if is_settled {
                break;
            }
        }
        Ok(fit)
    }

    /// Returns whether the physics depends on the time of the segment, at its measured states.
    pub fn depends_on_time(&self, segment: &Segment) -> bool {
        identification::depends_on_time(&self.physics.task, &self.param_names(), segment)
    }

    /// Optimizes the controls from the initial state `x0` with the parameters `p`.
    pub fn optimize(
        &self,
        x0: &[f64],
        p: &[f64],
        initial: Initial,
        options: &optimize::Options,
    ) -> Result<Plan, OptimizeError> {
        optimize::optimize(&self.physics.task, x0, p, initial, options)
    }

    /// Time step, in the unit of time of the task: s, except for `quantum`.
    pub fn dt(&self) -> f64 {
        self.settings.dt()
    }

    /// Index of the state component that tells the end of an episode, if episodes can end.
    pub fn ended(&self) -> Option<usize> {
        Task::ended(&self.physics.task)
    }

    /// Names of the state components.
    pub fn state_names(&self) -> Vec<String> {
        self.physics.states.clone()
    }

    /// Names of the components that the policy observes: those of the state. A component of another
    /// observation has the name that its expression consists of, or else y_1, y_2, …
    pub fn observation_names(&self) -> Vec<String> {
        self.physics.observed.clone()
    }

    /// Names of the parameters of a rollout.
    pub fn param_names(&self) -> Vec<String> {
        self.settings.param_names(&self.physics.task)
    }

    /// Keys and values of the numbers that are not fixed.
    pub fn varied(&self) -> Vec<(String, Number)> {
        let names = self.param_names();
        let varied = self.physics.task.system().varied(self.physics.task.param_dim());
        varied.into_iter().map(|varied| (names[varied.index].clone(), varied.number)).collect()
    }

    /// Indices of the state components that are angles in rad.
    pub fn angles(&self) -> Vec<usize> {
        self.settings.angles()
    }

    /// Keys and values of the numbers of a model in a file, whether or not the scene sets them.
    pub fn model_numbers(&self) -> Vec<(String, f64)> {
        self.settings.model_numbers()
    }

    /// Names of the parts of a model in a file.
    pub fn model(&self) -> Option<ModelParts> {
        self.settings.model()
    }

    /// Names of the control components.
    pub fn control_names(&self) -> Vec<String> {
        self.settings.control_names()
    }

    /// Names of the applied controls. Empty without an actuator.
    pub fn applied_names(&self) -> Vec<String> {
        self.actuator.applied_names(&self.control_names())
    }

    /// Controls that the actuator applies, for these states and controls of the policy.
    pub fn applied(&self, states: &[Vec<f64>], controls: &[Vec<f64>]) -> Vec<Vec<f64>> {
        self.actuator.applied(self.dt(), &self.unsensed(states), controls)
    }

    /// States without the components that the end of episodes and the sensor add.
    fn unsensed<'a>(&self, states: &'a [Vec<f64>]) -> Cow<'a, [Vec<f64>]> {
        match self.physics.added {
            0 => Cow::Borrowed(states),
            added => states.iter().map(|x| x[..x.len() - added].to_vec()).collect(),
        }
    }

    /// A quantity that is conserved while the control is zero. None also if numbers are drawn or
    /// trained.
    pub fn conserved(&self) -> Option<Conserved> {
        // The quantity has fixed numbers, but the drawn or trained numbers of a sample may differ.
        self.settings.conserved().filter(|_| self.varied().is_empty() && self.physics.added == 0)
    }

    /// Animation of one rollout, from its states, controls and parameters.
    pub fn animation(&self, rollout: &Trajectory) -> Animation {
        let mut animation = self.settings.animation(&self.unsensed_rollout(rollout));
        if animation.time > 0.0 && animation.channels.is_empty() {
            let controls = held(&rollout.controls, animation.time / self.dt());
            animation.channels = Channel::columns(self.control_names(), &controls, CONTROL);
            for channel in &mut animation.channels {
                let [low, high] = channel.range();
                channel.range = Some([low.min(0.0), high.max(0.0)]);
            }
        }
        animation
    }

    /// Animation of the states so far of an unfinished rollout, whose last frame shows the last
    /// state. Channels have the time of a whole rollout, of which the rest is NaN.
    pub fn unfinished(&self, rollout: &Trajectory) -> Animation {
        let bounds = self.control_bounds();
        let rollout = self.unsensed_rollout(rollout);
        let mut animation = self.settings.unfinished(&rollout, bounds.as_deref());
        // A view has no axis of time: one that grows would change its size.
        animation.time = 0.0;
        if !animation.channels.is_empty() {
            animation.time = self.horizon as f64 * self.dt();
        }
        for channel in &mut animation.channels {
            // The last control, which holds until the time of the last state, ends the curve.
            channel.values.resize(self.horizon + 1, f64::NAN);
        }
        animation
    }

    fn unsensed_rollout(&self, Trajectory { states, controls, params }: &Trajectory) -> Trajectory {
        let states = self.unsensed(states).into_owned();
        Trajectory { states, controls: controls.clone(), params: params.clone() }
    }

    /// Refuses settings of the training that its field does not read.
    ///
    /// # Errors
    /// As [`check_fields`](Self::check_fields). Also if `training.truncation` exceeds the steps of an
    /// update, or if an estimator that reads losses only has a field other than C, the default, and R.
    pub fn check_field(&self) -> Result<(), ConfigError> {
        let field = self.field.0.name();
        if self.reads_losses_only() && !["combined", "regular"].contains(&field) {
            return Err(ConfigError::unread("field", field, LOSSES));
        }
        self.check_truncation()?;
        self.check_fields(&[self.field.0])
    }

    /// Refuses a truncation that no update reaches. The number of its steps is the neutral value.
    ///
    /// # Errors
    /// `training.truncation` exceeds the horizon, or the steps of a window.
    pub fn check_truncation(&self) -> Result<(), ConfigError> {
        match self.training.truncation.filter(|&steps| steps > self.steps()) {
            Some(steps) => {
                let key = if self.window.is_some() { "window.steps" } else { "horizon" };
                let because = format!("`{key}` is {}", self.steps());
                Err(ConfigError::unread("training.truncation", steps, &because))
            }
            None => Ok(()),
        }
    }

    /// Whether the estimator of the training reads losses only, without derivatives.
    pub fn reads_losses_only(&self) -> bool {
        self.training.estimator == EstimatorName::ZerothOrder
    }

    /// Refuses settings of the training that none of the fields reads.
    ///
    /// # Errors
    /// The scene has such a setting.
    pub fn check_fields(&self, fields: &[Field]) -> Result<(), ConfigError> {
        let names: Vec<&str> = fields.iter().map(Field::name).collect();
        let [verb, have, omit] =
            if fields.len() == 1 { ["field", "has", "omits"] } else { ["fields", "have", "omit"] };
        let named = format!("{verb} {}", names.join(", "));
        let flows = || fields.iter().flat_map(Field::flows);
        let losses = self.reads_losses_only();
        let has_second = fields.iter().any(|field| field.flows().len() > 1);
        let sees = flows().any(|flow| flow.control != 0.0);
        let has_path = flows().any(|flow| [flow.physics, flow.control, flow.memory] != [0.0; 3]);
        let second = format!("{named} {have} no second gradient");
        let observation = format!("{named} {omit} the path through the observation");
        let paths = format!("{named} {omit} all paths between steps");
        let TrainingSettings { average, control, discount, truncation, cut, .. } = self.training;
        // Value of a setting that is given, whether a field reads it, and why not.
        let settings = [
            ("average", Some(average).filter(|&x| x != 0.0), has_second, &*second),
            ("control", Some(control).filter(|&x| x != 1.0), sees, &*observation),
            (
                "discount",
                Some(discount).filter(|&x| x != 1.0 && self.window.is_none()),
                has_path,
                &*paths,
            ),
            ("truncation", truncation.map(|steps| steps as f64), has_path, &*paths),
            ("cut", cut, has_path, &*paths),
        ];
        for (key, value, is_read, because) in settings {
            if let Some(value) = value.filter(|_| losses || !is_read) {
                let because = if losses { LOSSES } else { because };
                return Err(ConfigError::unread(&format!("training.{key}"), value, because));
            }
        }
        Ok(())
    }

    /// Opens a run before its first epoch.
    ///
    /// # Errors
    /// The run does not fit in the memory of this machine. The initial policy does not fit the
    /// scene.
    pub fn open(&self, workers: usize) -> Result<Box<dyn AnyRun>> {
        let theta = self.initial_theta()?;
        let given = self.initial_policy().map(|_| theta);
        let training = self.training.training(self.epochs, self.seed, workers);
        let windows = self.windows();
        let field = self.training.weighted_in(self.field.0, windows.is_some());
        let (task, policy) = (self.physics.task.clone(), self.policy.clone());
        session::open(task, policy, self.precision, field, training, windows, given)
    }

    /// Parameters of the policy for checks: those of the initial policy, or random ones, which are those
    /// of a network of normalized observations where the training normalizes them.
    ///
    /// # Errors
    /// Those of [`initial_theta`](Self::initial_theta).
    pub fn checked_theta(&self) -> Result<Vec<f64>> {
        let mut theta = self.initial_theta()?;
        if self.initial_policy().is_none() {
            self.coordinates(&theta)(&mut theta);
        }
        Ok(theta)
    }

    /// The map from parameters in the units in which the training works to those of the policy.
    fn coordinates(&self, theta: &[f64]) -> impl Fn(&mut [f64]) + use<> {
        /// Steps of the episodes that give the units.
        const STEPS: usize = 1000;
        let map = self
            .windows()
            .map(|windows| windows.coordinates(&self.policy, theta, self.seed, STEPS));
        move |theta: &mut [f64]| map.iter().for_each(|map| map(theta))
    }

    /// Steps of a window. None if updates see whole rollouts.
    pub fn window_steps(&self) -> Option<usize> {
        self.window.as_ref().map(|window| window.steps)
    }

    /// Steps that an update sees: those of a window, or all.
    pub fn steps(&self) -> usize {
        self.window_steps().unwrap_or(self.horizon)
    }

    /// The windows of the training. None if updates see whole rollouts.
    fn windows(&self) -> Option<Windows> {
        let window = self.window.as_ref()?;
        Some(window.windows(self.physics.task.clone(), self.training.discount))
    }

    /// The task whose gradients an update sees: the first window without noise, or the whole task.
    fn stepped(&self) -> DynTask {
        let windows = self.windows().map(|windows| Windows { noise: Vec::new(), ..windows });
        windows
            .map_or_else(|| self.physics.task.clone(), |windows| windows.checked(None, self.seed))
    }

    /// Checks that a run fits in the memory of this machine.
    ///
    /// # Errors
    /// The run needs more memory.
    pub fn check_memory(&self) -> Result<(), ConfigError> {
        let TrainingSettings { batch, train_samples, test_samples, .. } = self.training;
        let samples =
            self.training.training(self.epochs, self.seed, 1).derived(batch.min(train_samples));
        let starts = train_samples + test_samples;
        let Needs { batch: whole, rest } =
            memory::needs(&self.stepped(), &self.policy, self.precision, samples, starts);
        // With a budget, the reverse pass recomputes the steps that exceed the budget.
        let batch = self.training.budget().map_or(whole, |budget| whole.min(budget as f64));
        let (needed, most) = (batch + rest, of_this_machine());
        if needed <= most {
            return Ok(());
        }
        let what = format!(
            "is {}: a run with mini-batches of {samples} samples needs about {:.1} GB, of which {:.1} GB for a mini-batch, \
             but this machine has {:.1} GB; choose a smaller `training.batch`, `horizon` or policy, or set a budget for the \
             mini-batch, as in `training.memory = \"1GB\"`",
            self.horizon,
            needed * 1e-9,
            batch * 1e-9,
            most * 1e-9
        );
        Err(ConfigError::new("horizon", what))
    }

    /// Equations in the settings: what each gives, and its expression.
    pub fn equations(&self) -> Vec<(String, String)> {
        let policy = self.policy_settings.equations().into_iter();
        let policy = policy.map(|(name, text)| (format!("policy: {name}"), text));
        self.settings.equations().into_iter().chain(policy).collect()
    }

    /// Number of operations of these equations. None without equations.
    pub fn operations(&self) -> Option<Operations> {
        self.settings.operations()
    }

    /// Notes about settings of the task and the policy that are hardly meant.
    pub fn remarks(&self) -> Vec<String> {
        let remarks = self.settings.remarks().into_iter().chain(self.policy_settings.remarks());
        remarks.chain(self.large_noise()).map(|remark| format!("note: {remark}")).collect()
    }

    /// Controls whose noise in windows exceeds half of their range.
    fn large_noise(&self) -> Vec<String> {
        let bounds = Policy::control_bounds(&self.policy);
        let Some((windows, bounds)) = self.windows().zip(bounds) else { return Vec::new() };
        let names = self.control_names();
        let large = |((name, noise), [low, high]): ((&String, &f64), [f64; 2])| {
            let width = high - low;
            (2.0 * noise > width).then(|| {
                format!(
                    "`window.noise` of {name} is {noise}, more than half of its range of {width}, so most of its values in the \
                     training are bounds"
                )
            })
        };
        names.iter().zip(&windows.noise).zip(bounds).filter_map(large).collect()
    }

    /// Keys of names that no expression of the task or the policy uses.
    pub fn unused(&self) -> Vec<String> {
        let of_system = self.settings.unused().into_iter().map(|key| format!("system.{key}"));
        let of_policy = self.policy_settings.unused().into_iter();
        of_system.chain(of_policy.map(|key| format!("policy.{key}"))).collect()
    }

    /// The remarks, and notes about settings of the training that another setting limits: a
    /// mini-batch that is larger than the training set, a warm-up that does not end.
    pub fn notes(&self) -> Vec<String> {
        let TrainingSettings { batch, train_samples: samples, warm_up, .. } = self.training;
        let large_batch = (batch > samples).then(|| {
            format!(
                "note: `training.batch` is {batch}, but `training.train_samples` is {samples}: each epoch has one update, with \
                 all samples"
            )
        });
        let windows = self.horizon / self.steps();
        let updates = samples.div_ceil(batch).saturating_mul(windows).saturating_mul(self.epochs);
        let endless = (warm_up >= updates && updates > 0).then(|| {
            format!(
                "note: `training.warm_up` is {warm_up} updates, but the run has {updates}: the learning rate never \
                 reaches `training.learning_rate`"
            )
        });
        let of_training: Vec<String> = if self.policy.param_count() == 0 {
            vec![format!(
                "note: the policy has no trained numbers: {}",
                if self.epochs == 0 {
                    "there is nothing to train, and `epochs = 1` evaluates its losses"
                } else {
                    "one epoch evaluates its losses"
                }
            )]
        } else {
            large_batch.into_iter().chain(endless).chain(self.left_out()).collect()
        };
        self.remarks().into_iter().chain(of_training).collect()
    }

    /// A note about steps at the end of the horizon that no window without a value function sees.
    fn left_out(&self) -> Option<String> {
        let window = self.window.as_ref().filter(|window| !window.restarts())?;
        let steps = self.horizon % window.steps;
        (steps > 0).then(|| {
            format!(
                "note: `window.steps` is {}, which does not divide the horizon of {}: no window sees the last {steps} steps and \
                 the terminal cost there",
                window.steps, self.horizon
            )
        })
    }

    /// Identity of a run: the settings that a resumed run must share, one per line.
    ///
    /// Lists the differences from the task's defaults. Excludes settings that do not change
    /// results, and the number of epochs unless the learning rate decays over them. A setting added
    /// by a later version, with a default that preserves the behaviour, does not change the
    /// identity.
    pub fn identity(&self) -> String {
        let is_constant = self.training.decay == DecayName::Constant;
        self.differences(if is_constant {
            &["epochs", "training.memory"]
        } else {
            &["training.memory"]
        })
    }

    /// Settings shared by the runs of a comparison: [`identity`](Self::identity) without field,
    /// seed and epochs.
    pub fn comparable(&self) -> String {
        self.differences(&["epochs", "training.memory", "field", "seed"])
    }

    /// One line for the task, one per effect or part of the actuator, and one per setting that
    /// differs from its default. The last line identifies the initial policy, if any. Skips the
    /// keys in `but`, and the keys `tags` and `log`.
    fn differences(&self, but: &[&str]) -> String {
        let mut lines = vec![format!("task = {:?}", self.task.name())];
        let table = self.table();
        // Default settings with the same effects and parts of the actuator, each with its default
        // parameters.
        let mut defaults = self.task.defaults(&table);
        for section in OPTIONAL {
            let mut bare = Table::new();
            let parts = table.get(section).and_then(Value::as_table);
            for part in parts.into_iter().flat_map(Table::keys) {
                lines.push(format!("{section}.{part}"));
                bare.insert(part.clone(), Value::Table(Table::new()));
            }
            defaults.insert(section.into(), bare.into());
        }
        let mut defaults = flat(&self.task.fill(defaults.clone()).unwrap_or(defaults));
        defaults.retain(|(key, _)| !is_kind(key));
        let differences = flat(&table)
            .into_iter()
            .filter(|setting| !defaults.contains(setting) && !but.contains(&&*setting.0));
        let differences =
            differences.filter(|(key, _)| ![INITIAL_POLICY, "tags", "log"].contains(&&**key));
        lines.extend(differences.map(|(key, value)| format!("{key} = {value}")));
        // Identifies the policy file by its contents, not by its path.
        lines.extend(
            self.initial_policy_checksum()
                .map(|checksum| format!("{INITIAL_POLICY} = CRC-32C {checksum:08x}")),
        );
        lines.join("\n")
    }
}

/// Removes the sensor and the end of episodes, with its cost, from the table of a scene. Returns
/// whether it had one.
pub fn make_bare(table: &mut Table) -> bool {
    let mut found = table.remove("sensor").is_some();
    for name in ["loss", "equations"] {
        let Some(section) = table.get_mut(name).and_then(toml::Value::as_table_mut) else {
            continue;
        };
        if section.remove("end").is_some() {
            // It may name the end.
            section.remove("terminal");
            found = true;
        }
        // Definitions alone have no effect.
        if section.keys().all(|key| key == "define") && name == "equations" {
            table.remove(name);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tasks;

    fn task() -> &'static dyn AnyTaskSpec {
        tasks::all()[0]
    }

    fn scene(settings: &str, epochs: i64) -> Scene {
        let mut table = task().defaults(&Table::new());
        table.insert("epochs".into(), Value::Integer(epochs));
        table.extend(settings.parse::<Table>().expect("TOML"));
        task().scene(table).expect("settings")
    }

    #[test]
    fn an_identity_lists_the_differences_from_the_defaults() {
        let bare = "task = \"cart_pole\"";
        assert_eq!(scene("", 7).identity(), bare);
        assert_eq!(scene("seed = 4", 1).identity(), format!("{bare}\nseed = 4"));
        assert_eq!(scene("seed = 4", 1).comparable(), bare);
        // Lists an effect even if all its parameters have their defaults.
        let windy = format!("{bare}\neffects.steady_wind");
        assert_eq!(scene("effects.steady_wind = {}", 1).identity(), windy);
        let fast = scene("effects.steady_wind.speed = 5", 1);
        assert_eq!(fast.identity(), format!("{windy}\neffects.steady_wind.speed = 5.0"));
        let other = scene("seed = 4\neffects.steady_wind.speed = 5", 1);
        assert_eq!(other.comparable(), fast.identity());
    }

    #[test]
    fn a_copy_with_another_field_and_seed_has_them_in_its_table() {
        let field: Field = "stopped".parse().expect("a field");
        let copy = scene("", 1).with(FieldName(field), 9);
        let again = task().scene(copy.table()).expect("settings");
        assert_eq!((again.field.0, again.seed), (field, 9));
        assert_eq!(copy.identity(), again.identity());
    }

    #[test]
    fn absent_sections_are_omitted_and_a_schema_has_no_null() {
        assert!(!scene("", 1).table().contains_key("effects"));
        let damped = scene("effects.pole_damping = {}", 1).table();
        let default = damped["effects"]["pole_damping"]["damping"].as_float();
        assert!(default.is_some_and(|damping| damping > 0.0), "{damped}");
        let schema = task().schema();
        let effect = &schema["properties"]["effects"]["properties"]["pole_damping"];
        assert_eq!(
            (&effect["type"], &effect["description"]),
            (&"object".into(), &"Viscous friction in the joints of the poles.".into())
        );
        assert_eq!(effect["properties"]["damping"]["default"].as_f64(), default);
        assert!(!schema.to_string().contains("null"), "{schema}");
    }
}

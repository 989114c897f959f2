//! [`Policy`]: the policy of a scene with its parameters.

use super::{Scene, TooLarge, fits, threads};
use crate::operations::policy_file::{self, About};
use crate::tasks::ScenePolicy;
use anyhow::{Context, Result, anyhow, bail};
use physgrad::engine::any::AnyTask;
use physgrad::policy::AnyPolicy;
use physgrad::train::{Trajectories, calls};
use physgrad::{DynTask, Field, Float, Flow, Rollout, Weights};
use std::sync::atomic::{AtomicBool, Ordering};

/// Largest number of samples in one rollout.
const BLOCK: usize = 32;

/// The policy of a scene with its parameters θ. If the scene trains numbers, the last parameters
/// determine them; see [`TrainedParam`](physgrad::policy::TrainedParam).
#[derive(Clone)]
pub struct Policy {
    scene: Scene,
    policy: ScenePolicy,
    theta: Vec<f64>,
}

impl Policy {
    /// Policy with random parameters. A training with this seed starts from them, unless the scene
    /// has an initial policy.
    pub fn new(scene: &Scene, seed: u64) -> Self {
        let policy = scene.scene.policy().clone();
        let theta = policy_file::random(&policy, seed);
        Self { scene: scene.clone(), policy, theta }
    }

    /// Policy with the parameters of a policy file.
    ///
    /// # Errors
    /// The bytes are not a policy file, or are one of another policy or task. A parameter is not
    /// finite.
    /// The file and the scene train different numbers, or the bounds of these numbers differ.
    pub fn read(scene: &Scene, bytes: &[u8]) -> Result<Self> {
        let policy = scene.scene.policy().clone();
        let theta = policy_file::read(bytes, &scene.scene.about(), &policy, 0)?;
        let mut read = Self { scene: scene.clone(), policy, theta: Vec::new() };
        read.check_finite(&theta)?;
        read.theta = theta;
        Ok(read)
    }

    /// Scene of the policy.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Kind of the policy, with the parts that it has.
    pub fn kind(&self) -> String {
        self.scene.scene.policy_kind()
    }

    /// The parameters.
    pub fn theta(&self) -> &[f64] {
        &self.theta
    }

    /// Names and values of the trained numbers: those of the system, then those of the policy.
    pub fn numbers(&self) -> Vec<(String, f64)> {
        let numbers = self.scene.scene.trained_numbers();
        numbers.into_iter().map(|n| (n.name, n.map.value(self.theta[n.index]))).collect()
    }

    /// Largest size of a file of this policy, bytes: its numbers in f64, those of trained numbers in
    /// another scene, and descriptions.
    pub fn most_bytes(&self) -> usize {
        const DESCRIPTIONS: usize = 1 << 20;
        8 * self.theta.len() + DESCRIPTIONS
    }

    /// Checks that a scene has the task, the observations and the controls of the policy, as for a
    /// policy file.
    ///
    /// # Errors
    /// One of them differs.
    pub(super) fn check_meaning(&self, task: &Scene) -> Result<()> {
        let About { task: name, observations, controls, .. } = self.scene.scene.about();
        policy_file::check_names(
            Some(name),
            Some(observations),
            Some(controls),
            &task.scene.about(),
        )
        .context("the policy does not fit the task")
    }

    /// Replaces the parameters.
    ///
    /// # Errors
    /// The number of parameters differs, or one is not finite in the precision of the scene.
    pub fn set_theta(&mut self, theta: Vec<f64>) -> Result<()> {
        if theta.len() != self.theta.len() {
            bail!(
                "`theta` has {} numbers, but the policy has {} parameters",
                theta.len(),
                self.theta.len()
            );
        }
        self.check_finite(&theta)?;
        self.theta = theta;
        Ok(())
    }

    fn check_finite(&self, theta: &[f64]) -> Result<()> {
        let is_finite = |&value: &f64| {
            if self.scene.is_f64() { value.is_finite() } else { (value as f32).is_finite() }
        };
        if let Some(i) = theta.iter().position(|value| !is_finite(value)) {
            let precision = if self.scene.is_f64() { "f64" } else { "f32" };
            bail!("`theta[{i}]` is {:?}; allowed: finite numbers in {precision}", theta[i]);
        }
        Ok(())
    }

    /// The policy file, in the precision of the scene.
    ///
    /// # Errors
    /// The description of the policy cannot be serialized.
    pub fn safetensors(&self) -> Result<Vec<u8>> {
        let about = self.scene.scene.about();
        if self.scene.is_f64() {
            return policy_file::write(&about, &self.policy, &self.theta);
        }
        policy_file::write(&about, &self.policy, &self.rounded::<f32>())
    }

    /// The parameters in the precision `F`.
    pub(super) fn rounded<F: Float>(&self) -> Vec<F> {
        self.theta.iter().map(|&theta| F::from_f64(theta)).collect()
    }

    /// Controls for the observations `y`, of a policy without a memory. Controls and observations
    /// have the layout `[row][component]`.
    ///
    /// # Errors
    /// The policy has a memory, or `y` is not a whole number of rows.
    pub fn act<F: Float>(&self, y: &[F]) -> Result<Vec<F>> {
        let policy = &self.policy as &dyn AnyPolicy<F>;
        let (width, rows) = (policy.observation_dim(), y.len() / policy.observation_dim());
        if policy.memory_dim() > 0 {
            bail!("the policy has a memory; use rollouts");
        }
        if y.len() != rows * width {
            bail!("`y` has {} numbers; expected rows of {width}", y.len());
        }
        let weights = Weights::new(policy, self.rounded());
        Ok(physgrad::policy::controls(policy, &weights, y))
    }

    /// Returns the task of a scene, and the policy in it, after a check that the policy fits it.
    pub(super) fn check(&self, task: &Scene) -> Result<(DynTask, ScenePolicy)> {
        let (policy, dyn_task) = (&self.policy as &dyn AnyPolicy<f64>, task.task());
        let any: &dyn AnyTask<f64> = &dyn_task;
        let [found, expected] = [
            [policy.observation_dim(), policy.control_dim()],
            [any.observed_dim(), any.control_dim()],
        ];
        if found != expected {
            bail!(
                "the policy has {} observations and {} controls, but {} has {} and {}; create a policy for this task",
                found[0],
                found[1],
                task.name(),
                expected[0],
                expected[1]
            );
        }
        if let Some(param) =
            policy.trained_params().iter().find(|param| param.index() >= any.param_dim())
        {
            bail!(
                "the policy trains parameter {}, but {} has {} parameters",
                param.index(),
                task.name(),
                any.param_dim()
            );
        }
        let (own, names) = (self.scene.param_names(), task.param_names());
        if let Some(param) =
            policy.trained_params().iter().find(|param| own[param.index()] != names[param.index()])
        {
            let (own, name) = (&own[param.index()], &names[param.index()]);
            bail!(
                "the policy trains {own}, but this parameter of {} is {name}; create a policy for this task",
                task.name()
            );
        }
        self.check_meaning(task)?;
        let (own, other) = (&self.scene.scene, &task.scene);
        if own.controlled() == other.controlled() {
            return Ok((dyn_task, self.policy.clone()));
        }
        // Time steps, bounds and horizons of the tasks differ.
        let fits = "the policy does not fit the task";
        policy_file::check_settings(&own.meaning_of(own), &other.meaning_of(own)).context(fits)?;
        let policy = other.policy_of(own).context(fits)?;
        let [found, expected] = [self.theta.len(), AnyPolicy::<f64>::param_count(&policy)];
        if found != expected {
            bail!(
                "the policy has {found} parameters, but needs {expected} for this task; create a policy for this task"
            );
        }
        Ok((dyn_task, policy))
    }

    /// The policy in the task of a scene, without its parameters.
    ///
    /// # Errors
    /// The policy does not fit the task.
    pub fn closed(&self, task: &Scene) -> Result<ClosedLoop> {
        let (task, policy) = self.check(task)?;
        Ok(ClosedLoop { task, policy })
    }

    /// Rollouts from `starts`, see [`Scene::append_starts`]. Reads `stop` before each block of
    /// samples.
    ///
    /// # Errors
    /// The policy does not fit the task, a [`Divergence`](physgrad::Divergence), or [`TooLarge`](super::TooLarge). `stop`
    /// is true.
    ///
    /// # Panics
    /// If `starts` is not a whole number of initial states.
    pub fn rollouts<F: Float>(
        &self,
        task: &Scene,
        starts: &[F],
        stop: &AtomicBool,
    ) -> Result<Trajectories<F>> {
        let (dyn_task, policy) = self.check(task)?;
        let policy: &dyn AnyPolicy<F> = &policy;
        let any: &dyn AnyTask<F> = &dyn_task;
        let (horizon, count) = (any.horizon(), starts.len() / any.start_dim());
        fits(
            "the rollouts",
            &[count, horizon + 1, any.state_dim() + any.control_dim()],
            size_of::<F>(),
        )?;
        fits_blocks(any, policy, count)?;
        let weights = Weights::new(policy, self.rounded());
        calls::rollout_until(any, policy, &weights, starts, &|| is_set(stop))?
            .ok_or_else(interrupted)
    }

    /// Losses of rollouts from `starts`, one per sample. Reads `stop` before each block of samples.
    ///
    /// # Errors
    /// The policy does not fit the task, or a [`Divergence`](physgrad::Divergence). `stop` is true.
    ///
    /// # Panics
    /// If `starts` is not a whole number of initial states.
    pub fn losses<F: Float>(
        &self,
        task: &Scene,
        starts: &[F],
        stop: &AtomicBool,
    ) -> Result<Vec<F>> {
        let (dyn_task, policy) = self.check(task)?;
        let policy: &dyn AnyPolicy<F> = &policy;
        let weights = Weights::new(policy, self.rounded());
        calls::losses_until(&dyn_task, policy, &weights, starts, &|| is_set(stop))?
            .ok_or_else(interrupted)
    }

    /// Vectors of several fields, `[field][parameter]`, for the mean loss of rollouts from
    /// `starts`. All fields share the forward passes. Reads `stop` before each block of samples.
    ///
    /// # Errors
    /// The policy does not fit the task, `starts` is empty, a [`Divergence`](physgrad::Divergence), or
    /// [`TooLarge`](super::TooLarge). `stop` is true.
    ///
    /// # Panics
    /// If `starts` is not a whole number of initial states.
    pub fn gradients<F: Float>(
        &self,
        task: &Scene,
        starts: &[F],
        chosen: &[Field],
        stop: &AtomicBool,
    ) -> Result<Vec<Vec<F>>> {
        let (dyn_task, policy) = self.check(task)?;
        let policy: &dyn AnyPolicy<F> = &policy;
        let any: &dyn AnyTask<F> = &dyn_task;
        if starts.is_empty() {
            bail!("`starts` has no rows; pass at least one initial state");
        }
        fits_blocks(any, policy, starts.len() / any.start_dim())?;
        let weights = Weights::new(policy, self.rounded());
        calls::gradients_until(any, policy, &weights, starts, chosen, &|| is_set(stop))?
            .ok_or_else(interrupted)
    }
}

/// A task and a policy that acts in it, without its parameters. See [`Policy::closed`].
pub struct ClosedLoop {
    task: DynTask,
    policy: ScenePolicy,
}

impl ClosedLoop {
    /// Number of parameters θ.
    pub fn param_count(&self) -> usize {
        AnyPolicy::<f64>::param_count(&self.policy)
    }

    /// Rollouts with the parameters θ from `starts`.
    ///
    /// # Errors
    /// A [`Divergence`](physgrad::Divergence).
    ///
    /// # Panics
    /// If `theta` has another number of parameters, or `starts` is not a whole number of initial
    /// states.
    pub fn rollout<F: Float>(&self, theta: Vec<F>, starts: &[F]) -> Result<Trajectories<F>> {
        let weights = Weights::new(&self.policy as &dyn AnyPolicy<F>, theta);
        Ok(calls::rollout(&self.task, &self.policy, &weights, starts)?)
    }

    /// The cotangents of θ and `starts`, for those of the states and controls. See
    /// [`calls::rollout_vjp`].
    ///
    /// # Errors
    /// A [`Divergence`](physgrad::Divergence).
    ///
    /// # Panics
    /// As [`rollout`](Self::rollout), or if `bars` are not those of its rollouts.
    pub fn rollout_vjp<F: Float>(
        &self,
        theta: Vec<F>,
        starts: &[F],
        bars: &Trajectories<F>,
        flow: Flow,
    ) -> Result<(Vec<F>, Vec<F>)> {
        let weights = Weights::new(&self.policy as &dyn AnyPolicy<F>, theta);
        Ok(calls::rollout_vjp(&self.task, &self.policy, &weights, starts, bars, flow)?)
    }
}

/// Checks that the blocks of rollouts of all threads fit into memory.
fn fits_blocks<F: Float>(
    task: &dyn AnyTask<F>,
    policy: &dyn AnyPolicy<F>,
    count: usize,
) -> Result<(), TooLarge> {
    let bytes = Rollout::bytes_of(task, policy, count.clamp(1, BLOCK), task.horizon());
    let blocks = threads::number().min(count.div_ceil(BLOCK));
    fits("the blocks of rollouts of all threads", &[blocks, bytes], 1)
}

fn is_set(stop: &AtomicBool) -> bool {
    stop.load(Ordering::Relaxed)
}

/// The caller has stopped a call.
fn interrupted() -> anyhow::Error {
    anyhow!("stopped")
}

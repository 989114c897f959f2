//! Errors and costs of all settings of a scene: the computation of `physgrad accuracy`.

use crate::commands::accuracy::row::{Errors, Row, Setting};
use crate::operations::simulation::{Job, Simulated};
use crate::scenes::source::SceneSource;
use crate::settings::Precision;
use crate::tasks::Scene;
use anyhow::{Context, Result};
use toml::Value;

/// Numbers of physics steps per control step.
const SUBSTEPS: [usize; 5] = [1, 2, 4, 8, 16];
/// Number of timing rounds by default.
pub const ROUNDS: usize = 5;
/// Minimum time per round, setting and pass, s.
const MIN_TIME: f64 = 0.003;

/// Error measure of a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Metric {
    /// Error of the states
    Trajectory,
    /// Error of the loss
    Loss,
    /// Error of the gradient of R
    R,
    /// Error of the gradient of M
    M,
}

impl Metric {
    /// Relative error in this measure.
    pub fn read(self, errors: &Errors) -> f64 {
        match self {
            Self::Trajectory => errors.trajectory,
            Self::Loss => errors.loss,
            Self::R => errors.gradients[0],
            Self::M => errors.gradients[1],
        }
    }

    /// Median seconds per step and sample of the passes that this measure needs: forward, or
    /// forward with the adjoints of R and M.
    pub fn time(self, row: &Row) -> f64 {
        self.times(row)[1]
    }

    /// Lowest, median and highest seconds of [`time`](Self::time).
    fn times(self, row: &Row) -> [f64; 3] {
        row.seconds[usize::from(matches!(self, Self::R | Self::M))]
    }

    /// Name in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Trajectory => "trajectory",
            Self::Loss => "loss",
            Self::R => "gradient of R",
            Self::M => "gradient of M",
        }
    }
}

/// Errors and costs of all settings.
pub struct Measured {
    /// One row per method, number of substeps and precision.
    pub rows: Vec<Row>,
    /// Number of timing rounds.
    pub rounds: usize,
    /// Difference of the reference from a solution with half as many steps: an estimate of the
    /// errors of the reference.
    pub reference: Errors,
}

impl Measured {
    /// Cheapest setting with at most this error. None also if the reference does not resolve it.
    pub fn cheapest(&self, metric: Metric, target: f64) -> Option<Cheapest<'_>> {
        cheapest(self.rows.iter(), metric, target).filter(|_| self.resolves(metric, target))
    }

    /// Returns whether the estimated error of the reference is at most `target`. Errors relative to
    /// the reference have no meaning below.
    pub fn resolves(&self, metric: Metric, target: f64) -> bool {
        metric.read(&self.reference) <= target
    }
}

/// Cheapest setting that reaches a target.
#[derive(Clone, Copy)]
pub struct Cheapest<'a> {
    /// The setting.
    pub row: &'a Row,
    /// Its error.
    pub error: f64,
    /// Setting with the lowest median time, if the ranges of both times overlap and `row` has fewer
    /// operations. Operations, not times, then decided.
    pub fastest: Option<&'a Row>,
}

/// Cheapest of the rows with at most this error: the one with the fewest operations among those whose
/// range of times overlaps that of the lowest median. Among equal counts, the lowest median decides.
pub fn cheapest<'a>(
    rows: impl Iterator<Item = &'a Row>,
    metric: Metric,
    target: f64,
) -> Option<Cheapest<'a>> {
    let error = |row: &Row| {
        row.errors.as_ref().ok().map(|errors| metric.read(errors)).filter(|error| *error <= target)
    };
    let reached: Vec<(&Row, f64)> = rows.filter_map(|row| Some((row, error(row)?))).collect();
    let &(fastest, _) =
        reached.iter().min_by(|a, b| metric.time(a.0).total_cmp(&metric.time(b.0)))?;
    let as_fast =
        reached.iter().filter(|(row, _)| metric.times(row)[0] <= metric.times(fastest)[2]);
    let cost = |row: &Row| (row.operations, metric.time(row));
    let &(row, error) = as_fast.min_by(|a, b| {
        let ((few, fast), (many, slow)) = (cost(a.0), cost(b.0));
        few.cmp(&many).then(fast.total_cmp(&slow))
    })?;
    Some(Cheapest { row, error, fastest: (row.operations < fastest.operations).then_some(fastest) })
}

/// A scene, and the sources from which to vary its integrator, number of substeps and precision.
pub struct Study {
    /// Source of the scene with the user's overrides only.
    pub given: SceneSource,
    /// Validated scene of `given`.
    pub scene: Scene,
    /// Source of the scene with the user's overrides and a nonzero initial output layer.
    pub source: SceneSource,
}

impl Study {
    pub fn new(given: SceneSource) -> Result<Self> {
        let (scene, mut source) = (given.scene()?, given.clone());
        if scene
            .table()
            .get("policy")
            .is_some_and(|policy| policy.get("zero_init_output").is_some())
        {
            source.put("policy.zero_init_output", Value::Boolean(false), "accuracy")?;
        }
        Ok(Self { given, scene, source })
    }

    /// All settings: methods, numbers of substeps and precisions.
    ///
    /// # Errors
    /// The task does not support other time steps.
    pub fn settings(&self) -> Result<Vec<Setting>> {
        let refined = Setting { method: "native", substeps: 2, precision: Precision::F64 };
        let context =
            "accuracy varies the time step, which this task does not support; choose another task";
        refined.of(&self.source).context(context)?;
        // Omits methods that the scene does not support, for example `strang` on large grids.
        let is_valid = |&method: &&'static str| {
            Setting { method, substeps: 1, precision: Precision::F64 }.of(&self.source).is_ok()
        };
        let others = self.scene.task.methods().iter().map(|method| method.name()).filter(is_valid);
        let methods = ["native"].into_iter().chain(others);
        let each = methods.flat_map(|method| {
            // Tries one number of substeps for the adaptive method, which selects its step sizes.
            let counts = if method == "adaptive" { &SUBSTEPS[..1] } else { &SUBSTEPS };
            counts.iter().map(move |&substeps| (method, substeps))
        });
        let settings = each.flat_map(|(method, substeps)| {
            [Precision::F32, Precision::F64].map(|precision| Setting {
                method,
                substeps,
                precision,
            })
        });
        Ok(settings.collect())
    }

    /// Number of calls of `begin` by [`measure`](Self::measure).
    pub fn parts(settings: &[Setting], rounds: usize) -> usize {
        2 + settings.len() * (1 + rounds)
    }

    /// Simulates all settings, and times each `rounds` times. Calls `begin` with a description before
    /// each part.
    ///
    /// # Errors
    /// The reference diverges, or `begin` returns an error.
    pub fn measure(
        &self,
        settings: Vec<Setting>,
        rounds: usize,
        begin: &mut dyn FnMut(String) -> Result<()>,
    ) -> Result<Measured> {
        let (reference, check) = self.reference(begin)?;
        let conserved = self.scene.conserved();
        let mut rows = Vec::new();
        for setting in settings {
            begin(setting.name())?;
            let job = self.job(&setting)?;
            rows.push(Row::new(setting, &job, &reference, conserved.as_ref()));
        }
        // Interleaves the settings: other load on the machine then affects all settings. Each round
        // prepares its rollouts anew, so that only one rollout at a time is in memory.
        let mut times = vec![Vec::new(); rows.len()];
        for round in 1..=rounds {
            for (row, times) in rows.iter().zip(&mut times) {
                begin(format!("round {round} of {rounds}"))?;
                if row.errors.is_ok() {
                    times.push(self.job(&row.setting)?.time(MIN_TIME));
                }
            }
        }
        rows.iter_mut().zip(&times).for_each(|(row, times)| row.set_times(times));
        Ok(Measured { rows, rounds, reference: check })
    }

    fn job(&self, setting: &Setting) -> Result<Job> {
        let scene = setting.of(&self.source)?;
        Ok(scene.prepare(&scene.initial_theta()?))
    }

    /// Reference solution, and its difference from the solution with half as many steps.
    fn reference(
        &self,
        begin: &mut dyn FnMut(String) -> Result<()>,
    ) -> Result<(Simulated, Errors)> {
        let (method, substeps) = self.scene.task.reference();
        let mut run = |substeps| {
            let setting = Setting { method, substeps, precision: Precision::F64 };
            begin(format!("reference, {}", setting.name()))?;
            let found = self.job(&setting)?.found;
            found.map_err(anyhow::Error::msg).with_context(|| {
                format!(
                    "the reference solution ({}) diverged; choose a scene with a finite trajectory, for example with a \
                     shorter `horizon`",
                    setting.name()
                )
            })
        };
        let (coarse, fine) = (run(substeps / 2)?, run(substeps)?);
        let check = Errors::of(&coarse, &fine);
        Ok((fine, check))
    }

    /// Scene with the cheapest setting that reaches the target, for every method with such a
    /// setting.
    pub fn scenes(
        &self,
        rows: &[Row],
        metric: Metric,
        target: f64,
    ) -> Result<Vec<(&'static str, Scene)>> {
        let mut methods: Vec<&str> = rows.iter().map(|row| row.setting.method).collect();
        methods.dedup();
        let cheapest = |method: &str| {
            cheapest(rows.iter().filter(|row| row.setting.method == method), metric, target)
        };
        let all = methods.into_iter().filter_map(cheapest);
        all.map(|Cheapest { row, .. }| Ok((row.setting.method, row.setting.of(&self.given)?)))
            .collect()
    }
}

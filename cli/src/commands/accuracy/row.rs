//! One row of the results of `physgrad accuracy`.

use crate::commands::accuracy::derivatives::compare;
use crate::operations::simulation::{Job, Simulated};
use crate::scenes::source::SceneSource;
use crate::settings::Precision;
use crate::tasks::{Conserved, Scene};
use anyhow::Result;
use toml::Value;

/// Integrator, number of substeps, and precision.
#[derive(Clone, Debug, PartialEq)]
pub struct Setting {
    /// Name as in a scene; `native` for the task's native scheme.
    pub method: &'static str,
    /// Number of physics steps per control step.
    pub substeps: usize,
    /// Floating-point precision.
    pub precision: Precision,
}

impl Setting {
    /// Name in tables.
    pub fn name(&self) -> String {
        format!("{} x{} {}", self.method, self.substeps, self.precision.name())
    }

    /// Creates the scene of `source` with this setting.
    pub(crate) fn of(&self, source: &SceneSource) -> Result<Scene> {
        self.source(source)?.scene()
    }

    /// Copy of `source` with this setting.
    pub(crate) fn source(&self, source: &SceneSource) -> Result<SceneSource> {
        let mut source = source.clone();
        source.without_section("integrator");
        source.put("precision", Value::String(self.precision.name().into()), "accuracy")?;
        source.put("integrator.substeps", Value::Integer(self.substeps as i64), "accuracy")?;
        if self.method != "native" {
            source.put("integrator.method", Value::String(self.method.into()), "accuracy")?;
        }
        Ok(source)
    }

    /// Lines of a scene file that select this setting.
    pub fn lines(&self) -> String {
        let mut lines = format!("precision = \"{}\"\n\n[integrator]\n", self.precision.name());
        if self.method != "native" {
            lines += &format!("method = \"{}\"\n", self.method);
        }
        lines + &format!("substeps = {}", self.substeps)
    }
}

/// Lowest value, median and highest value. For an even number of values, the median is the larger
/// one of the two middle values. NaN for an empty list.
pub fn spread(mut times: Vec<f64>) -> [f64; 3] {
    times.sort_by(f64::total_cmp);
    match times[..] {
        [] => [f64::NAN; 3],
        _ => [times[0], times[times.len() / 2], times[times.len() - 1]],
    }
}

/// Errors relative to the reference.
#[derive(Clone, Copy, Debug)]
pub struct Errors {
    /// Largest absolute error over all samples, steps and components, divided by the largest
    /// absolute state component of the reference.
    pub trajectory: f64,
    /// Relative error of the mean loss.
    pub loss: f64,
    /// Relative errors of the gradients R and M, in the Euclidean norm.
    pub gradients: [f64; 2],
    /// Shares of the components of R and M that have the correct sign.
    pub signs: [f64; 2],
}

/// Errors and costs of one setting.
pub struct Row {
    /// Integrator, number of substeps, and precision.
    pub setting: Setting,
    /// Errors, or the message of a divergence.
    pub errors: Result<Errors, String>,
    /// Relative drift of the conserved quantity with zero control. NaN without such a quantity, or
    /// if the rollout with zero control diverges.
    pub drift: f64,
    /// Operations of one step of the system and of its VJP, per sample.
    pub operations: u64,
    /// Bytes of the rollout and of the adjoints of R and M, per step and sample.
    pub bytes: f64,
    /// Seconds per sample and step, `[forward, with adjoints of R and M][lowest, median, highest]`.
    /// NaN for a divergence.
    pub seconds: [[f64; 3]; 2],
}

impl Row {
    pub(super) fn new(
        setting: Setting,
        job: &Job,
        reference: &Simulated,
        conserved: Option<&Conserved>,
    ) -> Self {
        let errors =
            job.found.as_ref().map(|found| Errors::of(found, reference)).map_err(Clone::clone);
        let drift = conserved.map_or(f64::NAN, |conserved| conserved.drift(&job.idle));
        Self {
            setting,
            errors,
            drift,
            operations: job.operations,
            bytes: job.bytes,
            seconds: [[f64::NAN; 3]; 2],
        }
    }

    /// Sets the times from those of all rounds, `[forward, with adjoints of R and M]`.
    pub(super) fn set_times(&mut self, rounds: &[[f64; 2]]) {
        self.seconds = [0, 1].map(|pass| spread(rounds.iter().map(|round| round[pass]).collect()));
    }
}

impl Errors {
    pub(super) fn of(found: &Simulated, reference: &Simulated) -> Self {
        let largest = |x: &[f64]| x.iter().fold(0.0_f64, |largest, x| largest.max(x.abs()));
        let differences =
            |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<f64>>();
        let [r, m] = [0, 1].map(|k| compare(&found.gradients[k], &reference.gradients[k]));
        Self {
            trajectory: largest(&differences(&found.states, &reference.states))
                / largest(&reference.states),
            loss: ((found.loss - reference.loss) / reference.loss).abs(),
            gradients: [r.0, m.0],
            signs: [r.1, m.1],
        }
    }
}

//! Identification of the trained numbers of a scene.

use crate::identify::{Fit, IdentifyError, Options, Segment, Unknown, identify};
use crate::{DynTask, Number, System, Task, Varied};

/// Fits the trained numbers of a task to measured segments. `names` are the names of the parameters
/// of a rollout, in the order of the parameters of the segments. Numbers without a value in a
/// segment have their nominal values. Ignores the values of trained numbers in a segment.
pub fn identified(task: &DynTask, names: &[String], segments: &[Segment], options: &Options) -> Result<Fit, IdentifyError> {
    let system = task.system();
    let params = system.param_dim();
    let varied = system.varied(params);
    // Numbers that vary are the last parameters. A task may have more parameters than its system,
    // so these numbers may have other indices in the task than in the system.
    let named = varied.iter().zip(system.varied(task.param_dim()));
    let unknown = |(&Varied { index, number, .. }, named): (&Varied, Varied)| match number {
        Number::Trained { start, min, max } => Some(Unknown { name: names[named.index].clone(), index, start, min, max }),
        _ => None,
    };
    let unknowns: Vec<Unknown> = named.filter_map(unknown).collect();
    let with_params = |(i, segment): (usize, &Segment)| {
        let known = |index: usize| segment.p.get(index).copied().filter(|value| !value.is_nan());
        let mut p: Vec<Option<f64>> = (0..params).map(known).collect();
        for (varied, named) in varied.iter().zip(system.varied(task.param_dim())) {
            let known = known(named.index).filter(|_| !matches!(varied.number, Number::Trained { .. }));
            p[varied.index] = Some(known.unwrap_or(varied.number.nominal()));
        }
        let missing = |name: &String| IdentifyError::MissingParam { segment: i, name: name.clone() };
        let p = p.into_iter().zip(names).map(|(p, name)| p.ok_or_else(|| missing(name)));
        Ok(Segment { p: p.collect::<Result<_, _>>()?, ..segment.clone() })
    };
    let segments = segments.iter().enumerate().map(with_params).collect::<Result<Vec<_>, _>>()?;
    identify(system, &segments, &unknowns, options)
}

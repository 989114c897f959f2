//! Identification of the trained numbers of a scene.

use crate::identify::{Fit, IdentifyError, Options, Segment, Unknown, identify};
use crate::{DynTask, Number, System, Task, Varied};

/// Fits the trained numbers of a task to measured segments. Replaces the parameters of the segments
/// by the nominal values of the task. `names` are the names of the parameters of a rollout.
pub fn identified(task: &DynTask, names: &[String], segments: &[Segment], options: &Options) -> Result<Fit, IdentifyError> {
    let system = task.system();
    let mut p = vec![0.0; system.param_dim()];
    let mut unknowns = Vec::new();
    for Varied { index, number, .. } in system.varied(p.len()) {
        p[index] = number.nominal();
        if let Number::Trained { start, min, max } = number {
            unknowns.push(Unknown { name: names[index].clone(), index, start, min, max });
        }
    }
    let with_params = |segment: &Segment| Segment { p: p.clone(), ..segment.clone() };
    let segments: Vec<Segment> = segments.iter().map(with_params).collect();
    identify(system, &segments, &unknowns, options)
}

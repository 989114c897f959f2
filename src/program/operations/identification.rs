//! Identification of the trained numbers of a scene.

use crate::identify::{Fit, IdentifyError, Options, Segment, Unknown, identify};
use crate::{DynTask, Number, System, Task, Varied};

/// Fits the trained numbers of a task to measured segments. Replaces the numbers among the
/// parameters of the segments by nominal values. `names` are the names of the parameters of a
/// rollout.
pub fn identified(task: &DynTask, names: &[String], segments: &[Segment], options: &Options) -> Result<Fit, IdentifyError> {
    let system = task.system();
    let params = system.param_dim();
    let varied = system.varied(params);
    // Numbers are the last parameters. A task may have more parameters than its system.
    let named = varied.iter().zip(system.varied(task.param_dim()));
    let unknown = |(&Varied { index, number, .. }, named): (&Varied, Varied)| match number {
        Number::Trained { start, min, max } => Some(Unknown { name: names[named.index].clone(), index, start, min, max }),
        _ => None,
    };
    let unknowns: Vec<Unknown> = named.filter_map(unknown).collect();
    let with_numbers = |segment: &Segment| {
        // Parameters that are no numbers have no default.
        let mut p = if segment.p.is_empty() { vec![0.0; varied.len()] } else { segment.p.clone() };
        for &Varied { index, number, .. } in &varied {
            // `identify` refuses a segment with too few parameters.
            if let Some(p) = p.get_mut(index) {
                *p = number.nominal();
            }
        }
        Segment { p, ..segment.clone() }
    };
    let segments: Vec<Segment> = segments.iter().map(with_numbers).collect();
    identify(system, &segments, &unknowns, options)
}

//! Identification of the trained numbers of a scene.

use crate::identify::{Fit, IdentifyError, Options, Segment, Unknown, identify};
use crate::program::operations::Visit;
use crate::{Number, Policy, System, Task, Varied};

/// Visitor that fits the trained numbers to measured segments.
pub struct Identifying<'a> {
    /// Measured states and controls. Their parameters are replaced by those of the scene.
    pub segments: &'a [Segment],
    /// Names of the parameters of a rollout.
    pub names: &'a [String],
    pub options: &'a Options,
}

impl Visit for Identifying<'_> {
    type Out = Result<Fit, IdentifyError>;

    fn visit<T: Task + Clone + 'static, P: Policy + Clone + 'static>(self, task: T, _policy: P) -> Self::Out {
        let system = task.system();
        let mut p = vec![0.0; system.param_dim()];
        let mut unknowns = Vec::new();
        for Varied { index, number, .. } in system.varied(p.len()) {
            p[index] = number.nominal();
            if let Number::Trained { start, min, max } = number {
                unknowns.push(Unknown { name: self.names[index].clone(), index, start, min, max });
            }
        }
        let with_params = |segment: &Segment| Segment { p: p.clone(), ..segment.clone() };
        let segments: Vec<Segment> = self.segments.iter().map(with_params).collect();
        identify(system, &segments, &unknowns, self.options)
    }
}

//! [`BodiesTask`]: bodies with initial states and a horizon.

use crate::model::JointKind;
use crate::system::Bodies;
use physgrad::rng::Rng;
use physgrad::{DynTask, Number, Start, Substeps, System as _, Task};

/// Bodies with a distribution of initial states. Without costs: expressions provide these.
#[derive(Clone, Debug)]
pub struct BodiesTask {
    system: Substeps<Bodies>,
    start: Vec<Number>,
    horizon: usize,
}

impl BodiesTask {
    /// A task whose control step consists of `frames` steps of the model. `start` has a number for
    /// each state component. Quaternions of drawn starts are normalized.
    ///
    /// # Panics
    /// If `start` has another length than the state, or `frames` is 0.
    pub fn new(bodies: Bodies, frames: usize, start: Vec<Number>, horizon: usize) -> Self {
        assert_eq!(start.len(), bodies.state_dim(), "one initial number per state component");
        Self { system: Substeps { count: frames, system: bodies }, start, horizon }
    }

    /// The bodies.
    pub fn bodies(&self) -> &Bodies {
        &self.system.system
    }

    /// The task behind a pointer. Its code is compiled in this crate.
    #[inline(never)]
    pub fn erased(self) -> DynTask {
        DynTask::new(self)
    }
}

impl Task for BodiesTask {
    type System = Substeps<Bodies>;

    fn system(&self) -> &Self::System {
        &self.system
    }

    fn horizon(&self) -> usize {
        self.horizon
    }

    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x.iter_mut().zip(&self.start).for_each(|(x, number)| *x = number.draw(rng));
        let mut index = 0;
        for joint in &self.bodies().model().joints {
            let (length, turn) = match joint.kind {
                JointKind::Slide | JointKind::Hinge => (1, 0..0),
                JointKind::Ball => (4, index..index + 4),
                JointKind::Free => (7, index + 3..index + 7),
            };
            let norm = x[turn.clone()].iter().map(|q| q * q).sum::<f64>().sqrt();
            if norm > 0.0 {
                x[turn].iter_mut().for_each(|q| *q /= norm);
            }
            index += length;
        }
    }

    fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        let ranges: Vec<[f64; 2]> = self
            .bodies()
            .model()
            .actuators
            .iter()
            .map(|actuator| actuator.control_range.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]))
            .collect();
        ranges.iter().flatten().any(|bound| bound.is_finite()).then_some(ranges)
    }
}

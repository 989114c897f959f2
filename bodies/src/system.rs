//! [`Bodies`]: a model as a system.

use crate::distribution::Distribution;
use crate::model::Model;
use crate::step::{Bar, Buffers, ContactForce};
use crate::tree::{Coefficient, Tree, numbers};
use physgrad::engine::lend;
use physgrad::scalar::Dual;
use physgrad::{
    Cotangent, Cotangents, Float as _, Inputs, Number, Numbers, Real, Scalar, System, Tangents,
};
use std::borrow::Cow;
use std::sync::Arc;

/// Articulated bodies with contact.
///
/// The state is `[q, v]`: one position per degree of freedom, or 4 per ball joint and 7 per free
/// joint, and one velocity per degree of freedom. The controls are those of the actuators. A step
/// has the time step of the model.
#[derive(Clone, Debug)]
pub struct Bodies {
    model: Arc<Model>,
    tree: Arc<Tree>,
    numbers: Arc<[(Cow<'static, str>, Number)]>,
    varied: usize,
}

/// Why a model cannot be simulated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BodiesError {
    /// A part of the model has no equations here.
    #[error("{0}")]
    Unsupported(String),
    /// A number is not one of the model.
    #[error("`{name}` is not a number of the model")]
    UnknownNumber {
        /// The name.
        name: String,
        /// The names of all numbers.
        known: Vec<String>,
    },
}

impl Bodies {
    /// Compiles a model with its own numbers.
    ///
    /// # Errors
    /// The model has joints or contacts that are not simulated.
    pub fn new(model: Model) -> Result<Self, BodiesError> {
        Self::with_numbers(model, Vec::new())
    }

    /// Compiles a model with some of its numbers set, drawn for each sample, or trained:
    /// `body.NAME.mass`, `.centre_x` to `.centre_z`, `.stretch_x` to `.stretch_z`, `.shear_xy`,
    /// `.shear_xz`, `.shear_yz`; `joint.NAME.damping`, `.armature`, `.stiffness`, `.friction_loss`;
    /// `motor.NAME.gear`, `.kp`, `.kv`; `shape.NAME.friction`.
    ///
    /// A mass scales the moments of inertia of its body. Stretches and shears map the distribution of
    /// its mass about the centre of mass, x first: a stretch of 1 and a shear of 0 are those of the
    /// file. Softness of constraints has the inverse masses of typical values.
    ///
    /// # Errors
    /// The model has joints or contacts that are not simulated, or no number with a name.
    pub fn with_numbers(model: Model, set: Vec<(String, Number)>) -> Result<Self, BodiesError> {
        let known = numbers(&model);
        if let Some((name, _)) =
            set.iter().find(|(name, _)| !known.iter().any(|known| known.name == *name))
        {
            let known = known.into_iter().map(|number| number.name).collect();
            return Err(BodiesError::UnknownNumber { name: name.clone(), known });
        }
        let varied: Vec<&String> =
            set.iter().filter(|(_, number)| !number.is_fixed()).map(|(name, _)| name).collect();
        let coefficient = |name: &str, value: f64| {
            let given = set.iter().find(|(given, _)| given == name);
            Coefficient {
                value: given.map_or(value, |(_, number)| number.nominal()),
                entry: varied.iter().position(|varied| *varied == name),
            }
        };
        let tree = Tree::new(&model, &coefficient).map_err(BodiesError::Unsupported)?;
        let varied = varied.len();
        let numbers = set.into_iter().map(|(name, number)| (Cow::Owned(name), number)).collect();
        Ok(Self { model: Arc::new(model), tree: Arc::new(tree), numbers, varied })
    }

    /// The model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Names and values of the numbers that may be set, drawn or trained.
    pub fn known_numbers(model: &Model) -> Vec<(String, f64)> {
        numbers(model).into_iter().map(|number| (number.name, number.value)).collect()
    }

    /// Whether the model has contacts, limits or dry friction, whose softness depends on typical
    /// values of the numbers.
    pub fn has_constraints(&self) -> bool {
        self.tree.has_rows || !self.tree.contacts.is_empty()
    }

    /// Number of positions.
    pub fn positions(&self) -> usize {
        self.tree.nq
    }

    /// Number of velocities.
    pub fn velocities(&self) -> usize {
        self.tree.nv()
    }

    /// Positions in the reference pose.
    pub fn reference(&self) -> &[f64] {
        &self.tree.reference
    }

    /// Accelerations under all constraints, and iterations of their solver.
    pub fn accelerations(&self, Inputs { x, u, p, .. }: Inputs<'_, f64>) -> (Vec<f64>, usize) {
        let (q, v) = x.split_at(self.tree.nq);
        lend(|buffers: &mut Buffers<f64>| {
            let (a, iterations) = buffers.acceleration(&self.tree, [q, v, u, self.own(p)]);
            (a.to_vec(), iterations)
        })
    }

    /// Whether some shapes may touch.
    pub fn can_touch(&self) -> bool {
        !self.tree.contacts.is_empty()
    }

    /// Contacts at a state, with their forces under a control. In the first step of the model from
    /// there, or in its first stage. Shapes that touch in several points have one force in each.
    /// ```
    /// use physgrad::Inputs;
    /// use physgrad_bodies::{Bodies, files};
    ///
    /// let text = "<mujoco><worldbody><geom type='plane' size='1 1 1'/>
    ///     <body pos='0 0 0.1'><freejoint/><geom size='0.1' mass='2'/></body></worldbody></mujoco>";
    /// let ball = Bodies::new(files::parse(text, "ball").unwrap()).unwrap();
    /// let x = [0.0, 0.0, 0.0999, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    /// let forces = ball.contact_forces(Inputs::new(&x, &[]));
    /// assert!(forces.len() == 1 && forces[0].body == 1 && forces[0].force[2] > 0.0);
    /// ```
    pub fn contact_forces(
        &self,
        Inputs { x, u, p, .. }: Inputs<'_, f64>,
    ) -> Vec<ContactForce<f64>> {
        let (q, v) = x[..System::state_dim(self)].split_at(self.tree.nq);
        lend(|buffers: &mut Buffers<f64>| {
            buffers.contact_forces(&self.tree, [q, v, u, self.own(p)])
        })
    }

    /// Mass and centre of mass of each body in its axes, with the parameters `p`.
    pub fn masses<T: Scalar>(&self, p: &[T]) -> Vec<(T, [T; 3])> {
        let p = self.own(p);
        let of = |distribution: &Option<Distribution>| match distribution {
            Some(distribution) => {
                (distribution.mass.of(p), distribution.centre.map(|component| component.of(p)))
            }
            None => (T::zero(), [T::zero(); 3]),
        };
        self.tree.distributions.iter().map(of).collect()
    }

    /// Position and orientation of each body in axes of the world, at the positions with which
    /// `q` begins.
    pub fn poses<T: Scalar>(&self, q: &[T], p: &[T]) -> Vec<([T; 3], [[T; 3]; 3])> {
        lend(|buffers: &mut Buffers<T>| buffers.poses(&self.tree, &q[..self.tree.nq], self.own(p)))
    }

    /// The parameters of the model, the last of a task.
    #[inline(always)]
    fn own<'a, T>(&self, p: &'a [T]) -> &'a [T] {
        &p[p.len() - self.varied..]
    }
}

impl System for Bodies {
    fn state_dim(&self) -> usize {
        self.tree.nq + self.tree.nv()
    }

    fn control_dim(&self) -> usize {
        self.tree.motors.len()
    }

    fn param_dim(&self) -> usize {
        self.varied
    }

    fn numbers(&self) -> Numbers<'_> {
        Numbers::all(&self.numbers)
    }

    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        let inputs = Inputs { p: self.own(inputs.p), ..inputs };
        lend(|buffers: &mut Buffers<T>| buffers.step(&self.tree, inputs, next));
    }

    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let skipped = inputs.p.len() - self.varied;
        let inputs = Inputs { p: self.own(inputs.p), ..inputs };
        lend(|buffers: &mut Buffers<R>| {
            lend(|bar: &mut Bar<R, C>| {
                bar.vjp(buffers, &self.tree, inputs, next_bar, cotangents.skip_params(skipped));
            });
        });
    }

    /// One lane at a time, in f64: no further scalar is compiled.
    fn jvp<R: Real>(&self, inputs: Inputs<'_, R>, tangents: Tangents<'_, R>, next_tan: &mut [R]) {
        let mut next = vec![Dual::<f64, TANGENTS>::constant(0.0); self.state_dim()];
        for lane in 0..R::LANES {
            let along = |values: &[R], tangents: Option<&[R]>| -> Vec<Dual<f64, TANGENTS>> {
                let number = |x: &R| x.lane(lane).to_f64();
                let dual = |(i, value): (usize, &R)| {
                    let mut dual = Dual::constant(number(value));
                    dual.tangents[0] = tangents.map_or(0.0, |tangents| number(&tangents[i]));
                    dual
                };
                values.iter().enumerate().map(dual).collect()
            };
            let x = along(inputs.x, tangents.x);
            let (u, p) = (along(inputs.u, tangents.u), along(inputs.p, tangents.p));
            self.step(Inputs { x: &x, u: &u, p: &p, t: inputs.t }, &mut next);
            for (tan, next) in next_tan.iter_mut().zip(&next) {
                tan.set_lane(lane, R::Real::from_f64(next.tangents[0]));
            }
        }
    }
}

/// Directions of the dual numbers of the library, of which a step uses one.
const TANGENTS: usize = 4;

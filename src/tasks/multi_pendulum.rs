//! [`MultiPendulum`]: rigid arms on joints with friction, hinged end to end on a fixed support.

use crate::dynamics::inputs::OdeInputs;
use crate::dynamics::number::{Number, Numbers, Varied};
use crate::dynamics::ode::Ode;
use crate::numbers::scalar::Scalar;
use crate::tasks::pole_chain::factor::{factor, solve};
use serde::{Deserialize, Serialize};
use smallvec::{SmallVec, smallvec};

/// One arm of a [`MultiPendulum`], with the joint that connects it to the arm before or to the
/// support.
///
/// The torque of friction in this joint is
/// `-(viscous r + dry tanh(r / 0.01 rad/s) + quadratic |r| r)`. Here, r is the rate of the arm
/// relative to the arm before.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Arm {
    /// Mass m, kg.
    pub mass: Number,
    /// Distance a of the center of mass from the joint, m.
    pub center: Number,
    /// Distance L between the joint and the next joint, m. Unused in the last arm.
    pub length: Number,
    /// Moment of inertia I about the center of mass, kg m².
    pub inertia: Number,
    /// Viscous friction, N m s/rad.
    pub viscous: Number,
    /// Dry friction, N m.
    pub dry: Number,
    /// Quadratic friction, N m s²/rad².
    pub quadratic: Number,
}

impl Default for Arm {
    /// Returns a uniform rod of 0.1 kg and 0.2 m on a joint without friction.
    fn default() -> Self {
        let [mass, center, length, inertia] =
            [0.1, 0.1, 0.2, 0.1 * 0.2 * 0.2 / 12.0].map(Number::Fixed);
        let [viscous, dry, quadratic] = [0.0; 3].map(Number::Fixed);
        Self { mass, center, length, inertia, viscous, dry, quadratic }
    }
}

impl Arm {
    fn numbers(&self) -> Numbers<'_> {
        let Self { mass, center, length, inertia, viscous, dry, quadratic } = self;
        Numbers::new([
            ("mass", mass),
            ("center", center),
            ("length", length),
            ("inertia", inertia),
            ("viscous", viscous),
            ("dry", dry),
            ("quadratic", quadratic),
        ])
    }
}

/// Planar pendulum of rigid arms, hinged end to end on a fixed support, with friction in the
/// joints.
///
/// State `[θ₁, ω₁, θ₂, ω₂, …]` in rad and rad/s. The angles are absolute: 0 is upright, π
/// hangs. Control `[u]`: torque on the first arm, N m. With `l_kj = L_j` for `j < k` and
/// `l_kk = a_k`, Lagrange's equations are:
///
/// ```text
/// Σ_j M_ij α_j = τ_i + g sin θ_i Σ_{k≥i} m_k l_ki - Σ_j C_ij sin(θ_i - θ_j) ω_j²
/// C_ij = Σ_k m_k l_ki l_kj  for k ≥ max(i, j),   M_ij = C_ij cos(θ_i - θ_j),   M_ii += I_i
/// ```
///
/// τ_i is the torque on arm i: friction of its own joint, the reaction of the next joint, and for
/// the first arm the control.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct MultiPendulum {
    /// The arms, from the support.
    pub arms: Vec<Arm>,
    /// Gravitational acceleration g, m/s².
    pub gravity: Number,
}

impl Default for MultiPendulum {
    fn default() -> Self {
        Self { arms: vec![Arm::default(); 2], gravity: 9.81.into() }
    }
}

/// Rate at which dry friction reaches three quarters of the largest torque, rad/s.
const SMOOTHING: f64 = 0.01;

/// Values of an [`Arm`].
#[derive(Clone, Copy)]
struct Values<T> {
    mass: T,
    center: T,
    length: T,
    inertia: T,
    viscous: T,
    dry: T,
    quadratic: T,
}

impl MultiPendulum {
    /// Values of all arms, and gravity. Values that vary are the last entries of `p`, in this
    /// order.
    fn values<T: Scalar>(&self, p: &[T]) -> (SmallVec<[Values<T>; 4]>, T) {
        let count: usize = self.arms.iter().map(|arm| arm.numbers().varied()).sum();
        let mut p = &p[p.len() - count - usize::from(!self.gravity.is_fixed())..];
        let arms = self.arms.iter().map(|arm| {
            let numbers = arm.numbers();
            let [mass, center, length, inertia, viscous, dry, quadratic] = numbers.of(p);
            p = &p[numbers.varied()..];
            Values { mass, center, length, inertia, viscous, dry, quadratic }
        });
        let arms = arms.collect();
        let [gravity] = Numbers::new([("gravity", &self.gravity)]).of(p);
        (arms, gravity)
    }

    /// Kinetic plus potential energy of a state, J, with nominal numbers. The energy is 0 at rest
    /// with all arms horizontal. Without friction and control, the equations conserve the energy.
    pub fn energy(&self, x: &[f64]) -> f64 {
        let (mut across, mut up, mut height, mut energy) = (0.0, 0.0, 0.0, 0.0);
        for (arm, pair) in self.arms.iter().zip(x.chunks_exact(2)) {
            let (theta, omega) = (pair[0], pair[1]);
            let [mass, center, length, inertia] =
                [arm.mass, arm.center, arm.length, arm.inertia].map(|n| n.nominal());
            let (sin, cos) = theta.sin_cos();
            let speed = [across + center * cos * omega, up - center * sin * omega];
            energy += 0.5 * mass * (speed[0] * speed[0] + speed[1] * speed[1])
                + 0.5 * inertia * omega * omega;
            energy += mass * self.gravity.nominal() * (height + center * cos);
            (across, up, height) =
                (across + length * cos * omega, up - length * sin * omega, height + length * cos);
        }
        energy
    }
}

impl Ode for MultiPendulum {
    fn state_dim(&self) -> usize {
        2 * self.arms.len()
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn param_dim(&self) -> usize {
        // Any large argument: only the count is used, not the indices.
        self.varied(usize::MAX / 2).len()
    }

    fn varied(&self, params: usize) -> Vec<Varied> {
        let mut all = Vec::new();
        for (i, arm) in self.arms.iter().enumerate() {
            let named =
                |varied: Varied| Varied { name: format!("arms[{i}].{}", varied.name), ..varied };
            all.extend(arm.numbers().placed(0).into_iter().map(named));
        }
        all.extend(Numbers::new([("gravity", &self.gravity)]).placed(0));
        let first = params - all.len();
        all.iter_mut().enumerate().for_each(|(i, varied)| varied.index = first + i);
        all
    }

    fn rate<T: Scalar>(&self, OdeInputs { x, u, p, .. }: OdeInputs<'_, T>, rate: &mut [T]) {
        type Each<T> = SmallVec<[T; 8]>;
        let n = self.arms.len();
        let omega = |i: usize| x[2 * i + 1];
        let (arms, gravity) = self.values(p);
        let (sin, cos): (Each<T>, Each<T>) =
            x.chunks_exact(2).map(|pair| pair[0].sin_cos()).unzip();
        let mut torque: Each<T> = smallvec![T::zero(); n];
        torque[0] += u[0];
        for (i, arm) in arms.iter().enumerate() {
            let r = if i == 0 { omega(0) } else { omega(i) - omega(i - 1) };
            let friction = arm.viscous * r
                + arm.dry * (r * (1.0 / SMOOTHING)).tanh()
                + arm.quadratic * r.abs() * r;
            torque[i] -= friction;
            if i > 0 {
                torque[i - 1] += friction;
            }
        }
        // Mass of all arms after each arm, which moves with the end of that arm.
        let mut beyond: Each<T> = smallvec![T::zero(); n];
        for i in (1..n).rev() {
            beyond[i - 1] = beyond[i] + arms[i].mass;
        }
        let mut matrix: SmallVec<[T; 16]> = SmallVec::new();
        for i in 0..n {
            let moment = arms[i].mass * arms[i].center + beyond[i] * arms[i].length;
            torque[i] += gravity * moment * sin[i];
            for j in 0..i {
                let coupling = moment * arms[j].length;
                let across = coupling * (sin[i] * cos[j] - cos[i] * sin[j]);
                matrix.push(coupling * (cos[i] * cos[j] + sin[i] * sin[j]));
                torque[i] -= across * omega(j) * omega(j);
                torque[j] += across * omega(i) * omega(i);
            }
            let Values { mass, center, length, inertia, .. } = arms[i];
            matrix.push(inertia + mass * center * center + beyond[i] * length * length);
        }
        factor(&mut matrix, n);
        solve(&matrix, &mut torque);
        for i in 0..n {
            (rate[2 * i], rate[2 * i + 1]) = (omega(i), torque[i]);
        }
    }

    fn velocity(&self, i: usize) -> Option<usize> {
        i.is_multiple_of(2).then_some(i + 1)
    }
}

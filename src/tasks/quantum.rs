//! Quantum control: a particle in a box, to be brought into an eigenstate by tilting the floor.
//!
//! The task of "Stabilizing Backpropagation Through Time to Learn Complex Physics" (ICLR 2024). Units: ħ = 1 and
//! m = 1/2, so that the Hamiltonian is `-∂²/∂x² + V`.

use super::LossMode;
use crate::rng::Rng;
use crate::scalar::{Cotangent, Real, Scalar};
use crate::system::System;
use crate::task::Task;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use smallvec::{SmallVec, smallvec};
use std::f64::consts::{PI, TAU};
use std::ops::{Add, Mul, Neg, Sub};

/// Grid points that are worked on without allocating; larger grids allocate in every step.
const STACK: usize = 64;

/// A complex number as its real and imaginary part.
type Pair<T> = (T, T);

/// The physics: Schrödinger's equation in a box with a linear potential, by Crank and Nicolson.
///
/// State `[Re ψ_1, Im ψ_1, Re ψ_2, …]`, shape (grid, 2) row-major, at the points `x_j = j dx`, `j = 1 .. grid`; ψ is 0
/// at the walls, `j = 0` and `j = grid + 1`. Control `[c]`, the slope of the potential.
///
/// ```text
/// H = -D₂ + diag(c x_j)               D₂: second difference over dx², dx = length / (grid + 1)
/// A = I + i dt/2 H
/// ψ' = A⁻¹ (I - i dt/2 H) ψ = 2 A⁻¹ ψ - ψ
/// ```
///
/// The step is unitary whatever the control. It costs one tridiagonal solve, O(grid). Elimination without pivoting is
/// safe although large controls end the dominance of the diagonal: the Hermitian part of A is the identity, so the
/// real part of every pivot is at least 1 (`p_j = A_jj + b²/p_{j-1}` with `b = dt / 2dx²`; `Re A_jj = 1`, and 1/p has
/// its real part positive when p has). Golub and Van Loan, Matrix Computations, 4.2.2.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct QuantumSystem {
    /// Number of grid points between the walls, at least 3.
    pub grid: usize,
    /// Length of the box, positive.
    pub length: f64,
    /// Time step, positive. The control is constant during it.
    pub dt: f64,
}

impl Default for QuantumSystem {
    fn default() -> Self {
        Self { grid: 32, length: 2.0, dt: 0.0625 }
    }
}

/// What a solve with [`Elimination`] can be applied to: numbers, and cotangents in several columns.
trait Vector<T>: Copy + Add<Output = Self> + Sub<Output = Self> + Neg<Output = Self> + Mul<T, Output = Self> {}

impl<T, V> Vector<T> for V where V: Copy + Add<Output = V> + Sub<Output = V> + Neg<Output = V> + Mul<T, Output = V> {}

/// `A = I + i dt/2 H`, eliminated: complex symmetric, with `-ib` beside the diagonal.
struct Elimination<T> {
    b: T,
    /// One over the pivot of each row.
    per_pivot: SmallVec<[Pair<T>; STACK]>,
}

impl<T: Scalar> Elimination<T> {
    /// `y ← A⁻¹ rhs`, both with real and imaginary parts in turn.
    #[inline(always)]
    fn solve<V: Vector<T>>(&self, rhs: &[V], y: &mut [V]) {
        let b = self.b;
        // Forward: s_j = (rhs_j + ib s_{j-1}) / p_j.
        let mut before: Option<Pair<V>> = None;
        for ((rhs, y), &(q_re, q_im)) in rhs.chunks_exact(2).zip(y.chunks_exact_mut(2)).zip(&self.per_pivot) {
            let (mut re, mut im) = (rhs[0], rhs[1]);
            if let Some((s_re, s_im)) = before {
                (re, im) = (re - s_im * b, im + s_re * b);
            }
            let s = (re * q_re - im * q_im, re * q_im + im * q_re);
            (y[0], y[1]) = s;
            before = Some(s);
        }
        // Back: y_j = s_j + ib y_{j+1} / p_j.
        let mut after: Option<Pair<V>> = None;
        for (y, &(q_re, q_im)) in y.chunks_exact_mut(2).zip(&self.per_pivot).rev() {
            if let Some((y_re, y_im)) = after {
                let (re, im) = (q_re * b, q_im * b);
                y[0] = y[0] - (y_re * im + y_im * re);
                y[1] = y[1] + (y_re * re - y_im * im);
            }
            after = Some((y[0], y[1]));
        }
    }

    /// Becomes the elimination of the conjugate, which is the adjoint because A is symmetric.
    #[inline(always)]
    fn conjugate(&mut self) {
        self.b = -self.b;
        for (_, im) in &mut self.per_pivot {
            *im = -*im;
        }
    }
}

impl QuantumSystem {
    /// Eigenstate `number` of the box without potential, at the grid points; 1 is the ground state.
    ///
    /// ```text
    /// φ_j = sqrt(2 / (grid + 1)) sin(π number j / (grid + 1)),  Σ_j φ_j² = 1,  1 ≤ number ≤ grid
    /// ```
    #[inline(always)]
    pub fn eigenstate(&self, number: usize) -> impl Iterator<Item = f64> + use<> {
        let intervals = (self.grid + 1) as f64;
        // One sine, then rotations: their error grows by one rounding a grid point.
        let (sin, cos) = Scalar::sin_cos(PI * number as f64 / intervals);
        let (mut s, mut c) = (0.0, (2.0 / intervals).sqrt());
        (0..self.grid).map(move |_| {
            (s, c) = (s * cos + c * sin, c * cos - s * sin);
            s
        })
    }

    /// Distance between grid points.
    fn spacing(&self) -> f64 {
        self.length / (self.grid + 1) as f64
    }

    #[inline(always)]
    fn eliminate<T: Scalar>(&self, u: &[T]) -> Elimination<T> {
        let dx = self.spacing();
        let off_diagonal = 0.5 * self.dt / (dx * dx);
        let b = T::lift(off_diagonal);
        let (kinetic, tilt) = (T::lift(2.0 * off_diagonal), u[0] * T::lift(0.5 * self.dt * dx));
        let mut per_pivot: SmallVec<[Pair<T>; STACK]> = smallvec![(T::zero(), T::zero()); self.grid];
        let b_squared = b * b;
        let (mut q_re, mut q_im) = (T::zero(), T::zero());
        for (j, per_pivot) in per_pivot.iter_mut().enumerate() {
            let re = T::one() + b_squared * q_re;
            let im = kinetic + tilt * T::lift((j + 1) as f64) + b_squared * q_im;
            let per_square = T::one() / (re * re + im * im);
            (q_re, q_im) = (re * per_square, -(im * per_square));
            *per_pivot = (q_re, q_im);
        }
        Elimination { b, per_pivot }
    }

    /// `x_bar = 2 A⁻ᴴ v - v`, having passed `w = A⁻ᴴ v` to `visit`. The cotangents of real and imaginary parts are
    /// carried by the conjugate transpose of the complex matrix.
    #[inline(always)]
    fn reverse_state<R: Real, C: Cotangent<R>>(conjugate: &Elimination<R>, next_bar: &[C], x_bar: &mut [C]) {
        conjugate.solve(next_bar, x_bar);
        for (x_bar, &next_bar) in x_bar.iter_mut().zip(next_bar) {
            *x_bar = *x_bar + *x_bar - next_bar;
        }
    }

    /// The control's cotangent, from `w = (x_bar + v) / 2`:
    ///
    /// ```text
    /// A y = ψ, so dψ'/dc = 2 dy/dc = -i dt A⁻¹ diag(x_j) y
    /// u_bar = Re ⟨v, dψ'/dc⟩ = dt Σ_j x_j Im(w̄_j y_j)
    /// ```
    #[inline(always)]
    fn reverse_control<R: Real, C: Cotangent<R>>(&self, y: &[R], next_bar: &[C], x_bar: &[C]) -> C {
        let factor = 0.5 * self.dt * self.spacing();
        let mut sum = C::null();
        for (j, ((y, v), x_bar)) in y.chunks_exact(2).zip(next_bar.chunks_exact(2)).zip(x_bar.chunks_exact(2)).enumerate() {
            let (twice_re, twice_im) = (x_bar[0] + v[0], x_bar[1] + v[1]);
            sum += (twice_re * y[1] - twice_im * y[0]) * R::lift(factor * (j + 1) as f64);
        }
        sum
    }
}

impl System for QuantumSystem {
    fn state_dim(&self) -> usize {
        2 * self.grid
    }

    fn control_dim(&self) -> usize {
        1
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, x: &[T], u: &[T], next: &mut [T]) {
        self.eliminate(u).solve(x, next);
        for (next, &x) in next.iter_mut().zip(x) {
            *next = *next + *next - x;
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C], u_bar: &mut [C]) {
        let mut a = self.eliminate(u);
        // Solved again rather than kept by the forward pass.
        let mut y: SmallVec<[R; 2 * STACK]> = smallvec![R::zero(); x.len()];
        a.solve(x, &mut y);
        a.conjugate();
        Self::reverse_state(&a, next_bar, x_bar);
        u_bar[0] = self.reverse_control(&y, next_bar, x_bar);
    }

    #[inline(always)]
    fn vjp_state<R: Real, C: Cotangent<R>>(&self, _x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C]) {
        let mut a = self.eliminate(u);
        a.conjugate();
        Self::reverse_state(&a, next_bar, x_bar);
    }

    #[inline(always)]
    fn vjp_control<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], u_bar: &mut [C]) {
        let mut x_bar: SmallVec<[C; 2 * STACK]> = smallvec![C::null(); x.len()];
        self.vjp(x, u, next_bar, &mut x_bar, u_bar);
    }
}

/// Bring the particle into an eigenstate of the box: the cost of a state is its infidelity `1 - |⟨φ, ψ⟩|²`, between 0
/// and 1, where `⟨φ, ψ⟩ = Σ_j φ_j ψ_j`. The control is free.
///
/// Rollouts start in a mixture of the two lowest eigenstates, so the third is the lowest that is new to them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantum {
    /// The physics.
    pub system: QuantumSystem,
    /// Number of the eigenstate to reach, from 1, the ground state, to the grid. (The paper counts from 0.)
    pub target: usize,
    /// [`LossMode::Final`]: the last state's infidelity. [`LossMode::Continuous`]: its sum over all states after the
    /// start, between 0 and the horizon.
    pub loss: LossMode,
    /// Number of steps.
    pub horizon: usize,
    /// How strongly the first and the second eigenstate come into the start states; not both zero.
    pub weighting: [f64; 2],
}

impl Quantum {
    /// The paper's task: 32 grid points, 128 steps of 0.0625, every state counts, start weighting 1 : 1.
    pub fn new(target: usize) -> Self {
        let system = QuantumSystem::default();
        Self { system, target, loss: LossMode::Continuous, horizon: 128, weighting: [1.0, 1.0] }
    }

    /// `⟨φ, ψ⟩` with the target.
    #[inline(always)]
    fn overlap<T: Scalar>(&self, x: &[T]) -> Pair<T> {
        let (mut re, mut im) = (T::zero(), T::zero());
        for (x, target) in x.chunks_exact(2).zip(self.system.eigenstate(self.target)) {
            let target = T::lift(target);
            re += x[0] * target;
            im += x[1] * target;
        }
        (re, im)
    }

    #[inline(always)]
    fn infidelity<T: Scalar>(&self, x: &[T]) -> T {
        let (re, im) = self.overlap(x);
        T::one() - (re * re + im * im)
    }

    /// `-2 ⟨φ, ψ⟩ φ`.
    #[inline(always)]
    fn infidelity_gradient<R: Real>(&self, x: &[R], x_bar: &mut [R]) {
        let (re, im) = self.overlap(x);
        let (re, im) = (re * R::lift(-2.0), im * R::lift(-2.0));
        for (x_bar, target) in x_bar.chunks_exact_mut(2).zip(self.system.eigenstate(self.target)) {
            let target = R::lift(target);
            (x_bar[0], x_bar[1]) = (re * target, im * target);
        }
    }
}

impl Task for Quantum {
    type System = QuantumSystem;

    fn system(&self) -> &QuantumSystem {
        &self.system
    }

    fn horizon(&self) -> usize {
        self.horizon
    }

    /// `(c₁ e^{ip₁} φ₁ + c₂ e^{ip₂} φ₂) / sqrt(c₁² + c₂²)`: amplitudes c normal, times the weighting; phases p uniform.
    ///
    /// # Panics
    /// If the weighting is so large, small or odd that the state cannot be normalized.
    fn start(&self, rng: &mut Rng, x: &mut [f64]) {
        let amplitudes = self.weighting.map(|weight| {
            let draw: f64 = StandardNormal.sample(rng);
            weight * draw
        });
        let norm = amplitudes[0].hypot(amplitudes[1]);
        assert!(norm.is_normal(), "with the weighting {:?}, a start state cannot be normalized", self.weighting);
        x.fill(0.0);
        for (number, amplitude) in (1..).zip(amplitudes) {
            let (sin, cos) = Scalar::sin_cos(rng.random_range(0.0..TAU));
            for (x, eigenstate) in x.chunks_exact_mut(2).zip(self.system.eigenstate(number)) {
                x[0] += amplitude / norm * cos * eigenstate;
                x[1] += amplitude / norm * sin * eigenstate;
            }
        }
    }

    #[inline(always)]
    fn stage_cost<T: Scalar>(&self, x: &[T], _u: &[T]) -> T {
        match self.loss {
            LossMode::Final => T::zero(),
            LossMode::Continuous => self.infidelity(x),
        }
    }

    #[inline(always)]
    fn terminal_cost<T: Scalar>(&self, x: &[T]) -> T {
        match self.loss {
            LossMode::Final => self.infidelity(x),
            LossMode::Continuous => T::zero(),
        }
    }

    #[inline(always)]
    fn stage_cost_gradient<R: Real>(&self, x: &[R], _u: &[R], x_bar: &mut [R], u_bar: &mut [R]) {
        u_bar[0] = R::zero();
        match self.loss {
            LossMode::Final => x_bar.fill(R::zero()),
            LossMode::Continuous => self.infidelity_gradient(x, x_bar),
        }
    }

    #[inline(always)]
    fn terminal_cost_gradient<R: Real>(&self, x: &[R], x_bar: &mut [R]) {
        match self.loss {
            LossMode::Final => self.infidelity_gradient(x, x_bar),
            LossMode::Continuous => x_bar.fill(R::zero()),
        }
    }
}

//! [`Flow`] and [`Adjoint`]: the adjoint recursion, for one or two vector fields from one forward pass.
//!
//! ```text
//! λ ← ∂φ/∂x_T
//! for t = T-1 .. 0:
//!     λ ← λ + ∂l/∂x(x_{t+1}, u_t)
//!     h_t ← (∂S/∂u)ᵀ λ + ∂l/∂u(x_{t+1}, u_t)
//!     λ ← physics·(∂S/∂x)ᵀ λ + control·(∂N/∂x)ᵀ h_t
//! g ← Σ_t (∂N/∂θ)ᵀ h_t                                 after the loop, in large products
//! ```

use crate::divergence::{Divergence, Variable};
use crate::kernels::{Vectorized, dispatch_narrow};
use crate::policy::{Policy, PolicyColumns, PolicyPass, PolicyRecord, Weights};
use crate::rollout::{Lane, Rollout, WIDTH, find_non_finite, gather};
use crate::scalar::{Columns, Float, Real, Scalar};
use crate::system::System;
use crate::task::Task;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::Range;

/// Which paths carry the adjoint back in time. The forward values are the same for all.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Flow {
    /// Through the physics, `∂S/∂x`.
    pub physics: bool,
    /// Through the policy's input, `∂N/∂x`.
    pub control: bool,
}

impl Flow {
    /// R: full backpropagation through time, the true gradient.
    pub const REGULAR: Self = Self { physics: true, control: true };
    /// M: the physics path only; the policy's input is detached.
    pub const MODIFIED: Self = Self { physics: true, control: false };
    /// N: the policy's path only; the physics' state input is detached.
    pub const NETWORK: Self = Self { physics: false, control: true };
    /// S: neither; every control sees only the cost of the step it caused.
    pub const STOPPED: Self = Self { physics: false, control: false };
    /// All four.
    pub const ALL: [Self; 4] = [Self::REGULAR, Self::MODIFIED, Self::NETWORK, Self::STOPPED];
}

impl fmt::Display for Flow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match (self.physics, self.control) {
            (true, true) => "R",
            (true, false) => "M",
            (false, true) => "N",
            (false, false) => "S",
        })
    }
}

/// Room for the reverse pass of a [`Rollout`]: sized once, then run without allocating.
#[derive(Debug)]
pub struct Adjoint<F: Float> {
    horizon: usize,
    /// Lengths of λ, per flow and step, if they are to be kept.
    norms: Option<Vec<Vec<f64>>>,
    policy: PolicyAdjoint<F>,
    carried: Carried<F>,
}

/// The flows, and what the recursion carries for them.
#[derive(Debug)]
enum Carried<F: Float> {
    One([Flow; 1], Recursion<F, 1>),
    Two([Flow; 2], Recursion<F, 2>),
}

/// The policy's side of the reverse pass.
#[derive(Debug)]
struct PolicyAdjoint<F> {
    /// Control cotangents `h`, per flow, as the policy's columns.
    controls_bar: Vec<Vec<F>>,
    /// What the policy's backward pass keeps: per flow, or once for all if `unit`.
    tape_bar: Vec<Vec<F>>,
    /// `(∂N/∂x)ᵀ h` of one step, or `∂N/∂x` of all, as the policy's columns; nothing where no flow goes through it.
    inputs_bar: Vec<F>,
    /// The policy is linearized for the whole trajectory at once.
    unit: bool,
    /// With `unit`: ones, the cotangent of the only control.
    ones: Vec<F>,
    scratch: Vec<F>,
}

/// What the recursion carries for `K` flows.
#[derive(Debug)]
struct Recursion<F: Float, const K: usize> {
    /// λ, `[block][component]`.
    lambda: Vec<Columns<Lane<F>, K>>,
    /// The next λ, before the flows choose.
    x_bar: Vec<Columns<Lane<F>, K>>,
    /// h, `[block][component]`.
    u_bar: Vec<Columns<Lane<F>, K>>,
    /// Gradients of the costs of one block.
    cost_x: Vec<Lane<F>>,
    cost_u: Vec<Lane<F>>,
}

impl<F: Float> Adjoint<F> {
    /// Room for the gradients of one or two flows of such a rollout.
    ///
    /// # Panics
    /// With no flow or more than two, or a rollout without tape.
    #[track_caller]
    pub fn new<P: Policy>(policy: &P, rollout: &Rollout<F>, flows: &[Flow]) -> Self {
        assert!(rollout.has_tape(), "a rollout made for evaluation cannot be differentiated");
        let carried = match *flows {
            [flow] => Carried::One([flow], Recursion::new(rollout)),
            [first, second] => Carried::Two([first, second], Recursion::new(rollout)),
            _ => panic!("an adjoint carries one or two flows, not {}", flows.len()),
        };
        let (n, m) = (rollout.state_dim, rollout.control_dim);
        let columns = rollout.capacity() * rollout.horizon;
        let sizes = policy.sizes::<F>(columns);
        let zeros = |len: usize| vec![F::zero(); len];
        // With one control, ∂N/∂x and every layer's cotangent are known up to the factor h before the loop starts, and
        // one linearization in large products serves every flow. With more controls it would take one each.
        let through_inputs = flows.iter().any(|flow| flow.control);
        let unit = m == 1 && through_inputs;
        let policy = PolicyAdjoint {
            controls_bar: flows.iter().map(|_| zeros(columns * m)).collect(),
            tape_bar: flows.iter().take(if unit { 1 } else { 2 }).map(|_| zeros(sizes.tape_bar)).collect(),
            inputs_bar: zeros(if through_inputs { columns * n } else { 0 }),
            unit,
            ones: vec![F::one(); if unit { columns } else { 0 }],
            scratch: zeros(sizes.scratch),
        };
        Self { horizon: rollout.horizon, norms: None, policy, carried }
    }

    /// The flows it was made for.
    pub fn flows(&self) -> &[Flow] {
        match &self.carried {
            Carried::One(flows, _) => flows,
            Carried::Two(flows, _) => flows,
        }
    }

    /// Bytes on the heap, beyond those of the rollout it belongs to. They do not depend on how many samples are started.
    pub fn stored_bytes(&self) -> usize {
        let carried = match &self.carried {
            Carried::One(_, recursion) => recursion.stored_bytes(),
            Carried::Two(_, recursion) => recursion.stored_bytes(),
        };
        carried + self.policy.stored_bytes() + self.norms.as_deref().map_or(0, nested_bytes)
    }

    /// Keeps the length of the adjoint at every step of every run from now on, for [`norms`](Adjoint::norms).
    pub fn keep_norms(mut self) -> Self {
        self.norms = Some(vec![vec![f64::NAN; self.horizon + 1]; self.flows().len()]);
        self
    }

    /// The length of the adjoint of flow number `k` at the states `x_0 .. x_T` of the last run, `horizon + 1` numbers:
    /// how strongly what comes after a state depends on it, along the paths of the flow. It is the root mean square over the
    /// samples of ‖λ_t‖ for the loss of a sample. λ_t holds the costs after `x_t`, not that of `x_t` itself; at `T` it
    /// is the terminal cost's gradient, which is 0 where only states on the way are paid for. NaN where a run that
    /// diverged did not come.
    ///
    /// # Panics
    /// Without [`keep_norms`](Adjoint::keep_norms).
    #[track_caller]
    pub fn norms(&self, k: usize) -> &[f64] {
        &self.norms.as_ref().expect("the norms of an adjoint are kept only after `keep_norms`")[k]
    }

    /// Runs the recursion back through `rollout`. Cotangents are scaled by `scale`: 1 / batch for a batch mean.
    ///
    /// # Errors
    /// [`Divergence`] says where a cotangent was not finite.
    pub fn run<T: Task, P: Policy>(
        &mut self,
        task: &T,
        policy: &P,
        weights: &Weights<F>,
        rollout: &Rollout<F>,
        scale: F,
    ) -> Result<(), Divergence> {
        let pass = Pass { task, policy, weights, rollout, scale };
        let all = PolicyColumns::range(0..rollout.samples * rollout.horizon);
        if self.policy.unit {
            self.policy.backward(&pass, 0, all, true);
        }
        let norms = self.norms.as_deref_mut().unwrap_or_default();
        norms.iter_mut().for_each(|norms| norms.fill(f64::NAN));
        match &mut self.carried {
            Carried::One(flows, recursion) => recursion.run(&pass, *flows, &mut self.policy, norms)?,
            Carried::Two(flows, recursion) => recursion.run(&pass, *flows, &mut self.policy, norms)?,
        }
        for k in 0..self.flows().len() {
            if !self.flows()[k].control && !self.policy.unit {
                // Nothing in the loop needed the policy's derivative: all of it at once, without ∂N/∂x.
                self.policy.backward(&pass, k, all, false);
            }
        }
        Ok(())
    }

    /// `theta_bar = Σ (∂N/∂θ)ᵀ h` of flow number `k`, over the given samples, in large products. Overwrites it.
    pub fn param_gradient<P: Policy>(
        &mut self,
        k: usize,
        policy: &P,
        weights: &Weights<F>,
        rollout: &Rollout<F>,
        samples: Range<usize>,
        theta_bar: &mut [F],
    ) {
        theta_bar.fill(F::zero());
        let at = PolicyColumns::range(samples.start * rollout.horizon..samples.end * rollout.horizon);
        let p = &mut self.policy;
        let h = &p.controls_bar[k];
        let (u_bar, tape_bar, weight) = if p.unit { (&p.ones, &p.tape_bar[0], Some(&h[..])) } else { (h, &p.tape_bar[k], None) };
        let pass = PolicyPass { packed: weights.packed(), at, x: rollout.inputs() };
        let record = PolicyRecord { tape: &rollout.tape, u_bar, tape_bar, weight };
        policy.param_gradient(pass, record, &mut p.scratch, theta_bar);
    }
}

/// Bytes of a vector of vectors on the heap, if none has room to spare.
fn nested_bytes<T>(rows: &[Vec<T>]) -> usize {
    size_of_val(rows) + rows.iter().map(|row| size_of_val(&row[..])).sum::<usize>()
}

/// What stays the same throughout one reverse pass.
struct Pass<'a, T, P, F: Float> {
    task: &'a T,
    policy: &'a P,
    weights: &'a Weights<F>,
    rollout: &'a Rollout<F>,
    scale: F,
}

impl<F: Float> PolicyAdjoint<F> {
    fn stored_bytes(&self) -> usize {
        let flat = size_of_val(&self.inputs_bar[..]) + size_of_val(&self.ones[..]) + size_of_val(&self.scratch[..]);
        flat + nested_bytes(&self.controls_bar) + nested_bytes(&self.tape_bar)
    }

    /// The policy's cotangents of flow `k` in the columns `at`; `∂N/∂x` only if `through_inputs`.
    fn backward<T, P: Policy>(&mut self, pass: &Pass<'_, T, P, F>, k: usize, at: PolicyColumns, through_inputs: bool) {
        let columns = PolicyPass { packed: pass.weights.packed(), at, x: pass.rollout.inputs() };
        let u_bar = if self.unit { &self.ones } else { &self.controls_bar[k] };
        let x_bar = through_inputs.then_some(&mut self.inputs_bar[..]);
        pass.policy.backward(columns, &pass.rollout.tape, u_bar, &mut self.tape_bar[k], x_bar);
    }
}

impl<F: Float, const K: usize> Recursion<F, K> {
    fn new(rollout: &Rollout<F>) -> Self {
        let (n, m) = (rollout.state_dim, rollout.control_dim);
        let blocks = rollout.capacity().div_ceil(WIDTH);
        let columns = |len: usize| vec![Columns([Lane::zero(); K]); len];
        let lanes = |len: usize| vec![Lane::zero(); len];
        Self {
            lambda: columns(blocks * n),
            x_bar: columns(blocks * n),
            u_bar: columns(blocks * m),
            cost_x: lanes(n),
            cost_u: lanes(m),
        }
    }

    fn stored_bytes(&self) -> usize {
        let columns = [&self.lambda, &self.x_bar, &self.u_bar].map(|columns| size_of_val(&columns[..]));
        let costs = [&self.cost_x, &self.cost_u].map(|costs| size_of_val(&costs[..]));
        columns.into_iter().chain(costs).sum()
    }

    /// The recursion at the head of this file, for the flows side by side. `norms` has a row for each flow, or none.
    fn run<T: Task, P: Policy>(
        &mut self,
        pass: &Pass<'_, T, P, F>,
        flows: [Flow; K],
        policy: &mut PolicyAdjoint<F>,
        norms: &mut [Vec<f64>],
    ) -> Result<(), Divergence> {
        let Pass { task, rollout, scale, .. } = *pass;
        let (n, m) = (rollout.state_dim, rollout.control_dim);
        let last = rollout.states_at(rollout.horizon);
        for (lambda, x) in self.lambda.chunks_exact_mut(n).zip(last.chunks_exact(n)) {
            task.terminal_cost_gradient(x, &mut self.cost_x);
            for (lambda, &x_bar) in lambda.iter_mut().zip(&self.cost_x) {
                *lambda = Columns([x_bar * Lane::splat(scale); K]);
            }
        }
        self.note_norms(rollout, rollout.horizon, scale, norms);
        for t in (0..rollout.horizon).rev() {
            let at = rollout.columns(t);
            let mut finite = true;
            dispatch_narrow(Back { task, flows, rollout, t, scale, carried: self, finite: &mut finite });
            if !finite {
                return Err(self.divergence(flows, rollout, t));
            }
            for (k, flow) in flows.into_iter().enumerate() {
                gather(&self.u_bar, |h, lane| h.0[k].lane(lane), m, at, &mut policy.controls_bar[k]);
                if flow.control {
                    if !policy.unit {
                        policy.backward(pass, k, at, true);
                    }
                    self.add_inputs(k, at, n, policy);
                }
            }
            self.note_norms(rollout, t, scale, norms);
        }
        Ok(())
    }

    /// Notes the length of λ at step `t`, in f64: a square of an f32 overflows long before the f32 does.
    fn note_norms(&self, rollout: &Rollout<F>, t: usize, scale: F, norms: &mut [Vec<f64>]) {
        let lambda = |k: usize, sample: usize| {
            let block = &self.lambda[sample / WIDTH * rollout.state_dim..][..rollout.state_dim];
            block.iter().map(move |c| c.0[k].lane(sample % WIDTH).as_())
        };
        for (k, norms) in norms.iter_mut().enumerate() {
            let squares: f64 = (0..rollout.samples).flat_map(|sample| lambda(k, sample)).map(|x: f64| x * x).sum();
            norms[t] = (squares / rollout.samples as f64).sqrt() / scale.as_();
        }
    }

    /// `λ ← λ + (∂N/∂x)ᵀ h` in column `k`.
    fn add_inputs(&mut self, k: usize, at: PolicyColumns, n: usize, policy: &PolicyAdjoint<F>) {
        for (block, lambda) in self.lambda.chunks_exact_mut(n).take(at.count.div_ceil(WIDTH)).enumerate() {
            for lane in 0..WIDTH {
                let sample = (block * WIDTH + lane).min(at.count - 1);
                let c = at.first + sample * at.step;
                // A unit cotangent's result is still to be multiplied by the control's own.
                let factor = if policy.unit { policy.controls_bar[k][c] } else { F::one() };
                for (lambda, &x_bar) in lambda.iter_mut().zip(&policy.inputs_bar[c * n..][..n]) {
                    lambda.0[k].0[lane] += x_bar * factor;
                }
            }
        }
    }

    /// The first flow, and in it the first sample, whose state or control cotangent is not finite.
    #[cold]
    fn divergence(&self, flows: [Flow; K], rollout: &Rollout<F>, step: usize) -> Divergence {
        let find = |columns: &[Columns<Lane<F>, K>], n: usize, k: usize| {
            find_non_finite(columns, n, rollout.samples, |c, lane| c.0[k].lane(lane))
        };
        let state = |k: usize| find(&self.lambda, rollout.state_dim, k).map(|place| (k, Variable::State, place));
        let control = |k: usize| find(&self.u_bar, rollout.control_dim, k).map(|place| (k, Variable::Control, place));
        let first = (0..K).find_map(|k| state(k).or_else(|| control(k)));
        let (k, variable, (sample, component)) = first.expect("the probe saw one of them");
        Divergence::Cotangent { flow: flows[k], variable, step, sample, component }
    }
}

/// One step back, of all blocks: costs, physics, and whether the result is finite.
struct Back<'a, T, F: Float, const K: usize> {
    task: &'a T,
    flows: [Flow; K],
    rollout: &'a Rollout<F>,
    t: usize,
    scale: F,
    carried: &'a mut Recursion<F, K>,
    finite: &'a mut bool,
}

impl<T: Task, F: Float, const K: usize> Vectorized for Back<'_, T, F, K> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { task, flows, rollout, t, carried: r, .. } = self;
        let system = task.system();
        let (n, m) = (rollout.state_dim, rollout.control_dim);
        let (states, next, controls) = (rollout.states_at(t), rollout.states_at(t + 1), rollout.controls_at(t));
        let scale = Lane::splat(self.scale);
        let through_physics = flows.iter().any(|flow| flow.physics);
        let mut probe = Columns([Lane::<F>::zero(); K]);
        for block in 0..states.len() / n {
            let (x, next) = (&states[block * n..][..n], &next[block * n..][..n]);
            let u = &controls[block * m..][..m];
            let lambda = &mut r.lambda[block * n..][..n];
            let x_bar = &mut r.x_bar[block * n..][..n];
            let u_bar = &mut r.u_bar[block * m..][..m];

            task.stage_cost_gradient(next, u, &mut r.cost_x, &mut r.cost_u);
            for (lambda, &cost) in lambda.iter_mut().zip(&r.cost_x) {
                *lambda += Columns([cost * scale; K]);
            }
            if through_physics {
                system.vjp(x, u, lambda, x_bar, u_bar);
            } else {
                system.vjp_control(x, u, lambda, u_bar);
            }
            for (u_bar, &cost) in u_bar.iter_mut().zip(&r.cost_u) {
                *u_bar += Columns([cost * scale; K]);
                probe += *u_bar * Lane::zero();
            }
            for (lambda, &x_bar) in lambda.iter_mut().zip(&*x_bar) {
                for (k, flow) in flows.iter().enumerate() {
                    lambda.0[k] = if flow.physics { x_bar.0[k] } else { Lane::zero() };
                }
                probe += *lambda * Lane::zero();
            }
        }
        *self.finite = probe.0.iter().all(|p| p.0.iter().all(|&p| p == F::zero()));
    }
}

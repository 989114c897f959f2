//! [`GraphTask`] and [`GraphSystem`]: equations, or a recorded task, as a task and its system.

use super::equations::{Costs, EquationError, Equations, Functions, Operations};
use super::function::Function;
use super::op::Graph;
use super::parts::Parts;
use super::record::{Branches, Recorded, record};
use crate::dynamics::cause::Cause;
use crate::dynamics::inputs::{Cotangents, Inputs, OdeInputs, Start};
use crate::dynamics::integrator::{AnyIntegrator, Integrator as _};
use crate::dynamics::number::{Number, Varied};
use crate::dynamics::ode::Ode;
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::rng::{Purpose, Rng, stream};
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use rand_distr::{Distribution as _, StandardNormal};
use smallvec::SmallVec;
use std::sync::Arc;

type StartFn = dyn Fn(&mut Rng, Start<'_>) + Send + Sync;

/// A task whose system, observation and costs are graphs.
#[derive(Clone)]
pub struct GraphTask {
    system: GraphSystem,
    parts: Parts,
    start: Arc<StartFn>,
    params: usize,
    horizon: usize,
    control_bounds: Option<Vec<[f64; 2]>>,
    /// Time of one step of the task, s.
    dt: f64,
    /// Steps of the system per step of the task.
    substeps: usize,
    /// None for a recorded task.
    operations: Option<Operations>,
}

/// System of a [`GraphTask`].
#[derive(Clone)]
pub struct GraphSystem {
    states: usize,
    controls: usize,
    /// Parameters that the graph reads, the last entries of `p`.
    params: usize,
    /// Numbers that vary, with their indices among these parameters.
    varied: Vec<Varied>,
    motion: Arc<Function>,
    /// Method and velocities of rates; None if the graph gives next states.
    rate: Option<(AnyIntegrator, Arc<[Option<usize>]>)>,
    /// Time of one step, s.
    dt: f64,
    tables: Arc<[Vec<f64>]>,
    /// Steps per value of a table.
    steps_per_value: usize,
}

/// Why a task cannot be recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RecordError {
    /// Code branches on values, as iterative solvers and adaptive integrators do.
    #[error(
        "the code branches on values (`any_lt`), which a graph cannot; use a fixed number of iterations"
    )]
    Branches,
    /// The step, the observation or the cost depends on the step number.
    #[error(
        "the step, the observation or the cost depends on the step number `t`: at t = {step} it differs from t = 0. Write the \
         equations as `Equations` with tables, or use the task itself"
    )]
    DependsOnStep {
        /// A step at which it differs from step 0.
        step: usize,
    },
    /// There are too many numbers at once.
    #[error("there are more than 65,535 numbers at once")]
    TooLarge,
}

impl GraphTask {
    /// Task of these equations.
    ///
    /// Rates are discretized by `method`, with `substeps` steps per time step. They are fixed for
    /// equations that give the next states, where `substeps` must be 1.
    ///
    /// # Errors
    /// An expression does not fit, or a number has no valid value. The error has the key of the
    /// setting.
    pub fn new(
        equations: &Equations,
        costs: &Costs,
        method: AnyIntegrator,
        substeps: usize,
        horizon: usize,
    ) -> Result<Self, EquationError> {
        let Functions { motion, velocities, observe, running, terminal, margin, operations } =
            equations.functions(costs)?;
        if substeps != 1 && !equations.is_continuous() {
            let what = format!(
                "gives the state after a whole step, but there are {substeps} substeps; write `rate`"
            );
            return Err(EquationError::new("next", what));
        }
        let start: Vec<Number> = equations
            .states
            .iter()
            .map(|state| equations.start.get(state).copied().unwrap_or(Number::Fixed(0.0)))
            .collect();
        let varied = equations.parameters.iter().filter(|(_, number)| !number.is_fixed());
        let varied: Vec<Varied> = varied
            .enumerate()
            .map(|(index, (name, &number))| Varied {
                index,
                name: format!("parameters.{name}"),
                number,
            })
            .collect();
        let unbounded = [f64::NEG_INFINITY, f64::INFINITY];
        let bounds = equations
            .controls
            .iter()
            .map(|control| equations.bounds.get(control).copied().unwrap_or(unbounded));
        let system = GraphSystem {
            states: equations.states.len(),
            controls: equations.controls.len(),
            params: varied.len(),
            varied,
            motion: Arc::new(motion),
            rate: equations.is_continuous().then(|| (method, velocities.into())),
            dt: equations.dt / substeps as f64,
            tables: equations.tables.values().cloned().collect(),
            steps_per_value: substeps,
        };
        Ok(Self {
            parts: Parts {
                observe: observe.map(Arc::new),
                running: running.map(Arc::new),
                terminal: terminal.map(Arc::new),
                margin: margin.map(Arc::new),
            },
            start: Arc::new(move |rng, Start { x, .. }| {
                x.iter_mut().zip(&start).for_each(|(x, number)| *x = number.draw(rng));
            }),
            params: system.params,
            horizon,
            control_bounds: (!equations.bounds.is_empty()).then(|| bounds.collect()),
            dt: equations.dt,
            substeps,
            operations: Some(operations),
            system,
        })
    }

    /// Records a task. Values of the graph have the bits of the task.
    ///
    /// # Errors
    /// The code branches on values or depends on the step number.
    pub fn of<T: Task + Clone + 'static>(task: &T) -> Result<Self, RecordError> {
        let system = task.system();
        let recorder = Recorder {
            dims: [system.state_dim(), system.control_dim(), task.param_dim(), system.state_dim()],
        };
        let motion = recorder.function(|inputs, _| {
            let mut next = inputs.x.to_vec();
            system.step(inputs, &mut next);
            next
        })?;
        let observe = task.observation_dim().map(|dim| {
            recorder.function(|inputs, _| {
                let mut y = vec![Recorded::zero(); dim];
                task.observe(Inputs { u: &[], ..inputs }, &mut y);
                y
            })
        });
        let running = recorder.function(|inputs, next| vec![task.running_cost(inputs, next)])?;
        let terminal =
            recorder.function(|Inputs { x, p, .. }, _| vec![task.terminal_cost(x, p)])?;
        let margin = task
            .can_end()
            .then(|| recorder.function(|Inputs { x, p, .. }, _| vec![task.margin(x, p)]));
        let margin = margin.transpose()?;
        let [states, controls, params, _] = recorder.dims;
        let system = GraphSystem {
            states,
            controls,
            params,
            varied: system.varied(params),
            motion,
            rate: None,
            dt: 1.0,
            tables: Arc::default(),
            steps_per_value: 1,
        };
        let own = task.clone();
        let graph = Self {
            parts: Parts {
                observe: observe.transpose()?,
                running: Some(running),
                terminal: Some(terminal),
                margin,
            },
            start: Arc::new(move |rng, start| own.start(rng, start)),
            params,
            horizon: task.horizon(),
            control_bounds: task.control_bounds(),
            dt: 1.0,
            substeps: 1,
            operations: None,
            system,
        };
        match graph.first_difference(task) {
            Some(step) => Err(RecordError::DependsOnStep { step }),
            None => Ok(graph),
        }
    }

    /// First step up to the horizon at which the recorded task has other values than the graph. Each
    /// step has the same states and controls, near initial states of the task.
    fn first_difference<T: Task>(&self, task: &T) -> Option<usize> {
        const CASES: u64 = 4;
        let [n, m] = [self.system.states, self.system.controls];
        let case = |case: u64| {
            let mut rng = stream(case, Purpose::Check, 0);
            let mut normal = |len: usize| {
                (0..len).map(|_| StandardNormal.sample(&mut rng)).collect::<Vec<f64>>()
            };
            let [u, noise, next, trained] = [m, n, n, self.params].map(&mut normal);
            let (mut x, mut p) = (vec![0.0; n], vec![0.0; self.params]);
            task.draw_start(&mut rng, Start { x: &mut x, p: &mut p });
            x.iter_mut().zip(noise).for_each(|(x, noise)| *x += case as f64 * noise);
            p.iter_mut().zip(trained).filter(|(p, _)| p.is_nan()).for_each(|(p, drawn)| *p = drawn);
            [x, u, p, next]
        };
        let cases = Vec::from_iter((0..CASES).map(case));
        let differs = |t: usize| {
            cases.iter().any(|[x, u, p, next]| {
                let inputs = Inputs { x, u, p, t };
                let (own, other) = (values(self, inputs, next), values(task, inputs, next));
                own.iter().zip(&other).any(|(a, b)| a != b && !(a.is_nan() && b.is_nan()))
            })
        };
        (0..=self.horizon).find(|&t| differs(t))
    }

    /// Number of operations of the equations. None for a recorded task.
    pub fn operations(&self) -> Option<Operations> {
        self.operations
    }

    /// The time and the values of tables at a step of the task.
    fn signals<T: Scalar>(&self, t: usize) -> Signals<T> {
        self.system.signals_at(T::from(t as f64 * self.dt), t * self.substeps)
    }
}

/// Next state, observation and running cost.
fn values<T: Task>(task: &T, inputs: Inputs<'_, f64>, next: &[f64]) -> Vec<f64> {
    let (n, observed) = (inputs.x.len(), task.observation_dim().unwrap_or(0));
    let mut values = vec![0.0; n + observed];
    let (after, y) = values.split_at_mut(n);
    task.system().step(inputs, after);
    if observed > 0 {
        task.observe(Inputs { u: &[], ..inputs }, y);
    }
    values.push(task.running_cost(inputs, next));
    values
}

/// Records functions of state, control, parameters and next state, of these lengths.
struct Recorder {
    dims: [usize; 4],
}

impl Recorder {
    fn function(
        &self,
        outputs: impl Fn(Inputs<'_, Recorded>, &[Recorded]) -> Vec<Recorded>,
    ) -> Result<Arc<Function>, RecordError> {
        let [n, m, k, _] = self.dims;
        let at = |t: usize| {
            let mut graph = Graph::new(self.dims.iter().sum());
            let outputs = record(&mut graph, |all| {
                let (x, rest) = all.split_at(n);
                let (u, rest) = rest.split_at(m);
                let (p, next) = rest.split_at(k);
                outputs(Inputs { x, u, p, t }, next)
            });
            let ids = |outputs: Vec<Recorded>| outputs.iter().map(|number| number.0).collect();
            outputs.map(|outputs| (graph, ids(outputs))).map_err(|Branches| RecordError::Branches)
        };
        let ((graph, outputs), (later, other)): ((_, Vec<_>), (Graph, Vec<_>)) = (at(0)?, at(1)?);
        if graph.structure(&outputs) != later.structure(&other) {
            return Err(RecordError::DependsOnStep { step: 1 });
        }
        let lengths = [n, m, k, n, 0];
        Function::new(graph, outputs, lengths).map(Arc::new).map_err(|_| RecordError::TooLarge)
    }
}

/// A step of a system with more numbers allocates.
type Signals<T> = SmallVec<[T; 16]>;

impl GraphSystem {
    /// The time at the beginning of a step, and the values of tables.
    #[inline(always)]
    fn signals<T: Scalar>(&self, step: usize) -> Signals<T> {
        self.signals_at(T::from(step as f64 * self.dt), step)
    }

    #[inline(always)]
    fn signals_at<T: Scalar>(&self, time: T, step: usize) -> Signals<T> {
        let row = step / self.steps_per_value;
        let values = self.tables.iter().map(|table| T::from(table[row.min(table.len() - 1)]));
        std::iter::once(time).chain(values).collect()
    }

    /// The rates at a step.
    fn field(&self, step: usize) -> Field<'_> {
        Field { system: self, step }
    }

    /// The parameters of the graph. A task may have further ones before them.
    #[inline(always)]
    fn own<'a, T>(&self, p: &'a [T]) -> &'a [T] {
        &p[p.len() - self.params..]
    }

    #[inline(always)]
    fn pull<R: Real, C: Cotangent<R>>(
        &self,
        Inputs { x, u, p, .. }: Inputs<'_, R, ()>,
        signals: &[R],
        output_bars: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let skipped = p.len() - self.params;
        let Cotangents { x: x_bar, u: u_bar, p: p_bar } = cotangents.skip_params(skipped);
        let lists = [x, u, &p[skipped..], &[], signals];
        self.motion.vjp(lists, output_bars, [x_bar, u_bar, p_bar, None]);
    }
}

impl System for GraphSystem {
    fn state_dim(&self) -> usize {
        self.states
    }

    fn control_dim(&self) -> usize {
        self.controls
    }

    fn param_dim(&self) -> usize {
        self.params
    }

    fn varied(&self, params: usize) -> Vec<Varied> {
        let first = params - self.params;
        let shifted = |varied: &Varied| Varied { index: first + varied.index, ..varied.clone() };
        self.varied.iter().map(shifted).collect()
    }

    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        let Inputs { x, u, p, t } = inputs;
        match &self.rate {
            Some((method, _)) => method.advance(&self.field(t), self.dt, inputs, next),
            None => self.motion.eval([x, u, self.own(p), &[], &self.signals(t)], next),
        }
    }

    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let Inputs { x, u, p, t } = inputs;
        match &self.rate {
            Some((method, _)) => {
                method.vjp(&self.field(t), self.dt, inputs, next_bar, cotangents);
            }
            None => {
                let inputs = Inputs { x, u, p, t: () };
                self.pull(inputs, &self.signals(t), next_bar, cotangents);
            }
        }
    }

    fn diagnose<R: Real>(&self, inputs: Inputs<'_, R>) -> Option<Cause> {
        let (method, _) = self.rate.as_ref()?;
        let field = self.field(inputs.t);
        let mut rate = vec![R::zero(); self.states];
        field.rate(inputs.continuous(self.dt), &mut rate);
        let singular = rate.iter().position(|rate| !rate.all_finite()).map(Cause::Rate);
        singular.or_else(|| method.unsolved(&field, self.dt, inputs).map(Cause::Unsolved))
    }
}

/// Rates of a [`GraphSystem`] during one step.
struct Field<'a> {
    system: &'a GraphSystem,
    /// Number of the step, for tables.
    step: usize,
}

impl Ode for Field<'_> {
    fn state_dim(&self) -> usize {
        self.system.states
    }

    fn control_dim(&self) -> usize {
        self.system.controls
    }

    fn param_dim(&self) -> usize {
        self.system.params
    }

    fn rate<T: Scalar>(&self, OdeInputs { x, u, p, t }: OdeInputs<'_, T>, rate: &mut [T]) {
        let signals = self.system.signals_at(t, self.step);
        self.system.motion.eval([x, u, self.system.own(p), &[], &signals], rate);
    }

    fn rate_vjp<R: Real, C: Cotangent<R>>(
        &self,
        OdeInputs { x, u, p, t }: OdeInputs<'_, R>,
        rate_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let signals = self.system.signals_at(t, self.step);
        self.system.pull(Inputs { x, u, p, t: () }, &signals, rate_bar, cotangents);
    }

    fn velocity(&self, i: usize) -> Option<usize> {
        self.system.rate.as_ref().and_then(|(_, velocities)| velocities[i])
    }
}

impl Task for GraphTask {
    type System = GraphSystem;

    fn system(&self) -> &GraphSystem {
        &self.system
    }

    fn horizon(&self) -> usize {
        self.horizon
    }

    fn param_dim(&self) -> usize {
        self.params
    }

    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        (self.start)(rng, start);
    }

    fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        self.control_bounds.clone()
    }

    fn can_end(&self) -> bool {
        self.parts.margin.is_some()
    }

    fn margin<T: Scalar>(&self, x: &[T], p: &[T]) -> T {
        self.parts.margin(x, p)
    }

    fn observation_dim(&self) -> Option<usize> {
        self.parts.observations()
    }

    fn observe<T: Scalar>(&self, inputs: Inputs<'_, T>, y: &mut [T]) {
        self.parts.observe(inputs, &self.signals(inputs.t), y);
    }

    fn observe_vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        y_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        self.parts.observe_vjp(inputs, &self.signals(inputs.t), y_bar, &mut cotangents);
    }

    fn running_cost<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &[T]) -> T {
        self.parts.running_cost(inputs, next, &self.signals(inputs.t))
    }

    fn terminal_cost<T: Scalar>(&self, x: &[T], p: &[T]) -> T {
        self.parts.terminal_cost(x, p)
    }

    fn running_cost_gradient<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        next: &[R],
        cotangents: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        let signals = self.signals(inputs.t);
        self.parts.running_cost_gradient(inputs, next, &signals, cotangents, next_bar);
    }

    fn terminal_cost_gradient<R: Real>(
        &self,
        x: &[R],
        p: &[R],
        x_bar: &mut [R],
        p_bar: Option<&mut [R]>,
    ) {
        self.parts.terminal_cost_gradient(x, p, x_bar, p_bar);
    }
}

//! Recorded tasks have the bits of the tasks in Rust, and derivatives that agree with those by hand.

use physgrad::graph::{GraphTask, RecordError};
use physgrad::integrator::RungeKutta;
use physgrad::policy::Mlp;
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::scalar::Single;
use physgrad::tasks::{
    CartDamping, CartPole, CartPoleSystem, DryFriction, Guidance, Lqr, MultiPendulum, PoleDamping,
    SteadyWind, Upright,
};
use physgrad::{
    Cotangents, Float, Forced, Inputs, Integrated, Number, Real, Scalar, Start, System, Task,
    Trainer, Training,
};
use rand::RngExt as _;

/// Draws inputs of a task: x, u, p and the next state.
fn drawn<T: Task>(task: &T, rng: &mut Rng) -> [Vec<f64>; 4] {
    let system = task.system();
    let mut x = vec![0.0; system.state_dim()];
    let mut p = vec![0.0; task.param_dim()];
    task.draw_start(rng, Start { x: &mut x, p: &mut p });
    x.iter_mut().for_each(|x| *x += rng.random_range(-1.0..1.0));
    let next = x.iter().map(|x| x + rng.random_range(-0.1..0.1)).collect();
    let u = (0..system.control_dim()).map(|_| rng.random_range(-5.0..5.0)).collect();
    [x, u, p, next]
}

/// Next state, observation and costs.
fn values<T: Task, R: Scalar>(task: &T, [x, u, p, next]: [&[R]; 4]) -> Vec<R> {
    let inputs = Inputs { x, u, p, t: 0 };
    let mut values = vec![R::zero(); x.len()];
    task.system().step(inputs, &mut values);
    let mut y = vec![R::zero(); task.observation_dim().unwrap_or(0)];
    if !y.is_empty() {
        task.observe(Inputs { u: &[], ..inputs }, &mut y);
    }
    values.extend(y);
    values.extend([task.running_cost(inputs, next), task.terminal_cost(x, p)]);
    values
}

/// Cotangents of step, observation and costs.
fn cotangents<T: Task>(task: &T, [x, u, p, next]: [&[f64]; 4], bars: &[f64]) -> Vec<f64> {
    let inputs = Inputs { x, u, p, t: 0 };
    let (mut x_bar, mut u_bar) = (vec![0.0; x.len()], vec![0.0; u.len()]);
    let (mut p_bar, mut next_bar) = (vec![0.0; p.len()], vec![0.0; x.len()]);
    macro_rules! all {
        () => {
            Cotangents { x: Some(&mut x_bar), u: Some(&mut u_bar), p: Some(&mut p_bar) }
        };
    }
    task.system().vjp(inputs, &bars[..x.len()], all!());
    if let Some(dim) = task.observation_dim() {
        task.observe_vjp(
            Inputs { u: &[], ..inputs },
            &bars[..dim],
            Cotangents { x: Some(&mut x_bar), u: None, p: Some(&mut p_bar) },
        );
    }
    task.running_cost_gradient(inputs, next, all!(), &mut next_bar);
    task.terminal_cost_gradient(x, p, &mut x_bar, Some(&mut p_bar));
    [x_bar, u_bar, p_bar, next_bar].concat()
}

fn in_f32(numbers: &[f64]) -> Vec<Single<f32>> {
    numbers.iter().map(|&number| Single::from(number)).collect()
}

fn compare<T: Task + Clone + 'static>(name: &str, task: T) {
    let graph = GraphTask::of(&task).unwrap_or_else(|error| panic!("{name}: {error}"));
    let mut rng = stream(0, Purpose::Check, 0);
    for _ in 0..20 {
        let [x, u, p, next] = drawn(&task, &mut rng);
        let lists = [&x[..], &u, &p, &next];
        let (by_hand, recorded) = (values(&task, lists), values(&graph, lists));
        let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&by_hand), bits(&recorded), "{name}, f64");
        let single = lists.map(in_f32);
        let lists_f32 = [&single[0][..], &single[1], &single[2], &single[3]];
        let of = |values: Vec<Single<f32>>| {
            values.iter().map(|value| value.lane(0).to_bits()).collect::<Vec<_>>()
        };
        assert_eq!(of(values(&task, lists_f32)), of(values(&graph, lists_f32)), "{name}, f32");
        let bars: Vec<f64> = (0..x.len().max(64)).map(|_| rng.random_range(-1.0..1.0)).collect();
        let (by_hand, recorded) =
            (cotangents(&task, lists, &bars), cotangents(&graph, lists, &bars));
        let size = by_hand.iter().fold(1.0, |size: f64, number| size.max(number.abs()));
        for (i, (a, b)) in by_hand.iter().zip(&recorded).enumerate() {
            assert!((a - b).abs() <= 1e-13 * size, "{name}, cotangent {i}: {a} and {b}");
        }
    }
}

#[test]
fn recorded_tasks_have_the_bits_of_the_tasks_and_their_derivatives_to_1e_13() {
    for poles in [1, 4] {
        compare("cart_pole", CartPole::new(poles));
    }
    let system = CartPoleSystem {
        poles: 2,
        cart_mass: Number::Uniform { low: 0.5, high: 2.0 },
        ..CartPoleSystem::default()
    };
    let effects = (
        PoleDamping::default(),
        CartDamping::default(),
        DryFriction::default(),
        SteadyWind { speed: 4.0.into(), ..SteadyWind::default() },
    );
    compare("cart_pole with effects", CartPole::with_system(Forced { system, effects }));
    compare("guidance", Guidance::new(2, 4));
    compare("lqr", Lqr::upright_cart_pole());
    compare("double_pendulum", Upright::double_pendulum().held());
    compare("pole_chain", Upright::pole_chain(3).held());
    let Upright { first_angle, from, spread, loss, control_weight, control_bound, horizon, .. } =
        Upright::double_pendulum();
    let system =
        Integrated { ode: MultiPendulum::default(), integrator: RungeKutta::RK4, dt: 0.01 };
    compare(
        "pendulum",
        Upright { system, first_angle, from, spread, loss, control_weight, control_bound, horizon },
    );
}

/// Halves its state until all samples are below 1.
#[derive(Clone)]
struct Halved;

impl System for Halved {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        0
    }
    fn step<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0];
        while T::any_lt(T::one(), next[0]) {
            next[0] = T::select_lt(T::one(), next[0], next[0] * 0.5, next[0]);
        }
    }
}

/// Adds the number of the step.
#[derive(Clone)]
struct Counting;

impl System for Counting {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        0
    }
    fn step<T: Scalar>(&self, Inputs { x, t, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] + if t < 7 { 0.0 } else { 1.0 };
    }
}

macro_rules! of_one_state {
    ($($system:ident),+) => {$(
        impl Task for $system {
            type System = Self;
            fn system(&self) -> &Self {
                self
            }
            fn horizon(&self) -> usize {
                10
            }
            fn start(&self, _: &mut Rng, _: Start<'_>) {}
        }
    )+};
}
of_one_state!(Halved, Counting);

#[test]
fn code_that_branches_on_values_or_depends_on_the_step_is_refused() {
    assert_eq!(GraphTask::of(&Halved).map(drop), Err(RecordError::Branches));
    assert_eq!(GraphTask::of(&Counting).map(drop), Err(RecordError::DependsOnStep { step: 7 }));
}

#[test]
fn trainings_of_recorded_tasks_print_the_digits_of_the_tasks() {
    fn losses<F: Float>(task: impl Task) -> Vec<String> {
        let training =
            Training { epochs: 10, train_samples: 64, test_samples: 64, ..Training::default() };
        let (n, m) = (task.system().state_dim(), task.system().control_dim());
        let trainer = Trainer::new(task, Mlp::new([n, 16, m])).precision::<F>().training(training);
        let records = trainer.run().expect("a training").records;
        records.iter().map(|record| format!("{:.4}", record.test_loss)).collect()
    }
    fn compare<T: Task + Clone + 'static>(task: T) {
        let graph = GraphTask::of(&task).expect("a task of straight lines");
        assert_eq!(losses::<f64>(graph.clone()), losses::<f64>(task.clone()));
        assert_eq!(losses::<f32>(graph), losses::<f32>(task));
    }
    compare(CartPole::new(2));
    compare(Guidance::new(1, 2));
}

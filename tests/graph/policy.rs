//! Controllers as expressions: values against a loop and a known optimum, derivatives against dual
//! numbers, errors.

use physgrad::graph::{Controller, Costs, Equations, GraphPolicy, GraphTask};
use physgrad::integrator::{AnyIntegrator, RungeKutta};
use physgrad::policy::{
    Action, Bounded, Constant, Conv, DynPolicy, Elman, Gru, Linear, Mlp, Observed, OpenLoop,
    Policy, PolicyPass, PolicyRecord, Sizes, Sum,
};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::tasks::Lqr;
use physgrad::{
    Float, Number, Rollout, Scalar, System as _, Task, Trainer, Training, Weights, check,
    initial_states,
};

fn owned(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

fn texts<const N: usize>(all: [(&str, &str); N]) -> std::collections::BTreeMap<String, String> {
    all.into_iter().map(|(name, text)| (name.to_owned(), text.to_owned())).collect()
}

const KP: Number = Number::Trained { start: 2.0, min: 0.0, max: f64::INFINITY };
const KI: Number = Number::Trained { start: 0.1, min: -1.0, max: 1.0 };

/// Proportional and integral feedback of the level h of a tank.
fn pi(kp: Number, ki: Number) -> GraphPolicy {
    let controller = Controller {
        control: texts([("pump", "kp * e + ki * integral")]),
        next: texts([("integral", "integral + dt * e")]),
        define: texts([("e", "0.3 - h")]),
        parameters: [("kp".to_owned(), kp), ("ki".to_owned(), ki)].into(),
    };
    GraphPolicy::new(&controller, &owned(&["h"]), &owned(&["pump"]), 0.1).expect("a controller")
}

/// A tank with an outlet, filled by a pump.
fn tank() -> GraphTask {
    let equations = Equations {
        states: owned(&["h"]),
        controls: owned(&["pump"]),
        dt: 0.1,
        start: [("h".to_owned(), Number::Uniform { low: 0.1, high: 0.2 })].into(),
        rate: texts([("h", "pump - 0.2 * sqrt(abs(h) + 0.01)")]),
        ..Equations::default()
    };
    let costs = Costs { running: "(next.h - 0.3)^2 + 0.001 * pump^2".into(), ..Costs::default() };
    let method = AnyIntegrator::RungeKutta(RungeKutta::RK4);
    GraphTask::new(&equations, &costs, method, 1, 200).expect("a task")
}

/// The controller of [`pi`], written by hand.
struct Loop;

impl Policy for Loop {
    fn observation_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn memory_dim(&self) -> usize {
        1
    }
    fn param_count(&self) -> usize {
        2
    }
    /// θ holds ki, then kp, in the order of their names.
    fn init(&self, _rng: &mut Rng, theta: &mut [f64]) {
        theta.copy_from_slice(&[0.1, 2.0]);
    }
    fn act<T: Scalar>(
        &self,
        theta: &[T],
        Observed { y, memory, .. }: Observed<'_, T>,
        action: Action<'_, T>,
    ) {
        let error = -y[0] + 0.3;
        action.u[0] = theta[1] * error + theta[0] * memory[0];
        action.memory[0] = memory[0] + error * 0.1;
    }
}

/// Costs of rollouts from these initial states, with the initial parameters of the policy.
fn costs(
    task: &impl Task,
    policy: &dyn physgrad::policy::AnyPolicy<f64>,
    starts: &[f64],
) -> Vec<f64> {
    let weights = Weights::init(policy, &mut stream(0, Purpose::Policy, 0));
    let samples = starts.len() / task.system().state_dim();
    let mut rollout = Rollout::new(task, policy, samples);
    rollout.start(starts);
    rollout.run(task, policy, &weights).expect("finite");
    (0..samples).map(|sample| rollout.cost(sample)).collect()
}

/// Parameters after a few epochs.
fn trained(policy: impl Policy + 'static) -> Vec<f64> {
    let training = Training { learning_rate: 0.01, ..Default::default() };
    let trainer = Trainer::new(tank(), policy).precision::<f64>().training(training).epochs(3);
    trainer.run().expect("a training").weights.theta().to_vec()
}

#[test]
fn a_pi_controller_equals_the_loop_written_by_hand() {
    let free = |start| Number::Trained { start, min: f64::NEG_INFINITY, max: f64::INFINITY };
    let controller = pi(free(2.0), free(0.1));
    let task = tank();
    let starts: Vec<f64> = initial_states(&task, 0, Purpose::Test, 5);
    let losses = |policy: &dyn physgrad::policy::AnyPolicy<f64>| costs(&task, policy, &starts);
    assert_eq!(losses(&controller), losses(&Loop));
    assert_eq!(losses(&controller), losses(&pi(2.0.into(), 0.1.into())), "given gains");
    assert_ne!(losses(&controller), losses(&pi(2.0.into(), 0.2.into())), "another gain");
    let (found, expected) = (trained(controller), trained(Loop));
    assert!((found[1] - 2.0).abs() > 0.01, "the gains move: {found:?}");
    for (found, expected) in found.iter().zip(&expected) {
        assert!((found - expected).abs() < 1e-12, "{found} instead of {expected}");
    }
}

#[test]
fn a_regulator_as_equations_has_the_loss_of_the_riccati_solution() {
    let lqr = Lqr::spring();
    let gain = lqr.optimum().gain.clone();
    let starts: Vec<f64> = initial_states(&lqr, 0, Purpose::Test, 16);
    let loss = |factor: f64| {
        let [a, b] = [gain[0] * factor, gain[1]];
        let controller = Controller {
            control: texts([("force", "a * x + b * x_dot")]),
            parameters: [("a".to_owned(), a.into()), ("b".to_owned(), b.into())].into(),
            ..Controller::default()
        };
        let names = (owned(&["x", "x_dot"]), owned(&["force"]));
        let policy = GraphPolicy::new(&controller, &names.0, &names.1, 0.1).expect("a controller");
        costs(&lqr, &policy, &starts).iter().sum::<f64>() / 16.0
    };
    let least = lqr.least_loss(&starts);
    assert!((loss(1.0) / least - 1.0).abs() < 1e-13, "{} instead of {least}", loss(1.0));
    for factor in [0.99, 1.01] {
        assert!(loss(factor) > least * (1.0 + 1e-8), "a gain off by 1 %: {}", loss(factor) / least);
    }
}

/// Every kind of policy for three observations and two controls, and combinations.
fn all() -> Vec<(&'static str, DynPolicy)> {
    let controller = |memory: bool| {
        let controller = Controller {
            control: texts([("u", "k * sin(a) + m * b - t"), ("v", "where(c < 0, d, a * k)")]),
            next: texts([("m", "tanh(m + a * b) + k * c")]),
            define: texts([("d", "c * c + dt")]),
            parameters: [("k".to_owned(), KI)].into(),
        };
        let controller = if memory {
            controller
        } else {
            let control = texts([("u", "k * a * b"), ("v", "c + d")]);
            Controller { control, next: texts([]), ..controller }
        };
        let names = (owned(&["a", "b", "c"]), owned(&["u", "v"]));
        DynPolicy::new(
            GraphPolicy::new(&controller, &names.0, &names.1, 0.1).expect("a controller"),
        )
    };
    let mlp = || DynPolicy::new(Mlp::new([3, 5, 2]));
    let gru = || DynPolicy::new(Gru::new(3, 4, 2));
    let ranges = [[-0.5, 1.5], [2.0, 3.0]];
    vec![
        ("mlp", mlp()),
        ("linear", DynPolicy::new(Linear::new(3, 2))),
        ("affine", DynPolicy::new(Linear::with_bias(3, 2))),
        ("gru", gru()),
        ("elman", DynPolicy::new(Elman::new(3, 4, 2))),
        ("conv", DynPolicy::new(Conv::new(9, 3))),
        ("open loop", DynPolicy::new(OpenLoop::new(3, 2, 5))),
        ("constant", DynPolicy::new(Constant::new(3, 2))),
        ("equations", controller(true)),
        ("equations without memory", controller(false)),
        ("bounds", DynPolicy::new(Bounded::between(mlp(), ranges))),
        ("bounds of equations", DynPolicy::new(Bounded::saturating(controller(true), ranges))),
        ("bounds of memory", DynPolicy::new(Bounded::saturating(gru(), ranges))),
        ("residual", DynPolicy::new(Sum::new(controller(false), mlp()))),
        ("first has a memory", DynPolicy::new(Sum::new(controller(true), mlp()))),
        ("second has a memory", DynPolicy::new(Sum::new(mlp(), gru()))),
        ("both have a memory", DynPolicy::new(Sum::new(gru(), controller(true)))),
        (
            "bounded sum of sums",
            DynPolicy::new(Bounded::between(
                DynPolicy::new(Sum::new(DynPolicy::new(Sum::new(gru(), mlp())), controller(true))),
                ranges,
            )),
        ),
    ]
}

#[test]
fn derivatives_of_every_kind_agree_with_dual_numbers() {
    for (name, policy) in all() {
        check::policy(&policy).unwrap_or_else(|failure| panic!("{name}: {failure}"));
    }
    check::policy(&pi(KP, KI)).unwrap();
    check::policy(&pi(2.0.into(), KI)).unwrap();
    check::policy(&pi(2.0.into(), 0.1.into())).expect("no trained numbers");
    check::task(&tank(), &pi(KP, KI)).unwrap();
    check::task(&tank(), &Sum::new(pi(KP, KI), Gru::new(1, 3, 1))).unwrap();
    check::task(&tank(), &Bounded::saturating(pi(KP, KI), [[0.0, 0.5]])).unwrap();
}

/// [`pi`] with a parameter gradient or an input cotangent that is wrong by 1 part in 1e9.
struct Wrong {
    policy: GraphPolicy,
    in_inputs: bool,
}

impl Policy for Wrong {
    fn observation_dim(&self) -> usize {
        self.policy.observation_dim()
    }
    fn control_dim(&self) -> usize {
        self.policy.control_dim()
    }
    fn memory_dim(&self) -> usize {
        self.policy.memory_dim()
    }
    fn param_count(&self) -> usize {
        self.policy.param_count()
    }
    fn init(&self, rng: &mut Rng, theta: &mut [f64]) {
        self.policy.init(rng, theta);
    }
    fn act<T: Scalar>(&self, theta: &[T], observed: Observed<'_, T>, action: Action<'_, T>) {
        self.policy.act(theta, observed, action);
    }
    fn sizes<F: Float>(&self, columns: usize) -> Sizes {
        self.policy.sizes::<F>(columns)
    }
    fn pack<F: Float>(&self, theta: &[F], packed: &mut [F]) {
        self.policy.pack(theta, packed);
    }
    fn forward<F: Float>(&self, pass: PolicyPass<F>, tape: &mut [F], u: &mut [F]) {
        self.policy.forward(pass, tape, u);
    }
    fn backward<F: Float>(
        &self,
        pass: PolicyPass<F>,
        tape: &[F],
        u_bar: &[F],
        tape_bar: &mut [F],
        mut x_bar: Option<&mut [F]>,
    ) {
        self.policy.backward(pass, tape, u_bar, tape_bar, x_bar.as_deref_mut());
        if let (true, Some(x_bar)) = (self.in_inputs, x_bar) {
            x_bar[0] *= F::from_f64(1.0 + 1e-9);
        }
    }
    fn param_gradient<F: Float>(
        &self,
        pass: PolicyPass<F>,
        record: PolicyRecord<F>,
        scratch: &mut [F],
        theta_bar: &mut [F],
    ) {
        self.policy.param_gradient(pass, record, scratch, theta_bar);
        if !self.in_inputs {
            theta_bar[1] *= F::from_f64(1.0 + 1e-9);
        }
    }
}

#[test]
fn the_check_finds_planted_faults() {
    for (in_inputs, place) in [(true, "x_bar"), (false, "theta_bar")] {
        let wrong = Wrong { policy: pi(KP, KI), in_inputs };
        let failure = check::policy(&wrong).expect_err("a planted fault").to_string();
        assert!(failure.contains(place), "{failure}");
    }
}

#[test]
fn any_policy_has_the_bits_of_the_policy() {
    assert_eq!(trained(pi(KP, KI)), trained(DynPolicy::new(pi(KP, KI))));
    assert_eq!(trained(Gru::new(1, 4, 1)), trained(DynPolicy::new(Gru::new(1, 4, 1))));
    let sum = Sum::new(OpenLoop::new(1, 1, 200), Mlp::new([1, 6, 1]));
    assert_eq!(trained(sum.clone()), trained(DynPolicy::new(sum)));
}

/// Controls of a policy without a memory for an observation of one component.
fn control(policy: impl Policy + 'static, y: f64) -> f64 {
    let policy = DynPolicy::new(policy);
    let weights = Weights::<f64>::init(&policy, &mut stream(0, Purpose::Policy, 0));
    physgrad::policy::controls(&policy, &weights, &[y])[0]
}

#[test]
fn bounds_keep_controls_within_their_range_and_leave_its_middle() {
    let identity = || {
        let controller = Controller { control: texts([("u", "y")]), ..Controller::default() };
        GraphPolicy::new(&controller, &owned(&["y"]), &owned(&["u"]), 1.0).expect("a controller")
    };
    let (low, high) = (10.0, 30.0);
    let between = |y| control(Bounded::between(identity(), [[low, high]]), y);
    let saturating = |y| control(Bounded::saturating(identity(), [[low, high]]), y);
    assert_eq!((between(0.0), saturating(20.0)), (20.0, 20.0));
    assert!((saturating(20.5) - 20.5).abs() < 1e-3);
    for y in [-1e9, -50.0, 0.0, 25.0, 1e9] {
        for u in [between(y), saturating(y)] {
            assert!((low..=high).contains(&u), "{u}");
        }
    }
    // Symmetric ranges have the bits of one bound.
    for y in [-0.0, 0.0, 0.3, -2.0] {
        let bits = |u: f64| u.to_bits();
        let expected = bits(control(Bounded::new(identity(), [0.7]), y));
        assert_eq!(bits(control(Bounded::between(identity(), [[-0.7, 0.7]]), y)), expected);
        assert_eq!(bits(control(Bounded::saturating(identity(), [[-0.7, 0.7]]), y)), expected);
    }
}

#[test]
fn errors_name_the_key_and_the_known_names() {
    let of = |control: &[(&str, &str)], more: Controller| {
        let control = control.iter().map(|&(name, text)| (name.to_owned(), text.to_owned()));
        let controller = Controller { control: control.collect(), ..more };
        GraphPolicy::new(&controller, &owned(&["h", "q"]), &owned(&["pump"]), 0.1)
            .map(|_| ())
            .expect_err("an error")
            .to_string()
    };
    let none = Controller::default;
    let number = |number| Controller { parameters: [("k".to_owned(), number)].into(), ..none() };
    let next = |name| Controller { next: texts([(name, "1")]), ..none() };
    for (found, expected) in [
        (of(&[], none()), "`control.pump` is missing"),
        (
            of(&[("valve", "1"), ("pump", "1")], none()),
            "`valve`, which is not a control; allowed: `pump`",
        ),
        (
            of(&[("pump", "2 * level")], none()),
            "column 5 of `2 * level`: `level` is unknown; known are `h`, `q`",
        ),
        (of(&[("pump", "next.h")], none()), "`next`"),
        (of(&[("pump", "pump")], none()), "`pump` is unknown"),
        (of(&[("pump", "h")], next("q")), "`q`, which is the name of another number"),
        (of(&[("pump", "h")], next("2q")), "is not a name"),
        (
            of(&[("pump", "k")], number(Number::Uniform { low: 0.0, high: 1.0 })),
            "`parameters.k` is drawn",
        ),
        (of(&[("pump", "k")], number(f64::NAN.into())), "`parameters.k` is not a finite number"),
        (
            of(&[("pump", "a")], Controller { define: texts([("a", "a")]), ..none() }),
            "depends on itself",
        ),
    ] {
        assert!(found.contains(expected), "{found} lacks {expected}");
    }
}

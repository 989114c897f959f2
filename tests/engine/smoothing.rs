//! Estimates from perturbed parameters equal formulas in closed form.

use approx::assert_relative_eq;
use physgrad::policy::{Constant, Mlp, Quadratic};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::tasks::{Accumulator, Bowl, CartPole, Reach};
use physgrad::train::{Estimator, OptimizerKind, Record, Session, Smoothing, vector_field};
use physgrad::{
    Clip, Cotangent, Cotangents, Field, Inputs, Policy, Real, Scalar, Start, System, Task,
    TrainError, Trainer, Training,
};
use rand_distr::{Distribution, StandardNormal};

const NOISE: f64 = 0.1;
const PAIRS: usize = 5;
const ALL: [Estimator; 4] = [
    Estimator::FirstOrder,
    Estimator::ZerothOrder,
    Estimator::InverseVariance,
    Estimator::AlphaOrder { tolerance: 3.0 },
];

fn training(estimator: Option<Estimator>) -> Training {
    Training {
        epochs: 1,
        train_samples: 1,
        test_samples: 1,
        rule: OptimizerKind::Sgd,
        learning_rate: 1.0,
        smoothing: estimator.map(|estimator| Smoothing { estimator, noise: NOISE, pairs: PAIRS }),
        ..Training::default()
    }
}

/// Parameters after one update of gradient descent with rate 1, and the record.
fn after_one_update<T: Task, P: Policy>(
    task: T,
    policy: P,
    theta: &[f64],
    estimator: Option<Estimator>,
) -> (Vec<f64>, Record) {
    let trainer = Trainer::new(task, policy)
        .precision::<f64>()
        .field(Field::regular())
        .training(training(estimator));
    let mut session = trainer.start_from(theta.to_vec()).session().expect("valid settings");
    let record = session.epoch().expect("finite").clone();
    (session.weights().theta().to_vec(), record)
}

/// Perturbations of an update.
fn perturbations(update: usize, params: usize) -> Vec<Vec<f64>> {
    let pair = |pair: usize| {
        let rng = &mut stream(0, Purpose::Perturb, (update * PAIRS + pair) as u64);
        (0..params).map(|_| StandardNormal.sample(rng)).collect()
    };
    (0..PAIRS).map(pair).collect()
}

/// Mean of vectors, and the variance of the mean, summed over the components.
fn moments(vectors: &[[f64; 2]]) -> ([f64; 2], f64) {
    let n = vectors.len() as f64;
    let mean = [0, 1].map(|i| vectors.iter().map(|v| v[i]).sum::<f64>() / n);
    let squares: f64 =
        vectors.iter().map(|v| (v[0] - mean[0]).powi(2) + (v[1] - mean[1]).powi(2)).sum();
    (mean, squares / (n * (n - 1.0)))
}

const THETA: [f64; 2] = [0.7, -0.4];

/// For a quadratic loss, the mean of the gradients at θ + σ ε and θ - σ ε is the gradient at θ.
#[test]
fn first_order_estimates_of_a_quadratic_loss_are_its_gradient() {
    let of = |estimator| after_one_update(Bowl::default(), Constant::new(2, 2), &THETA, estimator);
    let (exact, record) = of(None);
    assert_eq!(record.first_order, None);
    for estimator in [Estimator::FirstOrder, Estimator::InverseVariance] {
        let (theta, record) = of(Some(estimator));
        // The computation of a gradient of norm 3 has at most 20 rounding errors.
        exact.iter().zip(&theta).for_each(|(exact, theta)| {
            assert_relative_eq!(exact, theta, epsilon = 60.0 * f64::EPSILON)
        });
        assert_relative_eq!(record.first_order.expect("a weight"), 1.0, epsilon = 1e-12);
    }
}

/// Central differences of a quadratic loss are exact directional derivatives, for any σ. Their
/// expected product with ε is the gradient, since E[ε εᵀ] is the identity. Each update draws other
/// ε.
#[test]
fn zeroth_order_estimates_of_a_quadratic_loss_are_directional_derivatives_times_directions() {
    let training = Training { epochs: 3, ..training(Some(Estimator::ZerothOrder)) };
    let trainer =
        Trainer::new(Bowl::default(), Constant::new(2, 2)).precision::<f64>().training(training);
    let mut session = trainer.start_from(THETA.to_vec()).session().expect("valid settings");
    let mut before = THETA.to_vec();
    for update in 0..3 {
        let record = session.epoch().expect("finite");
        assert_eq!(record.first_order, Some(0.0));
        let exact = after_one_update(Bowl::default(), Constant::new(2, 2), &before, None).0;
        let gradient = [0, 1].map(|i| before[i] - exact[i]);
        let after = session.weights().theta().to_vec();
        for i in 0..2 {
            let term = |e: &Vec<f64>| (gradient[0] * e[0] + gradient[1] * e[1]) * e[i];
            let estimate = perturbations(update, 2).iter().map(term).sum::<f64>() / PAIRS as f64;
            // Losses up to 1000 have a rounding error of 1e-13. The division by σ = 0.1 amplifies
            // this error by 10.
            assert_relative_eq!(after[i], before[i] - estimate, epsilon = 1e-11);
        }
        before = after;
    }
}

/// Computes all estimates from losses and gradients at the perturbed parameters.
#[test]
fn estimates_of_a_polynomial_loss_equal_their_definitions() {
    let theta = [0.3, 0.2];
    let at = |theta: [f64; 2]| {
        vector_field::sample(&Reach::default(), &Quadratic, &Field::regular(), &[theta])
            .expect("finite")[0]
    };
    let (mut first, mut zeroth) = (Vec::new(), Vec::new());
    for e in perturbations(0, 2) {
        let [plus, minus] =
            [NOISE, -NOISE].map(|by| at([theta[0] + by * e[0], theta[1] + by * e[1]]));
        first.push([0, 1].map(|i| (plus.vector[i] + minus.vector[i]) / 2.0));
        zeroth.push([0, 1].map(|i| (plus.loss - minus.loss) / (2.0 * NOISE) * e[i]));
    }
    let ((g1, v1), (g0, v0)) = (moments(&first), moments(&zeroth));
    let kappa = v0 / (v0 + v1);
    let distance = (g1[0] - g0[0]).hypot(g1[1] - g0[1]);
    let alpha = |tolerance: f64| kappa.min((tolerance - 2.0 * v0.sqrt()) / distance).max(0.0);
    // Tolerances for which the weight is 0, is between 0 and κ, and is κ.
    let [low, middle, high] =
        [v0.sqrt(), 2.0 * v0.sqrt() + 0.5 * kappa * distance, 2.0 * v0.sqrt() + 2.0 * distance];
    assert_eq!((alpha(low), alpha(high)), (0.0, kappa));
    assert!(
        alpha(middle) > 0.1 * kappa && alpha(middle) < 0.9 * kappa && kappa > 0.1 && kappa < 1.0
    );
    for (estimator, weight) in [
        (Estimator::FirstOrder, 1.0),
        (Estimator::ZerothOrder, 0.0),
        (Estimator::InverseVariance, kappa),
        (Estimator::AlphaOrder { tolerance: low }, 0.0),
        (Estimator::AlphaOrder { tolerance: middle }, alpha(middle)),
        (Estimator::AlphaOrder { tolerance: high }, kappa),
    ] {
        let (found, record) =
            after_one_update(Reach::default(), Quadratic, &theta, Some(estimator));
        // The bound 1e-11 allows for roundings of sums over five pairs and a few more operations.
        assert_relative_eq!(record.first_order.expect("a weight"), weight, max_relative = 1e-11);
        let loss = (at(theta).loss, record.loss);
        assert!(
            loss.1.is_finite() && loss.0 != loss.1,
            "the loss is the mean at perturbed parameters"
        );
        for i in 0..2 {
            let estimate = weight * g1[i] + (1.0 - weight) * g0[i];
            assert_relative_eq!(
                found[i],
                theta[i] - estimate,
                max_relative = 1e-11,
                epsilon = 1e-12
            );
        }
    }
}

/// Cost of the control: a function of θ with a large slope or with none.
#[derive(Clone, Debug)]
enum Cost {
    /// sin(1e200 θ), with slopes up to 1e200.
    Steep,
    /// -1 below 0, else 1.
    Jump,
}

impl Task for Cost {
    type System = Accumulator;
    fn system(&self) -> &Accumulator {
        &Accumulator { dim: 1 }
    }
    fn horizon(&self) -> usize {
        1
    }
    fn start(&self, _: &mut Rng, start: Start<'_>) {
        start.x[0] = 0.0;
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        match self {
            Self::Steep => (x[0] * 1e200).sin(),
            Self::Jump => T::select_lt(x[0], T::from(0.0), T::from(-1.0), T::from(1.0)),
        }
    }
}

#[test]
fn a_variance_beyond_f64_leaves_the_zeroth_order_estimate() {
    let of =
        |estimator| after_one_update(Cost::Steep, Constant::new(1, 1), &[0.1], Some(estimator));
    let (zeroth, record) = of(Estimator::ZerothOrder);
    assert!(zeroth != [0.1] && record.skipped == 0);
    for estimator in [Estimator::InverseVariance, Estimator::AlphaOrder { tolerance: 1e9 }] {
        let (theta, record) = of(estimator);
        assert_eq!((theta, record.first_order), (zeroth.clone(), Some(0.0)));
    }
    assert_eq!(of(Estimator::FirstOrder).1.skipped, 1, "steps of 1e200 are refused");
}

/// Gradients of 1e50 exceed f32. Clipping bounds them, as without smoothing.
#[test]
fn estimates_beyond_f32_are_clipped() {
    struct Huge;
    impl System for Huge {
        fn state_dim(&self) -> usize {
            1
        }
        fn control_dim(&self) -> usize {
            1
        }
        fn step<T: Scalar>(&self, Inputs { u, t, .. }: Inputs<'_, T>, next: &mut [T]) {
            next[0] = if t == 0 { u[0] } else { T::from(0.0) };
        }
        fn vjp<R: Real, C: Cotangent<R>>(
            &self,
            inputs: Inputs<'_, R>,
            next_bar: &[C],
            cotangents: Cotangents<'_, C>,
        ) {
            if let (0, Some(u_bar)) = (inputs.t, cotangents.u) {
                u_bar[0] += next_bar[0] * R::from(1e30);
            }
            if let (1, Some(x_bar)) = (inputs.t, cotangents.x) {
                x_bar[0] += next_bar[0] * R::from(1e20);
            }
        }
    }
    impl Task for Huge {
        type System = Self;
        fn system(&self) -> &Self {
            self
        }
        fn horizon(&self) -> usize {
            2
        }
        fn start(&self, _: &mut Rng, _: Start<'_>) {}
        fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
            x[0] + 1.0
        }
    }
    for estimator in [None, Some(Estimator::FirstOrder)] {
        let training = Training { clip: Clip::Norm(1.0), ..training(estimator) };
        let trainer = Trainer::new(Huge, Constant::new(1, 1))
            .precision::<f32>()
            .field(Field::regular())
            .training(training);
        let mut session = trainer.start_from(vec![0.0]).session().expect("valid settings");
        let record = session.epoch().expect("finite").clone();
        assert_eq!((record.skipped, session.weights().theta()), (0, &[-1.0][..]), "{estimator:?}");
        assert!((record.grad_norm.log10() - 50.0).abs() < 1e-6, "{}", record.grad_norm);
    }
}

/// A budget below the memory of a gradient suffices, because the estimate needs losses only.
#[test]
fn zeroth_order_estimates_need_no_memory_for_gradients() {
    let of = |estimator| {
        let training = Training {
            batch: 64,
            train_samples: 64,
            memory: Some(200_000),
            ..training(Some(estimator))
        };
        let task = CartPole { horizon: 1000, ..CartPole::new(1) };
        Trainer::new(task, Mlp::new([4, 8, 1]))
            .precision::<f64>()
            .field(Field::regular())
            .training(training)
            .session()
    };
    assert!(of(Estimator::FirstOrder).is_err() && of(Estimator::ZerothOrder).is_ok());
}

#[test]
fn initial_parameters_beyond_f32_are_refused() {
    let trainer = Trainer::new(Bowl::default(), Constant::new(2, 2)).start_from(vec![0.0, 1e39]);
    let error = trainer.session().err().map_or_else(String::new, |error| error.to_string());
    assert!(error.ends_with("contains inf at index 1; allowed: finite numbers in f32"), "{error}");
}

/// The first-order estimate of a jump is 0 and has no variance, so weights by inverse variance
/// select it. The tolerance of the α-order estimate limits this bias.
#[test]
fn alpha_order_limits_the_bias_that_inverse_variances_ignore() {
    let of = |estimator| {
        after_one_update(Cost::Jump, Constant::new(1, 1), &[0.01], Some(estimator)).0[0]
    };
    assert_eq!(of(Estimator::InverseVariance), 0.01);
    let zeroth = of(Estimator::ZerothOrder);
    assert!(zeroth < -1.0, "{zeroth}");
    // With a tolerance near 0, the α-order estimate is the zeroth-order estimate.
    assert_eq!(of(Estimator::AlphaOrder { tolerance: 1e-9 }), zeroth);
}

fn swing_up(estimator: Estimator, workers: usize) -> Session<CartPole, Mlp, f64> {
    let training = Training {
        workers,
        epochs: 2,
        batch: 20,
        train_samples: 40,
        test_samples: 8,
        learning_rate: 1e-3,
        ..training(Some(estimator))
    };
    let trainer = Trainer::new(CartPole::new(1), Mlp::new([4, 8, 1]))
        .precision::<f64>()
        .field(Field::regular());
    trainer.training(training).session().expect("valid settings")
}

#[test]
fn an_alpha_order_estimate_without_first_order_causes_a_warning() {
    let warnings = |tolerance| {
        let mut session = swing_up(Estimator::AlphaOrder { tolerance }, 1);
        session.epoch().expect("finite");
        session.warnings().concat()
    };
    assert!(warnings(1e-9).contains("used only the zeroth-order estimate"));
    assert!(!warnings(1e9).contains("zeroth-order"));
}

#[test]
fn estimates_do_not_depend_on_workers_or_checkpoints() {
    for estimator in ALL {
        let mut whole = swing_up(estimator, 1);
        while !whole.is_done() {
            whole.epoch().expect("finite");
        }
        let mut parts = swing_up(estimator, 3);
        while !parts.is_done() {
            parts.advance(&|| true).expect("finite");
            let mut next = swing_up(estimator, 2);
            next.restore(&parts.checkpoint("a run"), "a run").expect("its own checkpoint");
            parts = next;
        }
        assert!(whole.weights().theta() == parts.weights().theta(), "{estimator:?}");
        let growth = whole.records()[0].regular_growth;
        assert_eq!(
            growth.is_some(),
            estimator != Estimator::ZerothOrder,
            "{estimator:?}: {growth:?}"
        );
    }
}

#[test]
fn one_pair_without_variance_and_noise_of_0_are_refused() {
    let refused = |estimator, noise, pairs| {
        let training = Training {
            smoothing: Some(Smoothing { estimator, noise, pairs }),
            ..Training::default()
        };
        let trainer = Trainer::new(Bowl::default(), Constant::new(2, 2)).training(training);
        let error: Option<TrainError> = trainer.session().err();
        error.map_or_else(String::new, |error| error.to_string())
    };
    assert_eq!(refused(Estimator::ZerothOrder, 0.1, 1), "");
    assert_eq!(refused(Estimator::ZerothOrder, 0.1, 0), "training.pairs: is 0; allowed: 1 or more");
    assert_eq!(
        refused(Estimator::InverseVariance, 0.1, 1),
        "training.pairs: is 1; allowed: 2 or more"
    );
    assert_eq!(
        refused(Estimator::FirstOrder, 0.0, 1),
        "training.noise: is 0; allowed: a positive number"
    );
    assert_eq!(
        refused(Estimator::AlphaOrder { tolerance: -1.0 }, 0.1, 2),
        "training.tolerance: is -1; allowed: 0 or more"
    );
}

/// Training skips an update with a diverged pair and keeps the parameters.
#[test]
fn a_diverged_pair_keeps_the_parameters() {
    #[derive(Clone, Debug)]
    struct Wall;
    impl System for Wall {
        fn state_dim(&self) -> usize {
            1
        }
        fn control_dim(&self) -> usize {
            1
        }
        fn step<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, next: &mut [T]) {
            next[0] = T::select_lt(u[0], T::from(0.5), u[0], T::from(f64::INFINITY));
        }
    }
    impl Task for Wall {
        type System = Self;
        fn system(&self) -> &Self {
            self
        }
        fn horizon(&self) -> usize {
            1
        }
        fn start(&self, _: &mut Rng, start: Start<'_>) {
            start.x[0] = 0.0;
        }
        fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
            x[0]
        }
    }
    // The parameter is 0.001 σ below the wall, so one member of each pair is beyond the wall.
    for estimator in ALL {
        let (theta, record) =
            after_one_update(Wall, Constant::new(1, 1), &[0.4999], Some(estimator));
        assert_eq!((&theta[..], record.skipped), (&[0.4999][..], 1), "{estimator:?}");
    }
}

//! Combinations with a moving average of the direction of R equal their definition.

use approx::assert_relative_eq;
use physgrad::engine::Batch;
use physgrad::policy::Mlp;
use physgrad::rng::Purpose;
use physgrad::tasks::CartPole;
use physgrad::train::{OptimizerKind, Session};
use physgrad::{Field, Policy, Trainer, Training, initial_states};

const UPDATES: usize = 4;
const RATE: f64 = 3.0;

/// Training whose epochs have one update.
fn session(average: f64, field: Field) -> Session<CartPole, Mlp, f64> {
    let training = Training {
        epochs: UPDATES,
        train_samples: 8,
        test_samples: 1,
        rule: OptimizerKind::Sgd,
        learning_rate: RATE,
        average,
        ..Training::default()
    };
    Trainer::new(CartPole::new(2), Mlp::new([6, 8, 1]))
        .precision::<f64>()
        .field(field)
        .training(training)
        .session()
        .expect("valid")
}

fn trained(average: f64, field: Field) -> Vec<f64> {
    let mut session = session(average, field);
    while !session.is_done() {
        session.epoch().expect("finite");
    }
    session.weights().theta().to_vec()
}

/// Repeats the training by definition: d ← β d + (1 - β) R / ‖R‖, with β = `average`. Updates use M
/// in components where M and d have equal signs, else 0.
#[test]
fn c_with_an_average_is_m_where_m_agrees_with_the_mean_direction_of_r() {
    for average in [0.0, 0.5, 0.9] {
        let (task, policy, field) = (CartPole::new(2), Mlp::new([6, 8, 1]), Field::combined());
        let start = session(average, field);
        let mut weights = start.weights().clone();
        let starts: Vec<f64> = initial_states(&task, 0, Purpose::Train, 8);
        let mut batch = Batch::new(&task, &policy, 8, &field.flows(), 1);
        let mut direction = vec![0.0; policy.param_count()];
        for _ in 0..UPDATES {
            batch.run(&task, &policy, &weights, &starts).expect("finite");
            let [m, r] = [0, 1].map(|k| batch.gradients()[k].to_vec());
            let norm = r.iter().map(|r| r * r).sum::<f64>().sqrt();
            direction
                .iter_mut()
                .zip(&r)
                .for_each(|(d, r)| *d = average * *d + (1.0 - average) * r / norm);
            weights.update(&policy, |theta| {
                for ((theta, m), d) in theta.iter_mut().zip(&m).zip(&direction) {
                    *theta -= if m * d > 0.0 { RATE * m } else { 0.0 };
                }
            });
        }
        for (found, expected) in trained(average, field).iter().zip(weights.theta()) {
            assert_relative_eq!(found, expected, max_relative = 1e-12, epsilon = 1e-14);
        }
    }
}

#[test]
fn an_average_changes_combinations_and_no_single_gradient() {
    // The projected field equals M if M does not oppose R, as in these updates.
    for field in Field::ALL.into_iter().filter(|field| *field != Field::projected()) {
        let changed = trained(0.0, field) != trained(0.9, field);
        assert_eq!(changed, field.flows().len() > 1, "{field}");
    }
}

#[test]
fn a_checkpoint_restores_the_average() {
    let whole = trained(0.9, Field::combined());
    let mut parts = session(0.9, Field::combined());
    while !parts.is_done() {
        parts.epoch().expect("finite");
        let mut next = session(0.9, Field::combined());
        next.restore(&parts.checkpoint("a run"), "a run").expect("its own checkpoint");
        parts = next;
    }
    assert!(whole == parts.weights().theta());
    let other = session(0.0, Field::combined()).restore(&parts.checkpoint("a run"), "a run");
    let message = other.expect_err("a run without average").to_string();
    assert!(message.contains("its average has 65 components, but that of this run 0"), "{message}");
}

#[test]
fn an_average_of_1_is_refused() {
    let training = Training { average: 1.0, ..Training::default() };
    let error = Trainer::new(CartPole::new(1), Mlp::new([4, 8, 1]))
        .training(training)
        .session()
        .expect_err("an error");
    assert_eq!(error.to_string(), "training.average: is 1; allowed: 0 to below 1");
}

//! Rollouts, gradients and whole epochs do not allocate after the first run.

use allocation_counter::measure;
use physgrad::policy::Mlp;
use physgrad::tasks::{CartPole, LossMode};
use physgrad::{Field, Trainer, Training};

#[test]
fn epochs_do_not_allocate_after_the_first() {
    for (field, resample) in Field::ALL.map(|field| (field, false)).into_iter().chain([(Field::combined(), true)]) {
        for loss in [LossMode::Terminal, LossMode::Running] {
            let task = CartPole { loss, ..CartPole::new(2) };
            // The last mini-batch is smaller than the others.
            let training =
                Training { epochs: 4, train_samples: 20, test_samples: 40, resample, workers: 1, ..Training::default() };
            let trainer = Trainer::new(task, Mlp::new([6, 16, 16, 1])).field(field).training(training);
            let mut session = trainer.session().expect("valid settings");
            session.epoch().expect("finite");
            let epochs = measure(|| (0..3).for_each(|_| _ = session.epoch().expect("finite")));
            assert_eq!(epochs.count_total, 0, "field {field}, {loss:?}, resample: {resample}");
        }
    }
}

//! After the first time, neither rollouts, nor gradients, nor whole epochs allocate.

use physgrad::policy::Mlp;
use physgrad::tasks::{CartPole, LossMode};
use physgrad::{Field, Trainer, Training};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

struct Counting;

thread_local! {
    /// Of this thread, which does all the work: the test runner has a thread of its own, which allocates when it likes.
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: everything is handed to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn epochs_do_not_allocate_after_the_first() {
    for field in Field::ALL {
        for loss in [LossMode::Terminal, LossMode::Running] {
            let task = CartPole { loss, ..CartPole::new(2) };
            // A last mini-batch that is smaller than the others.
            let training = Training { epochs: 4, train_samples: 20, test_samples: 40, workers: 1, ..Training::default() };
            let trainer = Trainer::new(task, Mlp::new([6, 16, 16, 1])).field(field).training(training);
            let mut session = trainer.session().expect("valid settings");
            session.epoch().expect("finite");
            let before = ALLOCATIONS.get();
            for _ in 0..3 {
                session.epoch().expect("finite");
            }
            assert_eq!(ALLOCATIONS.get() - before, 0, "field {field}, {loss:?}");
        }
    }
}

//! Rollouts, gradients and whole epochs do not allocate after the first run.

use physgrad::policy::Mlp;
use physgrad::tasks::{CartPole, LossMode};
use physgrad::{Field, Trainer, Training};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

struct Counting;

thread_local! {
    /// Per-thread allocation counter. The test runner's own thread allocates at any time.
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: all calls are forwarded to the system's allocator.
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
            // The last mini-batch is smaller than the others.
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

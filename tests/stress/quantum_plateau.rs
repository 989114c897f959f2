//! Stress case: zero overlap between the initial and the target state.

use super::{Case, Finding};
use physgrad::check::{self, Plateau};
use physgrad::initial_states;
use physgrad::policy::{Mlp, Weights};
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::{LossMode, Quantum};

pub(super) const CASES: &[Case] = &[Case {
    name: "quantum_plateau",
    about: "zero overlap with the target and zero control, with a policy whose output layer is zero",
    criterion: "the gradient is finite, smaller than 1e-6 of that at neighbouring parameters, and reported as a \
                plateau. From an initial state with overlap, it is reported as a slope",
    explanation: "Where the initial state has no overlap with the target and the control is zero, the gradient is 0 \
                except for rounding. An optimizer that normalizes the gradient, such as Adam, follows noise. \
                `check::plateau` compares a gradient with those at neighbouring parameters and reports a plateau, a \
                minimum, a slope or a flat loss. The paper's initialization for eigenstate 3, with a zeroed output \
                layer, is such a plateau; runs leave it by rounding. Limits: training does not call `check::plateau`",
    run: quantum_plateau,
}];

/// Plateau report for initial states that superpose eigenstates 1 and 2, with weighted random
/// amplitudes and random phases. None if a loss or a gradient is non-finite.
fn report(target: usize, weighting: [f64; 2], loss: LossMode) -> Option<Plateau> {
    let task = Quantum { weighting, loss, ..Quantum::new(target) };
    let policy = Mlp::new([64, 16, 1]).zero_init_output(true);
    let weights = Weights::<f64>::init(&policy, &mut stream(0, Purpose::Policy, 0));
    let starts: Vec<f64> = initial_states(&task, 0, Purpose::Train, 8);
    check::plateau(&task, &policy, &weights, &starts).ok()
}

fn quantum_plateau() -> Vec<Finding> {
    let mut findings = Vec::new();
    for (loss, name) in [(LossMode::Terminal, "terminal loss"), (LossMode::Running, "running loss")]
    {
        for (what, target, weighting, stuck) in [
            ("from 1 to 2", 2, [1.0, 0.0], true),
            ("from 1 to 3", 3, [1.0, 0.0], true),
            ("from 1 and 2 to 3, as in the paper", 3, [1.0, 1.0], true),
            ("from 1 and 2 to 2", 2, [1.0, 1.0], false),
        ] {
            let required = if stuck { "finite, and a plateau" } else { "finite, and a slope" };
            let found = report(target, weighting, loss);
            let measured = found.map_or("non-finite".into(), |found| found.to_string());
            let pass = measured.starts_with(if stuck { "a plateau" } else { "a slope" });
            findings.push(Finding::holds(format!("{what}, {name}"), required, pass, measured));
        }
    }
    findings
}

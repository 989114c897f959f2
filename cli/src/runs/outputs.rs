//! Output files of a run: learning curve, trained numbers, trajectories.

use crate::operations::trajectory::Trajectory;
use crate::platform::csv::csv;
use crate::tasks::Scene;
use crate::tasks::settings::COLUMNS;
use anyhow::Result;
use physgrad::train::Record;
use physgrad_plot as report;

/// SVG chart of training and test loss over epochs.
pub fn learning_curve(title: &str, records: &[Record]) -> String {
    let points = |loss: fn(&Record) -> f64| {
        records.iter().map(|r| (r.epoch as f64, loss(r))).collect::<Vec<_>>()
    };
    report::learning_curve(title, &points(|r| r.train_loss), &points(|r| r.test_loss)).to_svg()
}

/// `numbers.csv`: names and values of the trained numbers.
pub fn numbers(numbers: &[(String, f64)]) -> Result<Vec<u8>> {
    csv(["name", "value"], numbers.iter().map(|(name, value)| [name.clone(), value.to_string()]))
}

/// `trajectory.csv`: one row per state of each rollout. `rollouts` pairs the rollouts with the
/// indices of their initial states. A row contains the index, the step, the time, the state, and
/// the parameters of the rollout. The last columns are the controls of the policy, and the controls
/// that an actuator applies. Both are empty for the last state.
pub fn trajectories<'a>(
    scene: &Scene,
    rollouts: impl IntoIterator<Item = (usize, &'a Trajectory)>,
) -> Result<Vec<u8>> {
    let names = COLUMNS.map(String::from).into_iter();
    let (states, params) = (scene.state_names(), scene.param_names());
    let (controls, applied) = (scene.control_names(), scene.applied_names());
    let header = names.chain(states).chain(params).chain(controls.clone()).chain(applied.clone());
    let (dt, controls, applied) = (scene.dt(), controls.len(), applied.len());
    let rows = rollouts.into_iter().flat_map(|(sample, rollout)| {
        let applied_rows = scene.applied(&rollout.states, &rollout.controls);
        rollout.states.iter().enumerate().map(move |(t, state)| {
            let index = [sample.to_string(), t.to_string(), (t as f64 * dt).to_string()];
            let cells = |rows: &[Vec<f64>], columns: usize| -> Vec<String> {
                let cell = |i: usize| {
                    rows.get(t).map_or_else(String::new, |row: &Vec<f64>| row[i].to_string())
                };
                (0..columns).map(cell).collect()
            };
            let state = state.iter().chain(&rollout.params[t]).map(f64::to_string);
            let controls =
                cells(&rollout.controls, controls).into_iter().chain(cells(&applied_rows, applied));
            index.into_iter().chain(state).chain(controls).collect::<Vec<_>>()
        })
    });
    csv(header, rows)
}

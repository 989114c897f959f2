//! Figure 2: Adam on a gradient, on the gradient with a rotation added, and on their combination.

use crate::commands::paper::FinishedFigure;
use crate::platform::table::Table;
use anyhow::Result;
use physgrad::policy::Constant;
use physgrad::tasks::Bowl;
use physgrad::text::rough;
use physgrad::train::vector_field::{self, LEARNING_RATE, Rotated, START, Sample};
use physgrad_plot::{Map, Plane, field_color, maps};

/// Half the range of each parameter, which is centered at 0.
const HALF_WIDTH: f64 = 4.0;
/// Number of Adam updates of each method.
const ITERATIONS: usize = 1500;
/// Labels of the panels.
const LETTERS: [&str; 3] = ["(a)", "(b)", "(c)"];

pub fn fig2(quick: bool) -> Result<FinishedFigure> {
    let (cells, arrows) = if quick { (40, 11) } else { (80, 15) };
    let (task, policy) = (Bowl::default(), Constant::new(2, 2));
    let plane = Plane {
        labels: ["θ₁", "θ₂"],
        half_width: HALF_WIDTH,
        decades: [-1, 2],
        values: "norm of the vector",
    };
    let mut csv = csv::Writer::from_writer(Vec::new());
    csv.write_record(["method", "iteration", "theta_1", "theta_2", "loss"])?;
    let mut table = Table::new(["Adam along the", "last loss", "distance to the minimum"]);
    let (mut panels, mut runs) = (Vec::new(), Vec::new());
    let colors = [field_color("R"), field_color("M"), field_color("C")];
    for (i, (name, field)) in Rotated::figure().into_iter().enumerate() {
        let path = vector_field::descend(&task, &policy, &field, START, LEARNING_RATE, ITERATIONS)?;
        for (iteration, s) in path.iter().enumerate() {
            csv.serialize((name, iteration, s.theta, s.loss))?;
        }
        let last = path[path.len() - 1];
        // The minimum is at the origin.
        let [loss, distance] = [last.loss, last.theta[0].hypot(last.theta[1])].map(rough);
        table.row([name.to_owned(), loss, distance]);
        let norms =
            vector_field::sample(&task, &policy, &field, &vector_field::grid(HALF_WIDTH, cells))?;
        let directions =
            vector_field::sample(&task, &policy, &field, &vector_field::grid(HALF_WIDTH, arrows))?;
        panels.push(Map {
            title: format!("{} {name}", LETTERS[i]),
            values: norms.iter().map(Sample::norm).collect(),
            arrows: directions.iter().map(|s| s.vector.map(|v| -v)).collect(),
            path: path.iter().map(|s| s.theta).collect(),
            mark: Some([0.0; 2]),
            ..Map::default()
        });
        runs.push((LETTERS[i], colors[i], path.iter().map(|s| s.loss).collect()));
    }
    Ok(FinishedFigure { drawing: maps(&plane, &panels, &runs), csv: csv.into_inner()?, table })
}

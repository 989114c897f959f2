//! Picture of measured and simulated trajectories.

use crate::commands::identify::data::Measured;
use crate::commands::identify::remarks::measured_components;
use crate::tasks::Scene;
use physgrad::identify::{Fit, Segment};
use physgrad_plot::{Dash, Series, fitted};

/// Largest number of segments in the picture.
const SEGMENTS: usize = 3;

/// One column for each of the first [`SEGMENTS`] segments. Two rows per state component with a
/// measurement after the first row: measured and simulated values, then residuals.
pub fn picture(
    measured: &Measured,
    numbers: &[usize],
    segments: &[Segment],
    fit: &Fit,
    scene: &Scene,
) -> String {
    let (names, dt) = (scene.state_names(), scene.dt());
    let components = measured_components(segments, 1);
    let shown = numbers.iter().zip(segments).zip(&fit.states).take(SEGMENTS);
    let columns = shown.map(|((number, segment), states)| {
        let (begin, label) = (measured.begin(*number), measured.label(*number));
        let rows = components.iter().flat_map(|&i| {
            let (name, column) = (&names[i], fit.measured(i, segment));
            let points = |value: &dyn Fn(f64, f64) -> f64| -> Vec<(f64, f64)> {
                let rows = column.iter().zip(states).enumerate();
                let points = rows.map(|(step, (&y, x))| (begin + step as f64 * dt, value(y, x[i])));
                points.filter(|(_, value)| value.is_finite()).collect()
            };
            let simulated =
                Series::new("simulated", "#D55E00", points(&|_, x| x)).dash(Dash::Dashed);
            let values = vec![Series::new("measured", "#0072B2", points(&|y, _| y)), simulated];
            let residual =
                vec![Series::new("simulated - measured", "#009E73", points(&|y, x| x - y))];
            [(name.clone(), values), (format!("residual of {name}"), residual)]
        });
        (format!("segment {label}"), rows.collect())
    });
    fitted(&format!("{}: measured and simulated", scene.task.name()), columns.collect()).to_svg()
}

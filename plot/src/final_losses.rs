//! Final losses of several methods on several tasks, one mark per seed.

use super::log_figure::{Panel, XScale, entry, log_figure_with};
use super::quantile::{quantile, sorted};
use super::{Dash, Drawing, PALETTE, Series, YScale};

/// Final losses on one task: one panel of [`final_losses`].
pub struct TaskLosses {
    /// Title of the panel.
    pub task: String,
    /// Name of each method, with one loss per seed. A non-finite loss stands for a failed run.
    pub methods: Vec<(String, Vec<f64>)>,
    /// Loss of the untrained policy, as a dashed line.
    pub untrained: f64,
}

impl TaskLosses {
    /// Scale of the axis.
    fn scale(&self) -> YScale {
        let losses = self.methods.iter().flat_map(|(_, losses)| losses);
        YScale::of(losses.copied().chain([self.untrained]))
    }
}

/// Largest number of panels in a row.
const COLUMNS: usize = 4;
/// Distance of the outermost dots of a method from its number on the x axis.
const HALF_WIDTH: f64 = 0.25;

/// Draws one panel per task, with one dot per seed and a line at the median of each method.
///
/// Methods have numbers along the x axis, and names in the legend. All tasks have the same methods.
/// The axis of a task is linear if a loss is 0 or negative, otherwise logarithmic. Omits dots and
/// lines that the axis cannot show, and states how many of the seeds remain. Medians include all
/// seeds; NaN ranks above every number.
pub fn final_losses(title: &str, tasks: Vec<TaskLosses>) -> Drawing {
    let names = tasks.first().map_or(&[][..], |task| &task.methods);
    let mut legend: Vec<_> = names
        .iter()
        .enumerate()
        .map(|(i, (name, _))| entry(&Series::new(label(i, name), color(i), Vec::new())))
        .collect();
    if tasks.iter().any(|task| task.scale().shows(task.untrained)) {
        legend.push(entry(&untrained(Vec::new())));
    }
    let columns = tasks.len().div_ceil(tasks.len().div_ceil(COLUMNS).max(1)).max(1);
    let mut panels: Vec<Panel> =
        tasks.into_iter().enumerate().map(|(i, task)| panel(i, task)).collect();
    // Fills the last row with panels without series, which are not drawn.
    let nothing = || TaskLosses { task: String::new(), methods: Vec::new(), untrained: f64::NAN };
    let empty =
        |i: usize| Panel { series: Vec::new(), x_label: String::new(), ..panel(i, nothing()) };
    panels.extend((panels.len()..panels.len().next_multiple_of(columns)).map(empty));
    let mut rows = Vec::new();
    while !panels.is_empty() {
        let rest = panels.split_off(columns);
        rows.push(std::mem::replace(&mut panels, rest));
    }
    log_figure_with(title, &rows, legend)
}

fn label(i: usize, name: &str) -> String {
    format!("{}: {name}", i + 1)
}

fn color(i: usize) -> &'static str {
    PALETTE[i % PALETTE.len()]
}

fn untrained(line: Vec<(f64, f64)>) -> Series {
    Series::new("untrained policy", "#666666", line).dash(Dash::Dashed)
}

fn panel(y_axis: usize, task: TaskLosses) -> Panel {
    let scale = task.scale();
    let TaskLosses { task, methods, untrained: level } = task;
    let line = [0.5, methods.len() as f64 + 0.5]
        .map(|x| (x, level))
        .into_iter()
        .filter(|(_, y)| scale.shows(*y));
    let marks =
        methods.iter().enumerate().flat_map(|(i, (name, losses))| marks(i, name, losses, scale));
    Panel {
        title: task,
        x_label: "method".into(),
        x_scale: XScale::Numbers(methods.len()),
        y_label: "final test loss".into(),
        y_axis,
        series: marks.chain([untrained(line.collect())]).collect(),
    }
}

/// Line at the median of method `i`, and one dot per seed.
fn marks(i: usize, name: &str, losses: &[f64], scale: YScale) -> Vec<Series> {
    let (label, color, x) = (label(i, name), color(i), i as f64 + 1.0);
    // Spreads the seeds evenly, so equal losses do not cover each other.
    let step = if losses.len() > 1 { 2.0 * HALF_WIDTH / (losses.len() - 1) as f64 } else { 0.0 };
    let first = if losses.len() > 1 { x - HALF_WIDTH } else { x };
    let dots = losses.iter().enumerate().filter(|(_, loss)| scale.shows(**loss));
    let dots: Vec<Series> = dots
        .map(|(seed, &loss)| Series::new(&*label, color, vec![(first + step * seed as f64, loss)]))
        .collect();
    // NaN ranks above every number, as in tables.
    let median = quantile(&sorted(losses.iter().copied()), 0.5);
    let line =
        if scale.shows(median) { vec![(x - 0.35, median), (x + 0.35, median)] } else { Vec::new() };
    let note = if dots.len() < losses.len() {
        format!("{} of {} seeds", dots.len(), losses.len())
    } else {
        String::new()
    };
    [Series { note, ..Series::new(label, color, line) }].into_iter().chain(dots).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn losses(methods: &[(&str, &[f64])]) -> TaskLosses {
        let methods =
            methods.iter().map(|(name, losses)| ((*name).to_owned(), losses.to_vec())).collect();
        TaskLosses { task: "task".into(), methods, untrained: 2.0 }
    }

    #[test]
    fn a_method_has_a_line_at_the_median_and_a_dot_per_seed_around_its_number() {
        let panel = panel(0, losses(&[("A", &[1.0]), ("B", &[0.1, f64::NAN, 0.4])]));
        let lines: Vec<&[(f64, f64)]> =
            panel.series.iter().map(|series| &series.line[..]).collect();
        let expected: [&[(f64, f64)]; 6] = [
            &[(0.65, 1.0), (1.35, 1.0)],
            &[(1.0, 1.0)],
            &[(1.65, 0.4), (2.35, 0.4)],
            &[(1.75, 0.1)],
            &[(2.25, 0.4)],
            &[(0.5, 2.0), (2.5, 2.0)],
        ];
        assert_eq!(lines, expected);
        assert_eq!((&*panel.series[0].note, &*panel.series[2].note), ("", "2 of 3 seeds"));
    }

    #[test]
    fn negative_losses_have_dots_and_a_median() {
        let panel = panel(0, losses(&[("A", &[-1.0, 0.0, 3.0])]));
        let dots: Vec<f64> = panel.series[1..4].iter().map(|series| series.line[0].1).collect();
        assert_eq!((dots, &*panel.series[0].note), (vec![-1.0, 0.0, 3.0], ""));
        assert_eq!(panel.series[0].line[0].1, 0.0);
    }

    #[test]
    fn a_picture_has_one_panel_per_task_and_one_legend_entry_per_method() {
        for tasks in [1, 3, 5] {
            let picture = final_losses(
                "title",
                (0..tasks).map(|_| losses(&[("A", &[1.0, 2.0]), ("B", &[f64::NAN])])).collect(),
            );
            let picture = picture.to_svg();
            roxmltree::Document::parse(&picture).expect("an SVG is XML");
            assert!(
                !picture.contains("NaN") && !picture.contains("no positive data"),
                "{tasks} tasks"
            );
            assert_eq!(picture.matches(">task<").count(), tasks);
            let entries = [">1: A<", ">2: B<", ">untrained policy<"]
                .map(|label| picture.matches(label).count());
            assert_eq!(entries, [1, 1, 1], "also a method without a loss that can be drawn");
        }
        roxmltree::Document::parse(&final_losses("nothing", Vec::new()).to_svg())
            .expect("an SVG is XML");
    }
}

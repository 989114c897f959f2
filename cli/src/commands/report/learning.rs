//! Charts of losses.

use crate::commands::report::figure::{Figure, Key};
use crate::commands::report::inspected::{Inspected, InspectedScene};
use crate::platform::terminal::counted;
use crate::runs::statistics::{
    InScene, MAX_DASHED, Outcome, by_method, curves_of_scenes, field_label,
};
use physgrad::train::Record;
use physgrad_plot::{Abscissa, Chart, Curve, Dash, Point, Series, YScale, field_color, statistic};

const EPOCH: &str = "epoch";
const SECONDS: &str = "wall time (s)";

/// Charts of training and test loss of one run.
pub fn of_run(run: &Inspected) -> Vec<Figure> {
    let outcome = run.outcome();
    vec![
        Figure::new(
            "Loss by epoch",
            by_epoch(&outcome),
            "Loss of the whole training and test set after every epoch. A test loss that stays high while the training loss \
             falls shows overfitting. Jumps show steps that are too large. In a training by windows, the training loss is the \
             mean cost of the episodes that came to an end during the epoch, with the noise of the training.",
        )
        .notes(left_out(&[outcome], &[|r| r.train_loss, |r| r.test_loss])),
        Figure::new(
            "Loss by time",
            Chart::losses(SECONDS, "loss", series(&outcome, |p| p.seconds)),
            "Both losses against training time.",
        ),
    ]
}

/// Chart of training and test loss of one run by epoch.
pub fn by_epoch(run: &Outcome) -> Chart {
    Chart::losses(EPOCH, "loss", series(run, |p| p.epoch))
}

/// Training and test loss of one run.
fn series(run: &Outcome, x: fn(&Point) -> f64) -> Vec<Series> {
    let line = |loss| run.points(loss).iter().map(|p| (x(p), p.value)).collect();
    vec![
        Series::new("training", "#0072B2", line(|r| r.train_loss)),
        Series::new("test", "#D55E00", line(|r| r.test_loss)),
    ]
}

/// Charts of test losses by field: medians with bands, and every run. Up to three scenes share the
/// charts of medians, and have different dashes. With more scenes, each scene has charts of its
/// own. A scene with one seed per field has no chart of every run.
pub fn of_comparison(scenes: &[InspectedScene]) -> Vec<Figure> {
    let all: Vec<InScene> = scenes.iter().map(InspectedScene::outcomes).collect();
    let groups = all.chunks(if scenes.len() <= MAX_DASHED { scenes.len().max(1) } else { 1 });
    let mut figures: Vec<Figure> =
        groups.flat_map(|group| medians(group, all.len() > group.len())).collect();
    for scene in scenes {
        if by_method(&scene.outcomes().runs).any(|(_, runs)| runs.len() > 1) {
            let line = |run: &Outcome| {
                run.points(|r| r.test_loss).iter().map(|p| (p.epoch, p.value)).collect()
            };
            figures.push(
                Figure::new(
                    scene.title("Every run"),
                    Chart::losses(EPOCH, "test loss", lines(&scene.runs, line)),
                    "Test loss of every seed. Shows single seeds that fail where others of the same field succeed.",
                )
                .keys(field_keys(&scene.runs)),
            );
        }
    }
    figures
}

/// Test losses of these scenes against epochs and time.
fn medians(scenes: &[InScene], titled: bool) -> [Figure; 2] {
    let curves = curves_of_scenes(scenes, |r| r.test_loss);
    let scale = YScale::of(curves.iter().flat_map(Curve::values));
    let series = |x| curves.iter().flat_map(|curve| curve.series(x, scale)).collect();
    let title =
        |title: &str| if titled { format!("{}: {title}", scenes[0].name) } else { title.into() };
    let outcomes: Vec<Outcome> =
        scenes.iter().flat_map(|scene| scene.runs.iter().copied()).collect();
    let caption = "Loss of the test set after every epoch.";
    let caption = match statistic(curves.iter().map(|curve| curve.runs.len())) {
        "" => format!("{caption} A level line shows a field that does not reduce the loss."),
        statistic => format!(
            "{caption} Lines and bands: {statistic}. Bands that do not overlap show a difference beyond the spread of the seeds."
        ),
    };
    [
        Figure::new(
            title("Test loss by epoch"),
            Chart::losses(EPOCH, "test loss", series(Abscissa::Epoch)),
            caption,
        )
        .notes(left_out(&outcomes, &[|r| r.test_loss])),
        Figure::new(
            title("Test loss by time"),
            Chart::losses(SECONDS, "test loss", series(Abscissa::Seconds)),
            "Test loss against training time. A field of two gradients takes longer per epoch, so the order of the fields may \
             differ from the order by epoch.",
        ),
    ]
}

/// One line per run, in the colour of its field.
pub fn lines(runs: &[Inspected], line: impl Fn(&Outcome) -> Vec<(f64, f64)>) -> Vec<Series> {
    runs.iter()
        .map(|run| Series::new(run.name(), field_color(run.field.letter()), line(&run.outcome())))
        .collect()
}

/// Legend entries of the fields, without duplicates.
pub fn field_keys<'a>(runs: impl IntoIterator<Item = &'a Inspected>) -> Vec<Key> {
    let key = |run: &Inspected| Key {
        label: field_label(run.field),
        color: field_color(run.field.letter()),
        dash: Dash::Solid,
        series: Vec::new(),
    };
    let mut keys: Vec<Key> = runs.into_iter().map(key).collect();
    keys.dedup();
    keys
}

/// Notes on losses that the chart omits.
fn left_out(runs: &[Outcome], losses: &[fn(&Record) -> f64]) -> Vec<String> {
    let records = runs.iter().flat_map(|run| run.records);
    let is_hidden = |record: &&Record| losses.iter().any(|loss| !loss(record).is_finite());
    match records.filter(is_hidden).count() {
        0 => Vec::new(),
        count => {
            let epochs = counted(count, "epoch");
            vec![format!("The chart omits losses of {epochs}, because a rollout diverged.")]
        }
    }
}

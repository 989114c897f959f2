//! Charts of gradients: norms, agreement of M and R, and growth of adjoints.

use crate::commands::report::figure::Figure;
use crate::commands::report::inspected::{Inspected, RolloutData};
use crate::commands::report::learning::{field_keys, lines};
use crate::operations::adjoint_norms::AdjointNorms;
use crate::runs::statistics::{Outcome, curves};
use physgrad::Flow;
use physgrad::train::Record;
use physgrad_plot::{Abscissa, Chart, Dash, Series, YScale, field_color};

const EPOCH: &str = "epoch";
const STEP: &str = "step of the rollout";
const NORM: &str = "norm of the adjoint";

/// Charts of gradient quantities against epochs, for one run or several.
pub fn of_epochs(runs: &[Inspected]) -> Vec<Figure> {
    let by_epoch = |value: fn(&Record) -> f64| {
        lines(runs, |run: &Outcome| {
            run.records.iter().map(|r| (r.epoch as f64, value(r))).collect()
        })
    };
    let outcomes: Vec<Outcome> = runs.iter().map(Inspected::outcome).collect();
    let norms = curves(&outcomes, |r| r.grad_norm.get())
        .iter()
        .flat_map(|curve| curve.series(Abscissa::Epoch, YScale::Log))
        .collect();
    let mut figures = vec![Figure::new(
        "Norm of the field",
        Chart::log(EPOCH, "gradient norm", norms),
        "Norm of the vector that the optimizer follows, before clipping, averaged over the updates of an epoch; lines \
         and bands of several seeds are as above. Jumps by powers of ten show an exploding field. A norm that falls at a constant loss \
         shows a vanishing field.",
    )];
    let composed = |run: &&Inspected| run.records.iter().any(|r| r.cosine.is_some());
    if runs.iter().any(|run| composed(&run)) {
        let keys = || field_keys(runs.iter().filter(composed));
        figures.push(
            Figure::new(
                "Agreement of M and R",
                Chart::linear(EPOCH, "cosine", [-1.0, 1.0], by_epoch(|r| r.cosine.unwrap_or(f64::NAN))),
                "Cosine of the angle between the vectors M and R, from which the field is computed. At 1 their directions are equal. \
                 At 0 or below, backpropagation through the network gives R a direction that does not agree with M.",
            )
            .keys(keys()),
        );
        figures.push(
            Figure::new(
                "Share of components kept",
                Chart::linear(EPOCH, "share kept", [0.0, 1.0], by_epoch(|r| r.kept.unwrap_or(f64::NAN))),
                "Share of nonzero components of the field. C equals M where M and R have the same sign, and is zero elsewhere. \
                 Unrelated gradients then give one half; a share near or below it means that M and R do not agree.",
            )
            .keys(keys()),
        );
    }
    figures.push(growth_by_epoch(runs));
    figures.extend(episodes(runs));
    figures
}

/// Charts of episodes that can end, and of value functions, for the runs that have them.
fn episodes(runs: &[Inspected]) -> Vec<Figure> {
    let chart = |title, label, range, value: fn(&Record) -> Option<f64>, caption| {
        let has = |run: &&Inspected| run.records.iter().any(|record| value(record).is_some());
        let line = |run: &Outcome| {
            run.records.iter().filter_map(|r| Some((r.epoch as f64, value(r)?))).collect()
        };
        let series = lines(runs, line).into_iter().filter(|series| !series.line.is_empty());
        runs.iter().any(|run| has(&run)).then(|| {
            Figure::new(title, Chart::linear(EPOCH, label, range, series.collect()), caption)
                .keys(field_keys(runs.iter().filter(has)))
        })
    };
    let steps = runs.iter().map(|run| run.horizon).max().unwrap_or(1) as f64;
    [
        chart(
            "Length of episodes",
            "steps",
            [0.0, steps],
            |r| r.length,
            "Mean number of steps of the episodes of the test set. An episode lasts for the whole horizon unless its end \
             condition holds before.",
        ),
        chart(
            "Explained variance of the value function",
            "explained variance",
            [-1.0, 1.0],
            |r| r.explained.map(|explained| explained.max(-1.0)),
            "1 minus the variance of the error of the value function over that of its targets, within the windows, before it learned \
             from them. 1 is a perfect fit, 0 that of a constant; values below -1 are drawn as -1. While it is near 0, the ends \
             of windows tell the policy nothing.",
        ),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// Chart of the growth of adjoints over epochs.
fn growth_by_epoch(runs: &[Inspected]) -> Figure {
    let line = |run: &Inspected, flow: Flow| {
        let growth =
            |r: &Record| if flow == Flow::REGULAR { r.regular_growth } else { r.modified_growth };
        let points = run.records.iter().filter_map(|r| Some((r.epoch as f64, growth(r)?.along)));
        let series = Series::new(
            format!("{flow} of {}", run.name()),
            field_color(&flow.to_string()),
            points.collect(),
        );
        // Dashes the lines of runs whose field combines two flows, such as C. Other runs have solid
        // lines.
        if run.field.flows().len() > 1 { series.dash(Dash::Dashed) } else { series }
    };
    let both =
        runs.iter().flat_map(|run| [Flow::REGULAR, Flow::MODIFIED].map(|flow| line(run, flow)));
    let series: Vec<Series> = both.filter(|series| !series.line.is_empty()).collect();
    let finite =
        || series.iter().flat_map(|series| &series.line).map(|p| p.1).filter(|y| y.is_finite());
    let range = [finite().fold(-1.0, f64::min), finite().fold(1.0, f64::max)];
    let warnings = runs.iter().filter_map(|run| {
        let warnings = run.records.last()?.warnings(run.horizon, run.epsilon);
        Some(warnings.into_iter().map(|warning| format!("{}, last epoch: {warning}.", run.name())))
    });
    Figure::new(
        "Growth by epoch",
        Chart::linear(EPOCH, "growth along a rollout (decades)", range, series),
        "Powers of ten by which the adjoints of the field's flows grow in the reverse pass through a rollout; 0 is balanced. \
         Each value is the mean over the samples of the first applied update of its epoch. If R exceeds 7 in f32, or 16 in \
         f64, its signs at early steps are unreliable. With R far below 0, later costs barely affect the gradient of early \
         steps. M above 3 shows a plant that is unstable without its policy.",
    )
    .notes(warnings.flatten().collect())
}

/// Note on the charts that [`of_epochs`] omits. None if the field of a run combines two gradients.
pub fn missing(runs: &[Inspected]) -> Option<&'static str> {
    let has_one_flow = runs.iter().all(|run| run.field.flows().len() == 1);
    has_one_flow.then_some(
        "Cosine and share kept are recorded only for fields that combine two gradients, such as C. These runs use one.",
    )
}

/// Chart of adjoint norms along the rollout, before and after training.
pub fn of_run(rollouts: &RolloutData) -> Figure {
    let series = |growth: &AdjointNorms, when: &str| {
        let letter = growth.flow.to_string();
        Series::new(format!("{letter} {when}"), field_color(&letter), growth.points())
    };
    let before =
        rollouts.before.iter().map(|growth| series(growth, "before training").dash(Dash::Dashed));
    let after = rollouts.after.iter().map(|growth| series(growth, "as trained"));
    Figure::new(
        "Growth of the adjoint",
        Chart::log(STEP, NORM, before.chain(after).collect()),
        GROWTH,
    )
    .notes(
        [
            diverged(&rollouts.before, "Before training"),
            diverged(&rollouts.after, "As trained"),
            coincide(&rollouts.before),
        ]
        .concat(),
    )
}

/// Charts of adjoint norms: before training for the first run, and after training for the first
/// run of every field.
pub fn of_comparison(runs: &[Inspected]) -> Vec<Figure> {
    let firsts: Vec<(&Inspected, &RolloutData)> =
        runs.iter().filter_map(|run| Some((run, run.rollouts.as_ref()?))).collect();
    let Some((_, first)) = firsts.first() else { return Vec::new() };
    let before = first.before.iter().map(|growth| {
        let letter = growth.flow.to_string();
        Series::new(letter.clone(), field_color(&letter), growth.points())
    });
    let trained = |title, flow: usize, caption| {
        let series = firsts.iter().map(|(run, rollouts)| {
            Series::new(run.name(), field_color(run.field.letter()), rollouts.after[flow].points())
        });
        let notes = firsts.iter().flat_map(|(run, rollouts)| {
            diverged(&rollouts.after[flow..=flow], &format!("{}, as trained", run.name()))
        });
        Figure::new(title, Chart::log(STEP, NORM, series.collect()), caption).notes(notes.collect())
    };
    vec![
        Figure::new(
            "Growth of the adjoint before training",
            Chart::log(STEP, NORM, before.collect()),
            GROWTH,
        )
        .notes([diverged(&first.before, "Before training"), coincide(&first.before)].concat()),
        trained(
            "Growth of R as trained",
            0,
            "Adjoint of R (through physics and network) under the final policy of each field, first seed. A line that rises or \
             falls steeply towards the first step shows a policy through which the adjoint explodes or vanishes.",
        ),
        trained(
            "Growth of M as trained",
            1,
            "Adjoint of M (through the physics only) under the same policies. If the lines of M are level and the lines of R \
             are not, the network causes the growth.",
        ),
    ]
}

const GROWTH: &str = "Norm of the derivative of later costs with respect to the state at each step: through physics and network \
                      (R), or through physics alone (M). Curves show root mean squares over the test rollouts. The \
                      reverse pass runs from right to left: a line that rises by powers of ten shows an exploding adjoint, \
                      a falling line a vanishing adjoint.";

/// Notes on divergences that truncate or remove a line.
fn diverged(growths: &[AdjointNorms], when: &str) -> Vec<String> {
    if let [AdjointNorms { norms, diverged: Some(why), .. }, ..] = growths
        && norms.is_empty()
    {
        return vec![format!("{when}, a rollout diverged, so there is no reverse pass: {why}.")];
    }
    let of = |growth: &AdjointNorms| {
        growth
            .diverged
            .map(|why| format!("{when}, the adjoint of {} diverged: {why}.", growth.flow))
    };
    growths.iter().filter_map(of).collect()
}

/// Note if the lines of R and M coincide.
fn coincide(growths: &[AdjointNorms; 2]) -> Vec<String> {
    let [r, m] = growths.each_ref().map(|growth| &growth.norms);
    if r.is_empty() || r.iter().zip(m).any(|(r, m)| r.to_bits() != m.to_bits()) {
        return Vec::new();
    }
    vec![
        "Before training, R and M are equal: the weights of the output layer are zero, so no derivative passes through it."
            .into(),
    ]
}

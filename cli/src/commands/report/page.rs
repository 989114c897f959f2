//! HTML page: a single document that embeds style, script, charts and animations.

use crate::commands::report::figure::Figure;
use crate::commands::report::inspected::{Inspected, InspectedScene, ReportedNumber};
use crate::commands::report::{diagnostics, learning};
use crate::operations::adjoint_norms::SAMPLES;
use crate::platform::terminal::counted;
use crate::runs::statistics::{self, InScene, best, field_label, position};
use crate::settings::reading::flat;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use physgrad::text::{digits, short};
use toml::Value;

/// Explanation of the letters of the fields.
const FIELDS: &str = "Fields: R is the exact gradient, backpropagated through physics and network. M is backpropagated through the \
                      physics only, N through the network only, S through neither. C, the combined field, is M where M and R have \
                      the same sign, and zero elsewhere. P is M without the component that opposes R. F has equal angles to M \
                      and R. MR has the absolute values of M and the signs of R. RM is R with the norm of M.";

/// Page about one run.
pub fn run(folder: Option<&str>, run: &Inspected) -> String {
    let title = format!("{}: field {}, seed {}", run.task, field_label(run.field), run.seed);
    let trouble = run.incomplete().map(|reason| format!("This run {reason}."));
    let alone = std::slice::from_ref(run);
    let content = html! {
        (section("Result", result(run)))
        (section("Learning", html! {
            (figures(learning::of_run(run)))
            (trained_numbers(alone))
        }))
        (section("Animation", animations(&[run])))
        (section("Gradients", html! {
            (figures(diagnostics::of_epochs(alone).into_iter().chain(run.rollouts.as_ref().map(diagnostics::of_run))))
            (remarks(alone))
        }))
        (section("Settings", settings(&[run])))
    };
    document(&title, folder, version(run), FIELDS, trouble.as_slice(), &content)
}

/// Page about the runs of a comparison, of one scene or several.
pub fn comparison(folder: &str, scenes: &[InspectedScene]) -> String {
    let outcomes: Vec<InScene> = scenes.iter().map(InspectedScene::outcomes).collect();
    let by_field = || outcomes.iter().flat_map(|scene| statistics::by_method(&scene.runs));
    let mut letters: Vec<&str> = by_field().map(|(_, runs)| runs[0].field.letter()).collect();
    letters.sort_by_key(|letter| position(letter));
    letters.dedup();
    let seeds = by_field().map(|(_, runs)| runs.len()).max().unwrap_or(0);
    let names: Vec<&str> = scenes
        .iter()
        .map(|scene| if scenes.len() > 1 { &*scene.name } else { scene.runs[0].task })
        .collect();
    let title =
        format!("{}: fields {}, {}", names.join(", "), letters.join(", "), counted(seeds, "seed"));
    let incomplete = |scene: &InspectedScene| {
        let reason =
            |run: &Inspected| Some(format!("{} {}.", scene.title(&run.name()), run.incomplete()?));
        scene.runs.iter().filter_map(reason).collect::<Vec<_>>()
    };
    let trouble: Vec<String> = scenes.iter().flat_map(incomplete).collect();
    let content = html! {
        (section("Result", html! {
            (table(&statistics::table_header(&outcomes, &[]), &statistics::table_of_scenes(&outcomes)))
            p.note {
                "Median, lowest and highest value over the seeds. Ratio of the median to that of R (otherwise M, S or C), with "
                (statistics::interval_note(&outcomes)) "."
                " A run failed if its final loss is not below that of the untrained policy."
                @if outcomes.iter().flat_map(|scene| &scene.runs).any(|run| run.diverged) {
                    " A run that ends at a non-finite number has no final loss (NaN), which ranks as the worst."
                }
            }
        }))
        (section("Learning", figures(learning::of_comparison(scenes))))
        @for scene in scenes {
            @if scene.runs.iter().any(|run| !run.numbers.is_empty()) {
                (section(&scene.title("Trained numbers"), trained_numbers(&scene.runs)))
            }
            @let firsts: Vec<&Inspected> = scene.runs.iter().filter(|run| run.rollouts.is_some()).collect();
            (section(&scene.title("Animation"), animations(&firsts)))
            (section(&scene.title("Gradients"), html! {
                (figures(diagnostics::of_epochs(&scene.runs).into_iter().chain(diagnostics::of_comparison(&scene.runs))))
                (remarks(&scene.runs))
            }))
        }
        @for scene in scenes {
            (section(&scene.title("Settings"), settings(&scene.runs.iter().collect::<Vec<_>>())))
        }
    };
    document(&title, Some(folder), version(&scenes[0].runs[0]), FIELDS, &trouble, &content)
}

/// Version of the program that made the run.
fn version(run: &Inspected) -> &str {
    run.settings.get("physgrad").and_then(Value::as_str).unwrap_or_default()
}

/// A page with a header and this content. `folder` is the name of the folder of the results, if
/// they have one.
pub fn document(
    title: &str,
    folder: Option<&str>,
    version: &str,
    note: &str,
    trouble: &[String],
    content: &Markup,
) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                // Forbids network requests by the contents of settings files and animations.
                meta http-equiv="Content-Security-Policy"
                    content="default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:";
                title { (title) @if let Some(folder) = folder { " (" (folder) ")" } }
                style { (PreEscaped(include_str!("style.css"))) }
            }
            body {
                header {
                    h1 { (title) }
                    p {
                        @if let Some(folder) = folder { "Folder " b { (folder) } ", made" } @else { "Made" }
                        " by physgrad " (version) "."
                    }
                    p.note { (note) }
                    (troubles(trouble))
                    p.hint hidden {
                        "To read values, point at a chart, or select it with Tab and use the arrow keys. To zoom, drag a \
                         rectangle or press +; a double click or 0 shows the whole chart. A click on a legend entry hides its \
                         curves."
                     }
                }
                main { (content) }
                script { (PreEscaped(include_str!("page.js"))) }
            }
        }
    }
    .into_string()
}

/// Messages of failed or interrupted runs, or warnings of an identification. Folds a long list.
fn troubles(troubles: &[String]) -> Markup {
    html! {
        @match troubles {
            [] => {}
            [one] => p.trouble { (one) },
            many => details.trouble open[many.len() < 4] {
                summary { (many.len()) " warnings" }
                ul { @for reason in many { li { (reason) } } }
            },
        }
    }
}

pub fn section(title: &str, content: Markup) -> Markup {
    html! { section { h2 { (title) } (content) } }
}

pub fn figures(figures: impl IntoIterator<Item = Figure>) -> Markup {
    html! { div.figures { @for figure in figures { (figure.html()) } } }
}

/// Largest number of columns that print at the usual size.
const MANY: usize = 8;

pub fn table(header: &[impl AsRef<str>], rows: &[impl AsRef<[String]>]) -> Markup {
    html! {
        div.wide.many[header.len() > MANY] { table {
            thead { tr { @for name in header { th scope="col" {
                // A long name of a setting may break after a dot.
                @for part in name.as_ref().split_inclusive('.') { (part) wbr; }
            } } } }
            tbody { @for row in rows { tr {
                // Repeats the column's name in each cell, for narrow screens.
                @for (name, cell) in header.iter().zip(row.as_ref()) { td data-name=(name.as_ref()) { (cell) } }
            } } }
        } }
    }
}

/// Table with the results of one run.
fn result(run: &Inspected) -> Markup {
    let header = [
        "epochs",
        "seconds",
        "final training loss",
        "final test loss",
        "best test loss",
        "skipped updates",
    ];
    let records = &run.records;
    let Some(last) = records.last() else {
        return html! { p { "No epoch is complete, so there are no losses." } };
    };
    let skipped: usize = records.iter().map(|r| r.skipped).sum();
    let row = [
        if records.len() < run.epochs {
            format!("{} of {}", records.len(), run.epochs)
        } else {
            records.len().to_string()
        },
        format!("{:.1}", run.outcome().seconds()),
        short(last.train_loss),
        short(last.test_loss),
        short(best(records)),
        skipped.to_string(),
    ];
    html! {
        (table(&header, &[row]))
        @if skipped > 0 { p.note { "An update is skipped if it contains a non-finite number." } }
    }
}

/// Table of the trained numbers of these runs. Nothing without such numbers.
fn trained_numbers(runs: &[Inspected]) -> Markup {
    let several = runs.len() > 1;
    let bound = |bound: f64| if bound.is_finite() { short(bound) } else { "none".into() };
    let row = |run: &Inspected, number: &ReportedNumber| -> Vec<String> {
        let ReportedNumber { name, bounds, values } = number;
        let first = several.then(|| run.name()).into_iter().chain([name.clone()]);
        first.chain(values.map(|value| digits(value, 6))).chain(bounds.map(bound)).collect()
    };
    let rows: Vec<Vec<String>> =
        runs.iter().flat_map(|run| run.numbers.iter().map(|number| row(run, number))).collect();
    let header = ["run", "trained number", "start", "final", "at best test loss", "min", "max"];
    html! { @if !rows.is_empty() { (table(&header[usize::from(!several)..], &rows)) } }
}

/// Animations of these runs.
fn animations(runs: &[&Inspected]) -> Markup {
    html! {
        div.figures { @for run in runs { @if let Some(rollouts) = &run.rollouts {
            figure {
                @if runs.len() > 1 { h3 { (run.name()) } }
                @let alt = format!("Animation of {} under the policy of {}", run.task, run.name());
                div.film role="img" aria-label=(alt) { (PreEscaped(rollouts.animation.to_svg())) }
            }
        } } }
        p.note {
            "One rollout from an initial state of the test set, under the saved policy."
            @if runs.len() > 1 { " All animations have the same scale and ranges." }
        }
    }
}

/// Notes on all gradient charts.
fn remarks(runs: &[Inspected]) -> Markup {
    html! {
        @if let Some(missing) = diagnostics::missing(runs) { p.note { (missing) } }
        p.note {
            "Adjoints are computed from at most " (SAMPLES) " test initial states. Charts omit values outside the range of their \
             axes, and thin out lines with many points."
        }
    }
}

/// Tables of all settings. Lists every value of a setting that differs between runs.
fn settings(runs: &[&Inspected]) -> Markup {
    let mut values: Vec<(String, Vec<String>)> = Vec::new();
    for (key, value) in runs.iter().flat_map(|run| flat(&run.settings)) {
        match values.iter_mut().find(|(other, _)| *other == key) {
            Some((_, values)) if values.contains(&plain(&value)) => {}
            Some((_, values)) => values.push(plain(&value)),
            None => values.push((key, vec![plain(&value)])),
        }
    }
    let section = |key: &str| key.rsplit_once('.').map_or("run", |(section, _)| section).to_owned();
    html! {
        div.settings { @for settings in values.chunk_by(|a, b| section(&a.0) == section(&b.0)) {
            table {
                caption { (section(&settings[0].0)) }
                tbody { @for (key, values) in settings {
                    tr { th scope="row" { (key.rsplit('.').next().unwrap_or(key)) } td { (values.join(", ")) } }
                } }
            }
        } }
        @if runs.len() > 1 { p.note { "Where several values are listed, each run has one of them." } }
    }
}

/// Formats a value without TOML quotes. Floats of magnitudes below 1e-4 or from 1e6 on have an
/// exponent; 0 has none.
fn plain(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Float(x) if *x != 0.0 && !(1e-4..1e6).contains(&x.abs()) => format!("{x:e}"),
        value => value.to_string(),
    }
}

//! `physgrad compare`: one training configuration with several fields and seeds, side by side.

use crate::Field;
use crate::numbers::text::short;
use crate::program::platform::csv::csv;
use crate::program::platform::folder::{Folder, SETTINGS};
use crate::program::platform::json::{print_json, rows};
use crate::program::platform::table::Table;
use crate::program::platform::terminal::{counted, print_message, print_note, print_text};
use crate::program::runs::run::threads;
use crate::program::runs::statistics::{self, Outcome, best, by_field, curves, field_label, quantile, sorted};
use crate::program::runs::sweep::{Comparison, check_distinct, check_options, check_sessions, sweep};
use crate::program::scenes::overrides::{Overrides, take_several};
use crate::program::scenes::presets;
use crate::program::scenes::sweep::Point;
use crate::program::settings::FieldName;
use crate::program::tasks::Scene;
use crate::report::{Curve, Drawing, Series, comparison, field_color, settings};
use anyhow::{Result, bail};
use serde_json::json;
use std::path::PathBuf;
use toml::Value;

/// Train with several fields and seeds, and compare the results; in one scene or in several, which
/// may differ in integrator or precision.
///
/// `--set KEY=VALUE,VALUE` and a section `[sweep]` train every combination of values.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  physgrad compare cart_pole --fields R,M,S,C --seeds 3 -o runs/fields\n  physgrad compare cart_pole --set training.learning_rate=0.001,0.01 --fields C\n  physgrad compare a.toml b.toml --fields C"
)]
#[command(mut_arg("field", |arg| arg.hide(true)))]
pub struct Compare {
    /// A task or another preset (see `physgrad scene`), or the path of a scene; several scenes are
    /// compared with each other
    #[arg(required = true, value_name = "SCENE")]
    pub scenes: Vec<String>,
    /// Fields to compare
    #[arg(long, value_delimiter = ',', default_value = "R,M,S,C", value_parser = |name: &str| name.parse().map(FieldName))]
    pub fields: Vec<FieldName>,
    /// Number of seeds, counted from --seed
    #[arg(long, value_name = "K", default_value_t = 3)]
    pub seeds: u64,
    #[command(flatten)]
    pub overrides: Overrides,
    /// Number of threads, one run each [default: RAYON_NUM_THREADS, or all cores]
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Folder for the results; runs already in it are resumed [default: a new one in `runs`]
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Require that --out holds runs of this comparison, and resume them
    #[arg(long, requires = "out")]
    pub resume: bool,
    /// Print only warnings and errors
    #[arg(short, long)]
    pub quiet: bool,
    /// Print the result as one JSON object; messages stay on standard error (docs/json.md)
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
pub fn compare(args: &Compare) -> Result<()> {
    if args.overrides.field.is_some() || args.overrides.set.iter().any(|set| set.trim_start().starts_with("field")) {
        bail!("`field` is set, but a comparison trains several fields; choose them with --fields");
    }
    let names: Vec<String> = args.scenes.iter().map(|scene| presets::short_name(scene)).collect();
    check_distinct("the command", names.iter().map(String::as_str))?;
    let cases = args.scenes.iter().map(|scene| cases(scene, args)).collect::<Result<Vec<_>>>()?.concat();
    check_distinct("the sweep", cases.iter().map(|case| &*case.name))?;
    for case in &cases {
        check_options(&args.fields, args.seeds, case.scene.epochs)?;
    }
    threads(args.threads)?;
    if !args.quiet
        && let Some(note) = cases.iter().find_map(|case| case.scene.large_batch())
    {
        print_message(&note);
    }
    check_sessions(cases.iter().map(|case| &case.scene), &args.fields)?;
    let folder = Folder::named(args.out.as_deref(), &format!("compare-{}", names.join("-")))?;
    if folder.has(SETTINGS) {
        bail!("{} holds a run and is not a comparison; choose another folder with --out", folder.path().display());
    }
    let one = cases.len() == 1;
    let mut comparisons = Vec::new();
    for Case { name, scene, .. } in &cases {
        // Several cases have one comparison folder each, inside this folder.
        let inner = if one { Folder::clone(&folder) } else { Folder::at(folder.file(name)) };
        comparisons.push(Comparison::plan(name, scene, &args.fields, args.seeds, &inner)?);
    }
    if args.resume && !comparisons.iter().any(Comparison::has_runs) {
        bail!("there is no run to resume in {}; omit --resume to start", folder.path().display());
    }
    let swept = sweep(&mut comparisons, args.quiet)?;
    if swept.interrupted {
        let text = format!("interrupted; to resume, repeat the command with --out {}", folder.path().display());
        let _ = print_note(&text, args.json);
        return swept.into_result();
    }
    let finished: Vec<Finished> =
        cases.iter().zip(&comparisons).map(|(case, comparison)| Finished { case, runs: comparison.outcomes() }).collect();
    let runs = summary(&finished)?;
    folder.write("summary.csv", &runs)?;
    let title = format!("{}, {}", names.join(", "), counted(args.seeds as usize, "seed"));
    let mut files = vec!["summary.csv"];
    if finished.len() <= MAX_CURVES {
        folder.write("curves.svg", comparison(&title, &all_curves(&finished)).to_svg())?;
        files.push("curves.svg");
    }
    if let Some(picture) = sweep_picture(&title, &finished) {
        folder.write("sweep.svg", picture.to_svg())?;
        files.push("sweep.svg");
    }
    files.push(if one { "all runs in runs/" } else { "one folder per case" });
    if args.json {
        print_json(&json!({ "folder": folder.path(), "runs": rows(&runs)? }))?;
    } else if !args.quiet {
        print_text(&format!("{}\n{}{}", table(&finished), statistics::TABLE_NOTE, lowest(&finished)))?;
        print_text(&format!("results in {}: {}", folder.path().display(), files.join(", ")))?;
    }
    swept.into_result()
}

/// A scene at one point of its sweep.
#[derive(Clone)]
struct Case {
    /// Name of scene and point. Empty if there is only one case.
    name: String,
    point: Point,
    scene: Scene,
}

/// Runs of one case.
struct Finished<'a> {
    case: &'a Case,
    runs: Vec<Outcome<'a>>,
}

/// Largest number of cases whose learning curves are drawn.
const MAX_CURVES: usize = 8;

/// The points of the sweep of a scene; a single one without a sweep.
fn cases(name: &str, args: &Compare) -> Result<Vec<Case>> {
    let mut source = presets::source(name)?;
    let mut sweep = source.take_sweep();
    let mut overrides = args.overrides.clone();
    take_several(&mut overrides.set, &mut sweep)?;
    let points = sweep.points()?;
    // Messages of a comparison of one scene omit its name.
    let short = if args.scenes.len() == 1 { String::new() } else { presets::short_name(name) };
    let case = |point: Point| {
        let mut source = source.clone();
        overrides.apply(&mut source)?;
        point.apply(&mut source)?;
        let name = [short.clone(), point.name()].into_iter().filter(|name| !name.is_empty()).collect::<Vec<_>>().join("+");
        Ok(Case { name, point, scene: source.scene()? })
    };
    points.into_iter().map(case).collect()
}

/// Okabe-Ito colours with grey in place of yellow, one per scene and field. Curves of a single
/// scene have the colours of the fields instead.
const COLORS: [&str; 8] = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#999999"];

/// One curve per scene and field.
fn all_curves(cases: &[Finished]) -> Vec<Curve> {
    let each = cases
        .iter()
        .flat_map(|Finished { case, runs }| curves(runs, |r| r.test_loss).into_iter().map(|curve| (&*case.name, curve)));
    let named = |(i, (name, curve)): (usize, (&str, Curve))| {
        if name.is_empty() {
            return curve;
        }
        Curve { label: format!("{name}: {}", curve.label), color: COLORS[i % COLORS.len()], ..curve }
    };
    each.enumerate().map(named).collect()
}

/// Swept keys of all cases.
fn swept_keys(cases: &[Finished]) -> Vec<String> {
    let mut keys: Vec<String> = Vec::new();
    for (key, _) in cases.iter().flat_map(|finished| &finished.case.point.0) {
        if !keys.contains(key) {
            keys.push(key.clone());
        }
    }
    keys
}

/// Value of a key at the point of a case. None for a case without the key.
fn value<'a>(case: &'a Case, key: &str) -> Option<&'a Value> {
    case.point.0.iter().find(|(own, _)| own == key).map(|(_, value)| value)
}

/// `summary.csv`: one row per run, with a column for each swept setting. Final losses of a failed
/// run are NaN.
fn summary(cases: &[Finished]) -> Result<Vec<u8>> {
    let keys = swept_keys(cases);
    // Omits the name of a single case.
    let case = if cases.len() > 1 { &["case"][..] } else { &[] };
    let numbers = ["field", "seed", "final_train_loss", "final_test_loss", "best_test_loss", "seconds"];
    let header = case.iter().copied().chain(keys.iter().map(String::as_str)).chain(numbers);
    let runs = cases.iter().flat_map(|Finished { case, runs }| runs.iter().map(move |run| (*case, run)));
    let rows = runs.map(|(found, run)| {
        let name = case.iter().map(|_| found.name.clone());
        let swept = keys.iter().map(|key| value(found, key).map_or_else(String::new, text));
        let names = [run.field.letter().to_owned(), run.seed.to_string()];
        let numbers = [run.last(|r| r.train_loss), run.last(|r| r.test_loss), best(run.records), run.seconds()];
        name.chain(swept).chain(names).chain(numbers.map(|x| x.to_string())).collect::<Vec<_>>()
    });
    csv(header, rows)
}

/// Text of a value in a table.
fn text(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), String::from)
}

/// Final test losses against each swept setting with numeric values: one panel per setting, one
/// line per field. None without such a setting.
fn sweep_picture(title: &str, cases: &[Finished]) -> Option<Drawing> {
    let number = |value: &Value| value.as_float().or_else(|| value.as_integer().map(|x| x as f64));
    let panel = |key: &String| {
        let mut values: Vec<f64> = cases.iter().filter_map(|finished| number(value(finished.case, key)?)).collect();
        values.sort_by(f64::total_cmp);
        values.dedup();
        let losses = |field: Field, at: f64| {
            let cases = cases.iter().filter(move |finished| value(finished.case, key).and_then(number) == Some(at));
            let runs = cases.flat_map(|finished| &finished.runs).filter(move |run| run.field == field);
            sorted(runs.map(|run| run.last(|r| r.test_loss)))
        };
        let series = |(field, _): (Field, &[Outcome])| {
            let points: Vec<(f64, Vec<f64>)> = values.iter().map(|&at| (at, losses(field, at))).collect();
            let line = points.iter().map(|(at, losses)| (*at, quantile(losses, 0.5))).collect();
            let band = points.iter().map(|(_, losses)| (quantile(losses, 0.25), quantile(losses, 0.75))).collect();
            Series { band, ..Series::new(field_label(field), field_color(field.letter()), line) }
        };
        (values.len() > 1).then(|| (key.clone(), by_field(&cases[0].runs).map(series).collect()))
    };
    let panels: Vec<_> = swept_keys(cases).iter().filter_map(panel).collect();
    (!panels.is_empty()).then(|| settings(&format!("{title}: median and quartiles of the final test loss"), panels))
}

/// Case and field with the lowest median of the final test loss. Empty for a single case.
fn lowest(cases: &[Finished]) -> String {
    let median = |runs: &[Outcome]| quantile(&sorted(runs.iter().map(|run| run.last(|r| r.test_loss))), 0.5);
    let fields = |finished: &'_ Finished| by_field(&finished.runs).map(|(field, runs)| (median(runs), field)).collect::<Vec<_>>();
    let all =
        cases.iter().flat_map(|finished| fields(finished).into_iter().map(|(loss, field)| (loss, &finished.case.name, field)));
    match all.filter(|(loss, ..)| !loss.is_nan()).min_by(|a, b| a.0.total_cmp(&b.0)) {
        Some((loss, case, field)) if cases.len() > 1 => {
            format!("\nlowest median final test loss: {case}, {field}: {}", short(loss))
        }
        _ => String::new(),
    }
}

fn table(cases: &[Finished]) -> Table {
    let several = cases.len() > 1;
    let header = ["case"].into_iter().chain(statistics::TABLE_HEADER).skip(usize::from(!several));
    let mut table = Table::new(header).optional(&statistics::OPTIONAL);
    for Finished { case, runs } in cases {
        for row in statistics::table(runs) {
            table.row([case.name.replace('+', " ")].into_iter().chain(row).skip(usize::from(!several)));
        }
    }
    table
}

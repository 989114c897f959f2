//! `physgrad compare`: one training configuration with several fields and seeds, side by side.

use crate::program::platform::csv::csv;
use crate::program::platform::folder::{Folder, SETTINGS};
use crate::program::platform::terminal::print_result;
use crate::program::runs::run::threads;
use crate::program::runs::saved::changed;
use crate::program::runs::statistics::{self, Outcome, best, curves};
use crate::program::runs::sweep::{Comparison, check_distinct, check_options, check_sessions, sweep};
use crate::program::scenes::overrides::Overrides;
use crate::program::scenes::presets;
use crate::program::settings::FieldName;
use crate::program::tasks::Scene;
use crate::report::{Curve, comparison};
use anyhow::{Result, bail};
use comfy_table::Table;
use comfy_table::presets::UTF8_FULL_CONDENSED;
use std::path::PathBuf;

/// Train with several fields and seeds, and compare the results; in one scene or in several, which
/// may differ in integrator or precision.
#[derive(Debug, clap::Args)]
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
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print only warnings and errors
    #[arg(long)]
    pub quiet: bool,
}

/// Runs the command.
pub fn compare(args: &Compare) -> Result<()> {
    if args.overrides.field.is_some() || args.overrides.set.iter().any(|set| set.trim_start().starts_with("field")) {
        bail!("`field` is set, but a comparison trains several fields; choose them with --fields");
    }
    let names: Vec<String> = args.scenes.iter().map(|scene| presets::short_name(scene)).collect();
    check_distinct("the command", names.iter().map(String::as_str))?;
    let bases = args.scenes.iter().map(|scene| changed(scene, &args.overrides)).collect::<Result<Vec<Scene>>>()?;
    for base in &bases {
        check_options(&args.fields, args.seeds, base.epochs)?;
    }
    threads(args.threads)?;
    check_sessions(&bases, &args.fields)?;
    let folder = Folder::named(args.out.as_deref(), &format!("compare-{}", names.join("-")))?;
    if folder.has(SETTINGS) {
        bail!("{} holds a run and is not a comparison; choose another folder with --out", folder.path().display());
    }
    let one = bases.len() == 1;
    let mut comparisons = Vec::new();
    for (name, base) in names.iter().zip(&bases) {
        // Several scenes have one comparison folder each, inside this folder.
        let (label, inner) = if one { ("", Folder::clone(&folder)) } else { (&**name, Folder::at(folder.file(name))) };
        comparisons.push(Comparison::plan(label, base, &args.fields, args.seeds, &inner)?);
    }
    let swept = sweep(&mut comparisons, args.quiet)?;
    if swept.interrupted {
        let _ = print_result(&format!("interrupted; to resume, repeat the command with --out {}", folder.path().display()));
        return swept.into_result();
    }
    let scenes: Vec<InScene> = names
        .iter()
        .zip(&comparisons)
        .map(|(name, comparison)| InScene { name: if one { "" } else { name }, runs: comparison.outcomes() })
        .collect();
    folder.write("summary.csv", summary(&scenes)?)?;
    let title = format!("{}, {} seed{}", names.join(", "), args.seeds, if args.seeds == 1 { "" } else { "s" });
    folder.write("curves.svg", comparison(&title, &all_curves(&scenes)).to_svg())?;
    if !args.quiet {
        let files = if one {
            "summary.csv, curves.svg, and all runs in runs/"
        } else {
            "summary.csv, curves.svg, and one folder per scene"
        };
        print_result(&format!("{}\nresults in {}: {files}", table(&scenes), folder.path().display()))?;
    }
    swept.into_result()
}

/// Runs of one scene. The name is empty if there is only one scene.
struct InScene<'a> {
    name: &'a str,
    runs: Vec<Outcome<'a>>,
}

/// Okabe-Ito colours with grey in place of yellow, one per scene and field. Curves of a single
/// scene have the colours of the fields instead.
const COLORS: [&str; 8] = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#999999"];

/// One curve per scene and field.
fn all_curves(scenes: &[InScene]) -> Vec<Curve> {
    let each = scenes.iter().flat_map(|scene| curves(&scene.runs, |r| r.test_loss).into_iter().map(|curve| (scene.name, curve)));
    let named = |(i, (name, curve)): (usize, (&str, Curve))| {
        if name.is_empty() {
            return curve;
        }
        Curve { label: format!("{name}: {}", curve.label), color: COLORS[i % COLORS.len()], ..curve }
    };
    each.enumerate().map(named).collect()
}

/// `summary.csv`: one row per run. Final losses of a failed run are NaN.
fn summary(scenes: &[InScene]) -> Result<Vec<u8>> {
    // Omits the name of a single scene.
    let omitted = usize::from(scenes.len() <= 1);
    let header = ["scene", "field", "seed", "final_train_loss", "final_test_loss", "best_test_loss", "seconds"];
    let runs = scenes.iter().flat_map(|scene| scene.runs.iter().map(move |run| (scene, run)));
    let rows = runs.map(|(scene, run)| {
        let numbers = [run.last(|r| r.train_loss), run.last(|r| r.test_loss), best(run.records), run.seconds()];
        let names = [scene.name.to_owned(), run.field.letter().to_owned(), run.seed.to_string()];
        names.into_iter().skip(omitted).chain(numbers.map(|x| x.to_string()))
    });
    csv(&header[omitted..], rows)
}

fn table(scenes: &[InScene]) -> Table {
    let mut table = Table::new();
    let several = scenes.len() > 1;
    let header = ["scene"].into_iter().chain(statistics::TABLE_HEADER).skip(usize::from(!several));
    table.load_style(UTF8_FULL_CONDENSED).set_header(header);
    for scene in scenes {
        for row in statistics::table(&scene.runs) {
            table.add_row([scene.name.to_owned()].into_iter().chain(row).skip(usize::from(!several)));
        }
    }
    table
}

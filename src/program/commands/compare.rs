//! `physgrad compare`: one training configuration with several fields and seeds, side by side.

use crate::program::platform::csv::csv;
use crate::program::platform::folder::{Folder, SETTINGS};
use crate::program::platform::terminal::print_result;
use crate::program::runs::run::threads;
use crate::program::runs::saved::changed;
use crate::program::runs::statistics::{InScene, MAX_DASHED, best, curves, curves_of_scenes, table_header, table_of_scenes};
use crate::program::runs::sweep::{Comparison, check_distinct, check_options, check_sessions, sweep};
use crate::program::scenes::overrides::Overrides;
use crate::program::scenes::presets;
use crate::program::settings::FieldName;
use crate::program::tasks::Scene;
use crate::report::{Abscissa, Case, Drawing, comparison, study};
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
    let one_task = bases.iter().all(|base| base.task.name() == bases[0].task.name());
    folder.write("curves.svg", picture(&title, &scenes, one_task).to_svg())?;
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

/// Panels side by side, if every scene has its own.
const COLUMNS: usize = 4;

/// Test losses of all scenes. Draws up to three scenes in one panel with dashes, and more scenes in
/// one panel each. Panels of one task share the range of their y axes.
fn picture(title: &str, scenes: &[InScene], one_task: bool) -> Drawing {
    if scenes.len() <= MAX_DASHED {
        return comparison(title, &curves_of_scenes(scenes, |r| r.test_loss));
    }
    let columns = scenes.len().div_ceil(scenes.len().div_ceil(COLUMNS));
    let row = |x: Abscissa, first: usize, scenes: &[InScene]| -> Vec<Case> {
        // Fills the last row with empty cases, which are not drawn.
        let case = |i: usize| Case {
            title: scenes.get(i).map(|scene| scene.name).filter(|_| x == Abscissa::Epoch).unwrap_or_default().to_owned(),
            y_label: "test loss".into(),
            y_axis: if one_task { 0 } else { first + i },
            x,
            curves: scenes.get(i).map(|scene| curves(&scene.runs, |r| r.test_loss)).unwrap_or_default(),
        };
        (0..columns).map(case).collect()
    };
    let rows = scenes.chunks(columns).enumerate();
    let rows = rows.flat_map(|(i, scenes)| [Abscissa::Epoch, Abscissa::Seconds].map(|x| row(x, i * columns, scenes)));
    study(title, &rows.collect::<Vec<_>>())
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
    table.load_style(UTF8_FULL_CONDENSED).set_header(table_header(scenes));
    table.add_rows(table_of_scenes(scenes));
    table
}

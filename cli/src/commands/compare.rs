//! `physgrad compare`: short form of a plan of scenes, fields and seeds.

use crate::commands::study::{Running, Trainings};
use crate::runs::comparison::{check_distinct, check_options};
use crate::scenes::overrides::{Overrides, take_several};
use crate::scenes::plan::{Contents, Plan, PlannedTask};
use crate::scenes::presets;
use crate::settings::FieldName;
use anyhow::{Result, bail};
use toml::{Table, Value};

/// Train with several fields and seeds, in one scene or several, and compare the results.
///
/// Scenes may differ in any setting, for example in integrator or precision. `--set
/// KEY=VALUE,VALUE` trains every combination of values. docs/runs.md describes plans, which also
/// compare other methods than fields.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  physgrad compare cart_pole --fields R,M,S,C --seeds 3 -o runs/fields\n  physgrad compare cart_pole --seeds 32 --shard 3/16 -o runs/fields\n  physgrad compare cart_pole --set training.learning_rate=0.001,0.01 --fields C\n  physgrad compare a.toml b.toml --fields C"
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
    /// Require that --out holds runs of this comparison, and resume them
    #[arg(long, requires = "out", conflicts_with = "shard")]
    pub resume: bool,
    #[command(flatten)]
    pub running: Running,
}

/// Runs the command.
pub fn compare(args: &Compare) -> Result<()> {
    let sets_field = |set: &String| set.split('=').next().is_some_and(|key| key.trim() == "field");
    if args.overrides.field.is_some() || args.overrides.set.iter().any(sets_field) {
        bail!("`field` is set, but a comparison trains several fields; choose them with --fields");
    }
    let names: Vec<String> = args.scenes.iter().map(|scene| presets::short_name(scene)).collect();
    check_distinct("the command", names.iter().map(String::as_str))?;
    let epochs = args.overrides.epochs.map(|epochs| epochs as usize);
    check_options(Some(&args.fields), Some(args.seeds), epochs)?;
    let mut overrides = args.overrides.clone();
    let grid = take_several(&mut overrides)?;
    let source = |scene: &String| {
        let mut source = presets::source(scene)?;
        overrides.apply(&mut source)?;
        Ok(source)
    };
    let sources = args.scenes.iter().map(source).collect::<Result<Vec<_>>>()?;
    // A single scene needs no name in folders and tables.
    let task = |name: &String| PlannedTask {
        name: Some(if names.len() == 1 { String::new() } else { name.clone() }),
        scene: Value::Table(Table::new()),
        set: Table::new(),
    };
    let contents = Contents {
        title: Some(names.join(", ")),
        seeds: args.seeds,
        fields: args.fields.clone(),
        grid,
        tasks: names.iter().map(task).collect(),
        ..Contents::default()
    };
    let trainings = Trainings::new(Plan::of("--set", sources, contents)?)?;
    let folder = args.running.folder(&format!("compare-{}", names.join("-")))?;
    if args.resume && !trainings.has_runs(&folder)? {
        bail!("there is no run to resume in {}; omit --resume to start", folder.path().display());
    }
    trainings.train(&folder, &args.running, folder.path())?.print(args.running.output())
}

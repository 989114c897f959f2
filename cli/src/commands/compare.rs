//! `physgrad compare`: trainings with several fields and seeds, in one scene or several.

mod sweep;

use crate::commands::animate::draw;
use crate::platform::folder::{COMPARISON, Folder, SETTINGS, STUDY, is_name};
use crate::platform::json::{print_json, rows};
use crate::platform::table::Table;
use crate::platform::terminal::{counted, print_message, print_note, print_text, program};
use crate::runs::comparison::{
    Comparison, Ended, check_distinct, check_estimator, check_options, check_runs, check_sessions,
    read_all, read_plan, train_all, train_shard, write_plan,
};
use crate::runs::shard::Shard;
use crate::runs::statistics::{
    InScene, MAX_DASHED, OPTIONAL, TABLE_NOTE, curves, curves_of_scenes, table_header,
    table_of_scenes,
};
use crate::scenes::overrides::{Overrides, take_several};
use crate::scenes::presets;
use crate::scenes::source::SceneSource;
use crate::scenes::sweep::Point;
use crate::settings::FieldName;
use crate::tasks::Scene;
use crate::tasks::scene::INITIAL_POLICY;
use anyhow::{Context, Result, bail};
use physgrad_plot::{Abscissa, Case, Drawing, comparison, study};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::path::PathBuf;

/// Train with several fields and seeds, in one scene or several, and compare the results.
///
/// Scenes may differ in any setting, for example in integrator or precision.
///
/// `--set KEY=VALUE,VALUE` and a section `[sweep]` train every combination of values.
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
    /// Number of threads, one run each [default: RAYON_NUM_THREADS, or all cores]
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Folder for the results; runs already in it are resumed [default: a new one in `runs`]
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Require that --out holds runs of this comparison, and resume them
    #[arg(long, requires = "out")]
    pub resume: bool,
    /// Train share K of N of the runs, then all other runs that no process holds. Other shards may
    /// train in the same folder, on any machine. Run `physgrad merge` afterwards (docs/runs.md)
    #[arg(long, value_name = "K/N", requires = "out", conflicts_with_all = ["resume", "json"])]
    pub shard: Option<Shard>,
    /// Print only warnings and errors
    #[arg(short, long)]
    pub quiet: bool,
    /// Print the result as one JSON object; messages stay on standard error (docs/runs.md)
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
pub fn compare(args: &Compare) -> Result<()> {
    let sets_field = |set: &String| set.split('=').next().is_some_and(|key| key.trim() == "field");
    if args.overrides.field.is_some() || args.overrides.set.iter().any(sets_field) {
        bail!("`field` is set, but a comparison trains several fields; choose them with --fields");
    }
    let names: Vec<String> = args.scenes.iter().map(|scene| presets::short_name(scene)).collect();
    check_distinct("the command", names.iter().map(String::as_str))?;
    let points = args
        .scenes
        .iter()
        .map(|scene| sweep_points(scene, args))
        .collect::<Result<Vec<_>>>()?
        .concat();
    check_distinct("the sweep", points.iter().map(|point| &*point.name))?;
    for point in &points {
        check_options(&args.fields, args.seeds, point.scene.epochs)?;
        check_estimator(&point.scene, &args.fields)?;
    }
    check_runs(points.len(), args.fields.len(), args.seeds)?;
    if !args.quiet
        && let Some(note) = points.iter().find_map(|point| point.scene.large_batch())
    {
        print_message(&note);
    }
    check_sessions(points.iter().map(|point| &point.scene), &args.fields)?;
    let folder = match (args.shard, &args.out) {
        (Some(_), Some(out)) => Folder::at(out).share()?,
        (_, out) => Folder::named(out.as_deref(), &format!("compare-{}", names.join("-")))?,
    };
    check_folder(&folder, "comparison", &[(SETTINGS, "run"), (STUDY, "study")])?;
    let mut comparisons = plan(&points, &args.fields, args.seeds, &folder)?;
    if args.resume && !comparisons.iter().any(Comparison::has_runs) {
        bail!("there is no run to resume in {}; omit --resume to start", folder.path().display());
    }
    // Shards compare their plan with that of the folder.
    if args.shard.is_none() {
        comparisons.iter().try_for_each(Comparison::check_resumable)?;
    }
    // The layout of the folder depends on the number of points. One point has its runs in `runs`.
    // Several points have a subfolder each.
    let saved = folder.has(COMPARISON).then(|| read_plan::<Plan>(&folder)).transpose();
    let saved = saved.with_context(|| {
        format!("{} holds other results; choose another folder with --out", folder.path().display())
    })?;
    if let Some(mut saved) = saved
        && let Some(other) = match (saved.points.len(), &points[..]) {
            (1, [point]) => {
                let is_same = saved.points.remove(0).open(&folder)?.scene.comparable()
                    == point.scene.comparable();
                (!is_same).then(|| format!("{} with other settings", saved.scenes.join(", ")))
            }
            (1, _) => Some("one scene or point".into()),
            (_, [_]) => Some("several scenes or points".into()),
            _ => None,
        }
    {
        bail!(
            "{} holds a comparison of {other}; choose another folder with --out",
            folder.path().display()
        );
    }
    let plan = Plan::new(&names, &points, args);
    for (point, planned) in points.iter().zip(&plan.points) {
        if let (Some(name), Some(policy)) = (&planned.initial_policy, point.scene.initial_policy())
        {
            folder.write(name, policy)?;
        }
    }
    write_plan(&folder, &plan, args.shard.is_some())?;
    let output = Output { quiet: args.quiet, json: args.json };
    train(&mut comparisons, args.shard, &folder, output, |comparisons| {
        write_outputs(&names, args.seeds, &points, comparisons, &folder, output)
    })
}

/// Trains all runs, then writes their tables and pictures with `write_outputs`. A shard and an
/// interrupted training write neither.
pub fn train(
    comparisons: &mut [Comparison],
    shard: Option<Shard>,
    folder: &Folder,
    output: Output,
    write_outputs: impl FnOnce(&[Comparison]) -> Result<()>,
) -> Result<()> {
    let path = folder.path().display();
    let ended = match shard {
        Some(shard) => train_shard(comparisons, shard, output.quiet)?,
        None => train_all(comparisons, output.quiet)?,
    };
    if ended.interrupted {
        let text = match shard {
            Some(_) => format!(
                "interrupted; to resume in {path}, repeat the command, or start any other shard"
            ),
            None => format!("interrupted; to resume, repeat the command with --out {path}"),
        };
        let _ = print_note(&text, output.json);
    } else if shard.is_none() {
        write_outputs(comparisons)?;
    } else if !output.quiet {
        print_message(&format!(
            "to make tables and pictures of all runs:\n{} merge {path}",
            program()
        ));
    }
    ended.into_result()
}

/// Checks that the folder has none of these files. Each pair holds the name of a file, and the
/// unexpected results that it indicates. `expected` names the expected results.
pub fn check_folder(folder: &Folder, expected: &str, files: &[(&str, &str)]) -> Result<()> {
    match files.iter().find(|(file, _)| folder.has(file)) {
        Some((_, found)) => {
            bail!(
                "{} holds a {found} and is not a {expected}; choose another folder with --out",
                folder.path().display()
            )
        }
        None => Ok(()),
    }
}

/// Makes the tables and pictures of the comparison in the folder from its runs, without training.
pub fn merge(folder: &Folder, output: Output) -> Result<Ended> {
    let plan: Plan = read_plan(folder)
        .context("for a figure of `paper`, name the folder that contains its folder")?;
    check_runs(plan.points.len(), plan.fields.len(), plan.seeds)?;
    let points =
        plan.points.into_iter().map(|point| point.open(folder)).collect::<Result<Vec<_>>>()?;
    let mut comparisons = self::plan(&points, &plan.fields, plan.seeds, folder)?;
    let ended = read_all(&mut comparisons)?;
    write_outputs(&plan.scenes, plan.seeds, &points, &comparisons, folder, output)?;
    Ok(ended)
}

/// Output on the terminal.
#[derive(Clone, Copy, Debug)]
pub struct Output {
    pub quiet: bool,
    pub json: bool,
}

/// Plans the runs of all points.
fn plan(
    points: &[SweepPoint],
    fields: &[FieldName],
    seeds: u64,
    folder: &Folder,
) -> Result<Vec<Comparison>> {
    let plan = |SweepPoint { name, scene, .. }: &SweepPoint| {
        // Several points have one comparison folder each, inside this folder.
        let inner = if points.len() == 1 { folder.clone() } else { folder.inside(name)? };
        Comparison::plan(name, scene, fields, seeds, &inner)
    };
    points.iter().map(plan).collect()
}

/// Writes tables and pictures.
fn write_outputs(
    names: &[String],
    seeds: u64,
    points: &[SweepPoint],
    comparisons: &[Comparison],
    folder: &Folder,
    output: Output,
) -> Result<()> {
    let scenes: Vec<InScene> = points
        .iter()
        .zip(comparisons)
        .map(|(point, comparison)| InScene { name: &point.name, runs: comparison.outcomes() })
        .collect();
    let runs = sweep::summary(points, &scenes)?;
    folder.write("summary.csv", &runs)?;
    let title = format!("{}, {}", names.join(", "), counted(seeds as usize, "seed"));
    let mut files = vec!["summary.csv"];
    if scenes.len() <= MAX_PANELS {
        let one_task =
            points.iter().all(|point| point.scene.task.name() == points[0].scene.task.name());
        folder.write("curves.svg", picture(&title, &scenes, one_task).to_svg())?;
        files.push("curves.svg");
        // Redraws the animations of the runs, with one scale per scene.
        comparisons
            .iter()
            .try_for_each(|comparison| draw(&comparison.ended(), 0, &comparison.ended()))?;
    }
    if let Some(picture) = sweep::picture(&title, points, &scenes) {
        folder.write("sweep.svg", picture.to_svg())?;
        files.push("sweep.svg");
    }
    files.push(if points.len() == 1 { "all runs in runs/" } else { "one folder per scene" });
    if output.json {
        print_json(&json!({ "folder": folder.path(), "runs": rows(&runs)? }))?;
    } else if !output.quiet {
        let mut table = Table::new(table_header(&scenes)).optional(&OPTIONAL);
        table_of_scenes(&scenes).into_iter().for_each(|row| table.row(row));
        print_text(&format!("{table}\n{TABLE_NOTE}{}", sweep::lowest(&scenes)))?;
        print_text(&format!("results in {}: {}", folder.path().display(), files.join(", ")))?;
    }
    Ok(())
}

/// Contents of `comparison.toml`: the runs of a comparison, independent of scene files.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Plan {
    /// Version of the program.
    physgrad: String,
    scenes: Vec<String>,
    fields: Vec<FieldName>,
    seeds: u64,
    points: Vec<PlannedPoint>,
}

#[derive(Serialize, Deserialize)]
struct PlannedPoint {
    name: String,
    /// Keys and values of the sweep.
    sweep: Vec<(String, toml::Value)>,
    /// Name of a copy of the initial policy, beside the plan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    initial_policy: Option<String>,
    /// Text of the scene.
    scene: String,
}

impl Plan {
    fn new(names: &[String], points: &[SweepPoint], args: &Compare) -> Self {
        let point = |SweepPoint { name, point, scene }: &SweepPoint| {
            let mut table = scene.table.clone();
            table.remove(INITIAL_POLICY);
            // One copy per point, because a sweep may vary the policy. The checksum differs for
            // shards with different policies.
            let copy = |checksum| format!("initial_policy_{checksum:08x}.safetensors");
            let initial_policy = scene.initial_policy_checksum().map(copy);
            PlannedPoint {
                name: name.clone(),
                sweep: point.0.clone(),
                initial_policy,
                scene: table.to_string(),
            }
        };
        Self {
            physgrad: env!("CARGO_PKG_VERSION").into(),
            scenes: names.to_vec(),
            fields: args.fields.clone(),
            seeds: args.seeds,
            points: points.iter().map(point).collect(),
        }
    }
}

impl PlannedPoint {
    fn open(self, folder: &Folder) -> Result<SweepPoint> {
        let scene =
            SceneSource::parse(&format!("the plan of {}", self.name), &self.scene)?.scene()?;
        let scene = match &self.initial_policy {
            Some(name) if is_name(name) => scene.starting_from(folder.read(name)?),
            Some(name) => {
                bail!(
                    "{}: `initial_policy` is {name:?}; allowed: a file beside the plan",
                    folder.file(COMPARISON).display()
                )
            }
            None => scene,
        };
        Ok(SweepPoint { name: self.name, point: Point(self.sweep), scene })
    }
}

/// A scene at one point of its sweep.
#[derive(Clone)]
struct SweepPoint {
    /// Names of scene and point, joined by `+`. Omits the name of the scene if the command names
    /// only one scene. Omits the name of the point if there is no sweep.
    name: String,
    point: Point,
    scene: Scene,
}

/// The points of the sweep of a scene. Without a sweep, a single point.
fn sweep_points(name: &str, args: &Compare) -> Result<Vec<SweepPoint>> {
    let mut source = presets::source(name)?;
    let mut sweep = source.take_sweep();
    let mut overrides = args.overrides.clone();
    take_several(&mut overrides.set, &mut sweep)?;
    let points = sweep.points()?;
    let assigned =
        overrides.set.iter().filter_map(|assignment| Some(assignment.split_once('=')?.0.trim()));
    let options =
        [("epochs", overrides.epochs.is_some()), ("precision", overrides.precision.is_some())];
    let mut keys =
        assigned.chain(options.into_iter().filter(|(_, given)| *given).map(|(key, _)| key));
    if let Some(key) = keys.find(|key| points[0].0.iter().any(|(varied, _)| varied == key)) {
        bail!("`{key}` is in the sweep and in an option; give its values once");
    }
    // Omits the name of a single scene.
    let short = if args.scenes.len() == 1 { String::new() } else { presets::short_name(name) };
    let at = |point: Point| {
        let mut source = source.clone();
        overrides.apply(&mut source)?;
        point.apply(&mut source)?;
        let name = [short.clone(), point.name()]
            .into_iter()
            .filter(|name| !name.is_empty())
            .collect::<Vec<_>>()
            .join("+");
        Ok(SweepPoint { name, point, scene: source.scene()? })
    };
    points.into_iter().map(at).collect()
}

/// Largest number of scenes in `curves.svg`. A comparison of more scenes has neither this file nor
/// animations with a common scale per scene.
const MAX_PANELS: usize = 8;

/// Largest number of panels in a row, if every scene has a panel.
const COLUMNS: usize = 4;

/// Test losses of all scenes, against epochs and against time. Up to three scenes share the panels
/// and differ in dashes. With more scenes, each scene has panels of its own. All these panels share
/// the range of their y axes if all scenes have one task.
fn picture(title: &str, scenes: &[InScene], one_task: bool) -> Drawing {
    if scenes.len() <= MAX_DASHED {
        return comparison(title, &curves_of_scenes(scenes, |r| r.test_loss));
    }
    let columns = scenes.len().div_ceil(scenes.len().div_ceil(COLUMNS));
    let row = |x: Abscissa, first: usize, scenes: &[InScene]| -> Vec<Case> {
        // Fills the last row with empty cases, which have no panel.
        let case = |i: usize| Case {
            title: scenes
                .get(i)
                .map(|scene| scene.name)
                .filter(|_| x == Abscissa::Epoch)
                .unwrap_or_default()
                .to_owned(),
            y_label: "test loss".into(),
            y_axis: if one_task { 0 } else { first + i },
            x,
            curves: scenes
                .get(i)
                .map(|scene| curves(&scene.runs, |r| r.test_loss))
                .unwrap_or_default(),
        };
        (0..columns).map(case).collect()
    };
    let rows = scenes.chunks(columns).enumerate();
    let rows = rows.flat_map(|(i, scenes)| {
        [Abscissa::Epoch, Abscissa::Seconds].map(|x| row(x, i * columns, scenes))
    });
    study(title, &rows.collect::<Vec<_>>())
}

//! `physgrad optimize`: controls that minimize the loss of a scene from single initial states.

use crate::operations::trajectory::Trajectory;
use crate::platform::csv::csv;
use crate::platform::folder::{Folder, SCENE, TRAJECTORY};
use crate::platform::json::{print_json, rows};
use crate::platform::parallel;
use crate::platform::table::Table;
use crate::platform::terminal::{counted, print_message, print_text};
use crate::runs::{outputs, saved};
use crate::scenes::overrides::{Overrides, hide, is_of_training};
use crate::scenes::presets;
use crate::tasks::Scene;
use anyhow::{Context, Result, bail};
use physgrad::optimize::{Initial, Options, Plan};
use physgrad::text::{digits, rough, short};
use physgrad_plot::{Dash, Series, fitted};
use serde_json::json;
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Optimize the controls of a scene from single initial states, without a policy.
///
/// Writes controls and states, feedback gains along them, animations and a picture.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  physgrad optimize cart_pole_1 --bound=-20:20 --starts 3\n  physgrad optimize --from runs/one"
)]
#[command(mut_args(hide(is_unread)))]
pub struct Optimize {
    /// Task, preset or path of a scene
    #[arg(required_unless_present = "from", conflicts_with = "from")]
    pub scene: Option<String>,
    #[command(flatten)]
    pub overrides: Overrides,
    /// Folder of a trained run: take its scene, and start at the controls of its policy instead of
    /// 0
    #[arg(long, value_name = "RUN", conflicts_with_all = ["field", "epochs", "seed", "precision", "policy", "tag", "set", "without"])]
    pub from: Option<PathBuf>,
    /// Bounds of the controls, as in force=-10:10, or -10:10 for all controls; may be repeated
    #[arg(long, value_name = "[NAME=]LOW:HIGH", allow_hyphen_values = true)]
    pub bound: Vec<String>,
    /// Number of initial states, from the beginning of the test set
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub starts: usize,
    /// Largest number of iterations, up to 1000000
    #[arg(long, value_name = "N", default_value_t = Options::default().max_iterations)]
    pub iterations: usize,
    /// Number of threads [default: RAYON_NUM_THREADS, or all cores]; results do not depend on it
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Folder for the results; replaces earlier results of this command in it [default: a new one
    /// in `runs`]
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print only warnings and errors
    #[arg(short, long)]
    pub quiet: bool,
    /// Print the result as one JSON object; messages stay on standard error (docs/runs.md)
    #[arg(long)]
    pub json: bool,
}

/// Whether the command does not read the setting with this key.
fn is_unread(key: &str) -> bool {
    is_of_training(key) && key != "training.test_samples" || key.starts_with("policy.")
}

/// Largest number of animations, and of initial states in the picture.
const SHOWN: usize = 3;

/// Largest number of state components in the picture.
const COMPONENTS: usize = 8;

/// Runs the command.
pub fn optimize(args: &Optimize) -> Result<()> {
    args.overrides.refuse(is_unread, "optimized controls, which need no policy and no training")?;
    let (name, scene) = named_scene(args)?;
    if let Some(out) = args.out.as_deref().map(Folder::at) {
        out.check_inputs(&args.scene.iter().map(Path::new).collect::<Vec<_>>(), &[SCENE])?;
    }
    scene.check_memory()?;
    let bounds = bounds(&args.bound, &scene.control_names())?;
    if let Some(bound) = unused(&args.bound, scene.control_names().len()) {
        print_message(&format!(
            "warning: --bound {bound} has no effect, because each control has a bound of its own"
        ));
    }
    let options = Options { max_iterations: args.iterations, bounds, ..Options::default() };
    let starts = starts(args, &scene)?;
    let reserved = Folder::reserve(args.out.as_deref())?;

    let begin = Instant::now();
    let plans = plans(args, &scene, &starts, &options);
    let seconds = begin.elapsed().as_secs_f64();
    let failures = plans
        .iter()
        .filter_map(|plan| Some(format!("{:#}", plan.as_ref().err()?)))
        .collect::<Vec<_>>();
    let plans: Vec<(usize, Plan)> =
        plans.into_iter().enumerate().filter_map(|(i, plan)| Some((i, plan.ok()?))).collect();
    if plans.is_empty() {
        return check_failures(&failures, starts.len());
    }

    let folder = Folder::or_fresh(reserved, &format!("optimize-{name}"))?;
    let initial = if args.from.is_some() { &starts[..] } else { &[] };
    let costs = write(&folder, &scene, &plans, initial)?;
    warnings(&plans).iter().for_each(|warning| print_message(warning));
    if !args.quiet {
        ends(&plans, &scene).iter().for_each(|note| print_message(note));
    }
    if args.bound.is_empty() && !args.quiet {
        outside(&plans, &scene).iter().for_each(|note| print_message(note));
    }
    if args.json {
        print_json(
            &json!({ "folder": folder.path(), "seconds": seconds, "plans": rows(&costs)? }),
        )?;
    } else if !args.quiet {
        let results = folder.path().display();
        print_text(&format!(
            "{}\n{}, {seconds:.1} s\nresults in {results}: {TRAJECTORY}, gains.csv, optimized.csv, optimized.svg, \
             animation-*.svg, scene.toml",
            table(&plans),
            counted(scene.horizon, "step")
        ))?;
    }
    check_failures(&failures, starts.len())
}

/// Name for a new folder, and the scene: that of the run in `--from`, or of the argument with its
/// overrides.
fn named_scene(args: &Optimize) -> Result<(String, Scene)> {
    Ok(match &args.from {
        Some(path) => (Folder::existing(path)?.name(), saved::scene(&Folder::existing(path)?)?),
        None => {
            let name = args.scene.as_deref().context("no scene is given")?;
            (presets::short_name(name), saved::changed(name, &args.overrides)?)
        }
    })
}

/// Optimizes in parallel from each of the initial states, and prints each cost unless `--quiet` is
/// given. An error names its initial state.
fn plans(
    args: &Optimize,
    scene: &Scene,
    starts: &[Trajectory],
    options: &Options,
) -> Vec<Result<Plan>> {
    parallel::map(&starts.iter().enumerate().collect::<Vec<_>>(), |&(i, start)| {
        let zeros = args.from.is_none();
        let controls = start.controls.concat();
        let initial = if zeros { Initial::Zeros } else { Initial::Controls(&controls) };
        let plan = scene.optimize(&start.states[0], &start.params[0], initial, options);
        let plan = plan.with_context(|| format!("initial state {i}"))?;
        if !args.quiet {
            print_message(&format!(
                "initial state {i}: cost {} after {} iterations",
                digits(plan.cost, 6),
                plan.iterations()
            ));
        }
        Ok(plan)
    })
}

/// Returns an error that lists the messages of failed optimizations, if any, and counts them among
/// `all`.
fn check_failures(failures: &[String], all: usize) -> Result<()> {
    match failures.len() {
        0 => Ok(()),
        count => bail!("{count} of {all} optimizations failed:\n{}", failures.join("\n")),
    }
}

/// Writes all files. `initial` has the rollouts of the policy, if any. Returns the contents of
/// `optimized.csv`.
fn write(
    folder: &Folder,
    scene: &Scene,
    plans: &[(usize, Plan)],
    initial: &[Trajectory],
) -> Result<Vec<u8>> {
    let optimized: Vec<(usize, Trajectory)> =
        plans.iter().map(|(i, plan)| (*i, trajectory(plan, scene))).collect();
    saved::write_scene(folder, SCENE, scene)?;
    let costs = summary(plans)?;
    folder.write("optimized.csv", &costs)?;
    folder.write(
        TRAJECTORY,
        outputs::trajectories(scene, optimized.iter().map(|(i, rollout)| (*i, rollout)))?,
    )?;
    folder.write("gains.csv", gains(plans, scene)?)?;
    folder.write("optimized.svg", picture(scene, &optimized, initial))?;
    folder.remove_all("animation-", ".svg")?;
    for (i, rollout) in optimized.iter().take(SHOWN) {
        folder.write(&format!("animation-{i}.svg"), scene.animation(rollout).to_svg())?;
    }
    Ok(costs)
}

/// Rollouts of the policy of the run in `--from`, from the first test initial states. Without
/// `--from`, initial states and parameters only.
///
/// # Errors
/// `--starts` is 0 or exceeds the test set. With `--from`, the run cannot be restored, or a rollout
/// diverges.
fn starts(args: &Optimize, scene: &Scene) -> Result<Vec<Trajectory>> {
    let mut run = scene.open(1)?;
    if let Some(path) = &args.from {
        saved::restore(&Folder::existing(path)?, scene, &mut *run)?;
    }
    let samples = run.test_samples();
    if !(1..=samples).contains(&args.starts) {
        bail!(
            "--starts is {}; allowed: 1 to {samples}, the number of test initial states (training.test_samples)",
            args.starts
        );
    }
    let chosen = 0..args.starts;
    // Plans have double precision. An unstable plant amplifies the rounding errors of f32 controls.
    // A plan has the mean of noise.
    let rollouts = if args.from.is_some() { run.mean_rollouts(chosen) } else { run.starts(chosen) };
    match &args.from {
        Some(path) if rollouts.iter().any(|rollout| rollout.controls.len() < scene.horizon) => {
            bail!("the policy of {} diverges; name a scene instead of --from {0}", path.display())
        }
        _ => Ok(rollouts),
    }
}

/// Bounds `[low, high]` in the order of the controls. An argument without a name applies to all
/// controls without an argument of their own. Other controls have infinite bounds. None without
/// arguments.
fn bounds(arguments: &[String], names: &[String]) -> Result<Option<Vec<[f64; 2]>>> {
    let mut bounds = vec![[f64::NEG_INFINITY, f64::INFINITY]; names.len()];
    let (named, general): (Vec<&String>, Vec<&String>) =
        arguments.iter().partition(|argument| argument.contains('='));
    let mut seen = HashSet::new();
    for argument in general.into_iter().chain(named) {
        let (name, range) = argument
            .split_once('=')
            .map_or((None, argument.as_str()), |(name, range)| (Some(name), range));
        let range = range
            .split_once(':')
            .and_then(|(low, high)| Some([low.parse().ok()?, high.parse().ok()?]));
        let range = range.filter(|[low, high]: &[f64; 2]| low < high);
        let chosen = bounds
            .iter_mut()
            .zip(names)
            .filter(|(_, known)| name.is_none_or(|name| name == *known));
        let chosen: Vec<_> = chosen.map(|(bound, _)| bound).collect();
        if !seen.insert(name) {
            bail!(
                "--bound {argument}: {} has two bounds; give one",
                name.unwrap_or("every control")
            );
        }
        match range {
            Some(range) if !chosen.is_empty() => {
                chosen.into_iter().for_each(|bound| *bound = range)
            }
            _ => bail!(
                "--bound {argument}: write [NAME=]LOW:HIGH with LOW below HIGH, as in {}=-10:10; names: {}",
                names.first().map_or("u", String::as_str),
                names.join(", ")
            ),
        }
    }
    Ok((!arguments.is_empty()).then_some(bounds))
}

/// The bound of all controls, if each of them has a bound of its own.
fn unused(arguments: &[String], controls: usize) -> Option<&String> {
    let (named, general): (Vec<&String>, Vec<&String>) =
        arguments.iter().partition(|argument| argument.contains('='));
    general.first().copied().filter(|_| named.len() == controls)
}

/// The trajectory of a plan, up to the end of its episode.
fn trajectory(plan: &Plan, scene: &Scene) -> Trajectory {
    let whole = Trajectory {
        states: (0..=plan.horizon()).map(|t| plan.state(t).to_vec()).collect(),
        controls: (0..plan.horizon()).map(|t| plan.control(t).to_vec()).collect(),
        params: vec![plan.p.clone(); plan.horizon() + 1],
    };
    whole.until_end(scene.ended())
}

/// `optimized.csv`: one row per initial state.
fn summary(plans: &[(usize, Plan)]) -> Result<Vec<u8>> {
    let header =
        ["sample", "initial_cost", "cost", "iterations", "rollouts", "gradient_norm", "stop"];
    let rows = plans.iter().map(|(i, plan)| {
        let numbers = [
            *i as f64,
            plan.costs[0],
            plan.cost,
            plan.iterations() as f64,
            plan.rollouts as f64,
            plan.gradient_norm(),
        ];
        numbers.iter().map(f64::to_string).chain([plan.stop.to_string()]).collect::<Vec<_>>()
    });
    csv(header, rows)
}

/// `gains.csv`: one row per initial state and step, with the gains `K_t` of the feedback
/// `u_t + K_t (x - x_t)`.
fn gains(plans: &[(usize, Plan)], scene: &Scene) -> Result<Vec<u8>> {
    let (states, controls) = (scene.state_names(), scene.control_names());
    let columns = controls
        .iter()
        .flat_map(|control| states.iter().map(move |state| format!("{control} by {state}")));
    let header = ["sample", "step"].map(String::from).into_iter().chain(columns);
    let rows = plans.iter().flat_map(|(i, plan)| {
        let steps = trajectory(plan, scene).controls.len();
        let gains = plan.gains.chunks(states.len() * controls.len()).take(steps).enumerate();
        gains.map(move |(t, gains)| {
            let numbers = gains.iter().map(f64::to_string);
            [i.to_string(), t.to_string()].into_iter().chain(numbers).collect::<Vec<_>>()
        })
    });
    csv(header, rows)
}

fn table(plans: &[(usize, Plan)]) -> Table {
    let header = ["initial state", "initial cost", "cost", "gradient", "iterations", "end"];
    let mut table = Table::new(header).optional(&["gradient"]);
    for (i, plan) in plans {
        let [initial, cost] = [plan.costs[0], plan.cost].map(|cost| digits(cost, 6));
        let (gradient, iterations) = (rough(plan.gradient_norm()), plan.iterations().to_string());
        table.row([i.to_string(), initial, cost, gradient, iterations, plan.stop.to_string()]);
    }
    table
}

/// Warnings about the searches, each with its initial states.
fn warnings(plans: &[(usize, Plan)]) -> Vec<String> {
    let mut warnings: Vec<(&str, Vec<String>)> = Vec::new();
    for (i, plan) in plans {
        for text in plan.warnings() {
            match warnings.iter_mut().find(|(known, _)| *known == text) {
                Some((_, starts)) => starts.push(i.to_string()),
                None => warnings.push((text, vec![i.to_string()])),
            }
        }
    }
    let line = |(text, starts): (&str, Vec<String>)| {
        format!("warning: {text} (initial states: {})", starts.join(", "))
    };
    warnings.into_iter().map(line).collect()
}

/// A note about plans whose episodes end before the horizon, if any.
fn ends(plans: &[(usize, Plan)], scene: &Scene) -> Option<String> {
    let steps = |plan: &Plan| trajectory(plan, scene).controls.len();
    let ended = plans.iter().map(|(i, plan)| (i, steps(plan)));
    let list: Vec<_> = ended
        .filter(|(_, steps)| *steps < scene.horizon)
        .map(|(i, steps)| format!("initial state {i} after {}", counted(steps, "step")))
        .collect();
    (!list.is_empty()).then(|| {
        format!(
            "note: episodes end early: {}. The search has no derivative of the end, so it may stop beside one: compare plans \
             from other controls, or without `loss.end`",
            list.join(", ")
        )
    })
}

/// A note about controls outside of the range for which the task is meant, if any.
fn outside(plans: &[(usize, Plan)], scene: &Scene) -> Option<String> {
    let (names, ranges) = (scene.control_names(), scene.control_bounds()?);
    let farthest = |(i, &[low, high]): (usize, &[f64; 2])| {
        let controls =
            plans.iter().flat_map(|(_, plan)| plan.u.iter().skip(i).step_by(names.len()));
        let beyond = |u: f64| (low - u).max(u - high);
        let u = controls.copied().max_by(|a, b| beyond(*a).total_cmp(&beyond(*b)))?;
        let range = [low, high].map(short);
        (beyond(u) > 0.0).then(|| (i, short(u), range))
    };
    let found: Vec<_> = ranges.iter().enumerate().filter_map(farthest).collect();
    let (i, _, [low, high]) = found.first()?;
    let example = format!("--bound {}={low}:{high}", names[*i]);
    let list = found.iter().map(|(i, u, [low, high])| {
        format!("{} reaches {u}, but the task is meant for {low} to {high}", names[*i])
    });
    Some(format!(
        "note: {}; the search has no bounds without --bound, as in {example}",
        list.collect::<Vec<_>>().join("; ")
    ))
}

/// Controls and states over time. One column for each of the first [`SHOWN`] initial states. One
/// row for each control, and for each of the first [`COMPONENTS`] state components.
fn picture(scene: &Scene, optimized: &[(usize, Trajectory)], initial: &[Trajectory]) -> String {
    let dt = scene.dt();
    let line = |rows: &[Vec<f64>], i: usize| {
        rows.iter().enumerate().map(|(t, row)| (t as f64 * dt, row[i])).collect()
    };
    let columns = optimized.iter().take(SHOWN).map(|&(start, ref rollout)| {
        let row = |(i, name): (usize, String), rows: fn(&Trajectory) -> &[Vec<f64>]| {
            let optimized = Series::new("optimized", "#0072B2", line(rows(rollout), i));
            let policy = initial.get(start).map(|rollout| {
                Series::new("policy", "#D55E00", line(rows(rollout), i)).dash(Dash::Dashed)
            });
            (name, [optimized].into_iter().chain(policy).collect())
        };
        let controls = scene
            .control_names()
            .into_iter()
            .enumerate()
            .map(|named| row(named, |rollout| &rollout.controls));
        let states = scene.state_names().into_iter().enumerate().take(COMPONENTS);
        let states = states.map(|named| row(named, |rollout| &rollout.states));
        (format!("initial state {start}"), controls.chain(states).collect())
    });
    fitted(&format!("{}: optimized controls and states", scene.task.name()), columns.collect())
        .to_svg()
}

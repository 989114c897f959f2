//! `physgrad paper`: reproduces the figures of the paper.

mod fig1;
mod fig2;

use crate::commands::merge::AllMade;
use crate::commands::study::{Made, Running, Trainings};
use crate::platform::folder::Folder;
use crate::platform::signals;
use crate::platform::table::Table;
use crate::platform::terminal::print_text;
use crate::runs::comparison::{check_distinct, check_options};
use crate::runs::shard::Shard;
use crate::scenes::plan::Plan;
use crate::settings::{ClipName, FieldName};
use anyhow::{Context, Result};
use clap::ValueEnum;
use physgrad_plot::Drawing;
use serde_json::{Value, json};
use std::path::Path;
use toml::Value as Setting;

/// Names and texts of the plans of figures 3 to 5. The figure with the longest computing time is
/// last.
const PLANS: [(Figure, &str); 3] = [
    (Figure::Fig4, include_str!("../../../examples/plans/fig4.toml")),
    (Figure::Fig3, include_str!("../../../examples/plans/fig3.toml")),
    (Figure::Fig5, include_str!("../../../examples/plans/fig5.toml")),
];

/// Reproduce a figure of the paper, with several seeds: picture, numbers and table.
///
/// The default folder is runs/paper, or runs/paper-quick with --quick. Figures 3 to 5 are plans,
/// examples/plans/fig3.toml to fig5.toml, and have a folder each. Shard 1 makes figures 1 and 2.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  physgrad paper fig4 --quick\n  physgrad paper all --seeds 8 -o runs/paper\n  physgrad paper fig4 --shard 3/16 -o runs/paper"
)]
pub struct Paper {
    /// Figure to reproduce
    #[arg(value_enum)]
    pub figure: Figure,
    /// Number of seeds, counted from 0 [default: 3]
    #[arg(long, value_name = "K")]
    pub seeds: Option<u64>,
    /// Epochs of every run [default: 1000, or 5 with --quick]
    #[arg(long, value_name = "N")]
    pub epochs: Option<usize>,
    /// Fields to compare [default: R,M,S,C]
    #[arg(long, value_delimiter = ',', value_parser = |name: &str| name.parse().map(FieldName))]
    pub fields: Option<Vec<FieldName>>,
    /// Kinds of clipping, one row of panels each [default: none,value,norm]
    #[arg(long, value_delimiter = ',', value_enum)]
    pub clip: Option<Vec<ClipName>>,
    /// Make a fast trial run: few epochs, small data sets, coarse grids
    #[arg(long)]
    pub quick: bool,
    #[command(flatten)]
    pub running: Running,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Figure {
    /// Toy example: loss landscape, gradient and modified field
    Fig1,
    /// Toy example: Adam along a gradient, a rotating field, and their combination
    Fig2,
    /// Guidance by repulsion with four weights of regularization
    Fig3,
    /// Cart-pole with 1 to 4 poles
    Fig4,
    /// Quantum control towards the eigenstates 3, 4 and 5, and the update size
    Fig5,
    /// All figures
    All,
}

impl Figure {
    /// Name on the command line and in file names.
    fn name(self) -> String {
        self.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default()
    }
}

/// Figure 1 or 2, which train nothing.
pub struct FinishedFigure {
    pub drawing: Drawing,
    /// Figure 1: loss, R and M at the parameters of the maps. Figure 2: parameters and losses along
    /// the paths.
    pub csv: Vec<u8>,
    /// Summary.
    pub table: Table,
}

impl FinishedFigure {
    /// Writes `<name>.svg`, `.png`, `.csv` and `.md`. Prints the table, unless an option forbids it.
    /// Returns name and table as JSON.
    fn write(&self, name: &str, folder: &Folder, running: &Running) -> Result<Value> {
        folder.write(&format!("{name}.svg"), self.drawing.to_svg())?;
        folder.write(&format!("{name}.png"), self.drawing.to_png())?;
        folder.write(&format!("{name}.csv"), &self.csv)?;
        folder.write(&format!("{name}.md"), format!("{}\n", self.table.markdown()))?;
        if !running.quiet && !running.json {
            let path = folder.path().display();
            print_text(&format!(
                "{}\n{name}.svg, {name}.png, {name}.csv and {name}.md are in {path}\n",
                self.table
            ))?;
        }
        Ok(json!({ "name": name, "table": self.table.objects() }))
    }
}

/// Makes a figure that trains nothing, fast or in full.
type Toy = fn(bool) -> Result<FinishedFigure>;

/// Runs the command.
pub fn paper(args: &Paper) -> Result<()> {
    let running = &args.running;
    check_options(args.fields.as_deref(), args.seeds, args.epochs)?;
    check_distinct("--clip", args.clip.iter().flatten().map(|clip| clip.name()))?;
    let default = Path::new(if args.quick { "runs/paper-quick" } else { "runs/paper" });
    let folder = Folder::at(running.out.as_deref().unwrap_or(default));
    let folder = if running.shard.is_some() { folder.share()? } else { folder.lock()? };
    let is_wanted = |figure: Figure| {
        [figure, Figure::All].contains(&args.figure) && signals::received().is_none()
    };
    // Continues with the other figures after an error.
    let mut all = AllMade::default();
    let toys: [(Figure, Toy); 2] = [(Figure::Fig1, fig1::fig1), (Figure::Fig2, fig2::fig2)];
    for (figure, make) in toys {
        if is_wanted(figure) && running.shard.is_none_or(Shard::is_first) {
            let name = figure.name();
            let made = make(args.quick).and_then(|made| made.write(&name, &folder, running));
            all.add_table(&name, made.map(Some));
        }
    }
    for (figure, text) in PLANS {
        if is_wanted(figure) {
            all.add(&figure.name(), train(&figure.name(), text, args, &folder));
        }
    }
    all.print(&folder, running.output())
}

/// Trains the plan of a figure, with the changes of the options, in a folder inside `folder`.
fn train(name: &str, text: &str, args: &Paper, folder: &Folder) -> Result<Made> {
    let plan = Plan::built_in(&format!("plan {name}"), text)?;
    let mut plan = if args.quick { plan.quick() } else { plan };
    let contents = &mut plan.contents;
    contents.seeds = args.seeds.unwrap_or(contents.seeds);
    contents.epochs = args.epochs.or(contents.epochs);
    contents.fields = args.fields.clone().unwrap_or(std::mem::take(&mut contents.fields));
    if let Some(clip) = &args.clip {
        contents.grid.insert("training.clip".into(), Setting::try_from(clip)?);
    }
    let trainings = Trainings::new(plan)?;
    let own = folder.inside(name)?;
    own.create()?;
    trainings
        .train(&own, &args.running, folder.path())
        .with_context(|| format!("the plan of {name}, examples/plans/{name}.toml"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks the figure. The SVG is valid XML below 500 kB without NaN. The CSV has this header
    /// and more than 100 lines without NaN. The table has at least 4 lines.
    fn check(header: &str, figure: &FinishedFigure) {
        let svg = figure.drawing.to_svg();
        roxmltree::Document::parse(&svg).expect("an SVG is XML");
        assert!(
            !svg.contains("NaN") && svg.len() < 500_000,
            "an SVG without NaN and below 500 kB, not {} bytes",
            svg.len()
        );
        let csv = std::str::from_utf8(&figure.csv).expect("CSV is text");
        assert_eq!(csv.lines().next(), Some(header));
        assert!(csv.lines().count() > 100 && !csv.contains("NaN"));
        assert!(figure.table.markdown().lines().count() >= 4);
    }

    #[test]
    fn figures_1_and_2_have_an_svg_below_500_kb_and_a_csv_without_nan() {
        for quick in [true, false] {
            check("theta_1,theta_2,loss,r_1,r_2,m_1,m_2", &fig1::fig1(quick).expect("figure 1"));
            check("method,iteration,theta_1,theta_2,loss", &fig2::fig2(quick).expect("figure 2"));
        }
    }
}

//! Figure 1: loss, R and M over the two parameters of a quadratic policy.

use crate::commands::paper::FinishedFigure;
use crate::platform::table::Table;
use anyhow::Result;
use physgrad::Field;
use physgrad::policy::Quadratic;
use physgrad::tasks::Reach;
use physgrad::text::rough;
use physgrad::train::vector_field::{self, Sample};
use physgrad_plot::quantile::{quantile, sorted};
use physgrad_plot::{Map, Plane, maps};

/// Half the range of each parameter, which is centered at 0.
const HALF_WIDTH: f64 = 4.0;
/// Decimal exponents at the ends of the colour scale. A few values lie below the scale. The values
/// in the corner with a large last state x_4 lie above it.
const DECADES: [i32; 2] = [-2, 6];

pub fn fig1(quick: bool) -> Result<FinishedFigure> {
    let (cells, arrows) = if quick { (40, 14) } else { (80, 18) };
    let (fine, coarse) = (Fields::sample(cells)?, Fields::sample(arrows)?);
    let plane = Plane {
        labels: ["θ₁", "θ₂"],
        half_width: HALF_WIDTH,
        decades: DECADES,
        values: "loss, |R|, |M|",
    };
    // x_4 - y for the target y. This difference vanishes at the minima. The first component of M,
    // (x_4 - y) Σ x_t², has the same sign.
    let signs: Vec<f64> =
        fine.modified.iter().map(|m| (2.0 * m.loss).sqrt().copysign(m.vector[0])).collect();
    let vectors = |title: &str, fine: &[Sample], coarse: &[Sample]| Map {
        title: title.into(),
        values: fine.iter().map(Sample::norm).collect(),
        arrows: coarse.iter().map(|s| s.vector.map(|v| -v)).collect(),
        signs: signs.clone(),
        ..Map::default()
    };
    let losses = fine.regular.iter().map(|s| s.loss).collect();
    let drawing = maps(
        &plane,
        &[
            Map {
                title: "(a) loss (line: x₄ = y)".into(),
                values: losses,
                signs: signs.clone(),
                ..Map::default()
            },
            vectors("(b) regular gradient R", &fine.regular, &coarse.regular),
            vectors("(c) modified gradient M", &fine.modified, &coarse.modified),
        ],
        &[],
    );
    Ok(FinishedFigure { drawing, csv: fine.csv()?, table: fine.table() })
}

/// Samples of R and M at the same parameters.
struct Fields {
    regular: Vec<Sample>,
    modified: Vec<Sample>,
}

impl Fields {
    fn sample(cells: usize) -> Result<Self> {
        let (task, thetas) = (Reach::default(), vector_field::grid(HALF_WIDTH, cells));
        Ok(Self {
            regular: vector_field::sample(&task, &Quadratic, &Field::regular(), &thetas)?,
            modified: vector_field::sample(&task, &Quadratic, &Field::modified(), &thetas)?,
        })
    }

    fn csv(&self) -> Result<Vec<u8>> {
        let mut csv = csv::Writer::from_writer(Vec::new());
        csv.write_record(["theta_1", "theta_2", "loss", "r_1", "r_2", "m_1", "m_2"])?;
        for (r, m) in self.regular.iter().zip(&self.modified) {
            csv.serialize((r.theta, r.loss, r.vector, m.vector))?;
        }
        Ok(csv.into_inner()?)
    }

    fn table(&self) -> Table {
        // |x_4 - y|. R and M are proportional to it.
        let miss = |s: &Sample| (2.0 * s.loss).sqrt();
        let mut table = Table::new(["over θ", "min", "median", "max", "orders of magnitude"]);
        for (name, values) in [
            ("loss", self.regular.iter().map(|s| s.loss).collect::<Vec<f64>>()),
            ("|R|", self.regular.iter().map(Sample::norm).collect()),
            ("|M|", self.modified.iter().map(Sample::norm).collect()),
            ("|R| / |x₄ - y|", self.regular.iter().map(|s| s.norm() / miss(s)).collect()),
            ("|M| / |x₄ - y|", self.modified.iter().map(|s| s.norm() / miss(s)).collect()),
        ] {
            let values = sorted(values.into_iter());
            let [min, median, max] = [0.0, 0.5, 1.0].map(|q| quantile(&values, q));
            let decades = (max / min).log10();
            let [min, median, max] = [min, median, max].map(rough);
            table.row([name.to_owned(), min, median, max, format!("{decades:.1}")]);
        }
        table
    }
}

//! Figure 1: the loss, R and M over the two parameters of a quadratic policy.

use super::Made;
use crate::program::statistics::{quantile, sorted};
use anyhow::Result;
use physgrad::Field;
use physgrad::policy::Quadratic;
use physgrad::report::{Map, Plane, maps};
use physgrad::tasks::Reach;
use physgrad::toy::{self, Sample};
use std::fmt::Write;

/// Both parameters go from minus this to this.
const REACH: f64 = 4.0;
/// Powers of ten that the colours tell apart: at most a fortieth of the values is below, a fifth above, in the corner where x_4
/// itself reaches 10⁷.
const DECADES: [i32; 2] = [-2, 6];

pub fn fig1(quick: bool) -> Result<Made> {
    let (cells, arrows) = if quick { (40, 14) } else { (80, 18) };
    let (fine, coarse) = (Fields::sample(cells)?, Fields::sample(arrows)?);
    let plane = Plane { labels: ["θ₁", "θ₂"], reach: REACH, decades: DECADES, values: "loss, |R|, |M|" };
    // x_4 - y, which is zero at the minima. Its sign is that of M's first component, (x_4 - y) times the sum of x_t².
    let signs: Vec<f64> = fine.modified.iter().map(|m| (2.0 * m.loss).sqrt().copysign(m.vector[0])).collect();
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
            Map { title: "(a) loss (line: x₄ = y)".into(), values: losses, signs: signs.clone(), ..Map::default() },
            vectors("(b) regular gradient R", &fine.regular, &coarse.regular),
            vectors("(c) modified gradient M", &fine.modified, &coarse.modified),
        ],
        &[],
    );
    Ok(Made { drawing, csv: fine.csv()?, table: fine.table() })
}

/// R and M at the same parameters.
struct Fields {
    regular: Vec<Sample>,
    modified: Vec<Sample>,
}

impl Fields {
    fn sample(cells: usize) -> Result<Self> {
        let (task, thetas) = (Reach::default(), toy::grid(REACH, cells));
        Ok(Self {
            regular: toy::sample(&task, &Quadratic, &Field::regular(), &thetas)?,
            modified: toy::sample(&task, &Quadratic, &Field::modified(), &thetas)?,
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

    fn table(&self) -> String {
        // How far x_4 is from the target, which both fields are proportional to.
        let miss = |s: &Sample| (2.0 * s.loss).sqrt();
        let mut table = "| over θ | min | median | max | orders of magnitude |\n|---|---|---|---|---|\n".to_string();
        for (name, values) in [
            ("loss", self.regular.iter().map(|s| s.loss).collect::<Vec<f64>>()),
            ("\\|R\\|", self.regular.iter().map(Sample::norm).collect()),
            ("\\|M\\|", self.modified.iter().map(Sample::norm).collect()),
            ("\\|R\\| / \\|x₄ - y\\|", self.regular.iter().map(|s| s.norm() / miss(s)).collect()),
            ("\\|M\\| / \\|x₄ - y\\|", self.modified.iter().map(|s| s.norm() / miss(s)).collect()),
        ] {
            let values = sorted(values.into_iter());
            let [min, median, max] = [0.0, 0.5, 1.0].map(|q| quantile(&values, q));
            let _ = writeln!(table, "| {name} | {min:.1e} | {median:.1e} | {max:.1e} | {:.1} |", (max / min).log10());
        }
        table
    }
}

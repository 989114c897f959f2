//! [`Sweep`]: the settings that a sweep varies, and its points.
//!
//! ```toml
//! [sweep.grid]                          # every combination
//! "training.learning_rate" = [1e-3, 1e-2]
//! "policy.widths" = [[64], [64, 64]]
//!
//! [[sweep.list]]                        # with every entry of the list
//! "training.batch" = 8
//!
//! [sweep.random]                        # and with every random draw
//! "training.clip_limit" = { log_uniform = [0.1, 10] }
//!
//! [sweep]
//! samples = 10                          # number of random draws; equal draws count once
//! seed = 0
//! ```

use crate::scenes::source::SceneSource;
use crate::settings::reading::is_number;
use anyhow::{Context, Result, anyhow, bail};
use physgrad::Number;
use physgrad::rng::{Purpose, stream};
use rand::RngExt;
use serde::Deserialize;
use std::collections::HashSet;
use toml::{Table, Value};

/// Largest number of points of a sweep.
const MAX_POINTS: usize = 10_000;

/// Settings that a sweep varies.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Sweep {
    /// Keys with lists of values; the points are all combinations.
    grid: Table,
    /// Points with their keys and values.
    list: Vec<Table>,
    /// Keys with distributions.
    random: Table,
    /// Number of random draws. Equal draws are one point.
    samples: usize,
    /// Seed of the random draws.
    seed: u64,
}

/// One point of a sweep: keys and values.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Point(pub Vec<(String, Value)>);

impl Sweep {
    /// Adds a key with its values to the grid.
    pub fn add(&mut self, key: &str, values: Vec<Value>) -> Result<()> {
        match self.grid.insert(key.into(), Value::Array(values)) {
            Some(_) => bail!("`{key}` is in the sweep twice; give its values once"),
            None => Ok(()),
        }
    }

    /// All points: every combination of the grid, with every entry of the list and every random
    /// draw. A single empty point if the sweep varies nothing.
    ///
    /// # Errors
    /// The values of a key are an empty list or not a list. A distribution is invalid. `samples`
    /// has no distributions, or distributions have no `samples`. Two parts have the same key.
    /// Entries of the list have different keys. There are more than 10,000 points.
    pub fn points(&self) -> Result<Vec<Point>> {
        let (list, random) = (self.list_points()?, self.random_points()?);
        let mut points = vec![Point::default()];
        for (key, values) in &self.grid {
            let values = values.as_array().filter(|values| !values.is_empty());
            let values = values.with_context(|| {
                format!("`sweep.grid`: `{key}` needs a list of values, as in [0.1, 0.01]")
            })?;
            let axis = values
                .iter()
                .map(|value| Point(vec![(key.clone(), value.clone())]))
                .collect::<Vec<_>>();
            points = product(points, &axis)?;
        }
        let points = product(product(points, &list)?, &random)?;
        let mut seen = HashSet::new();
        match points[0].0.iter().find(|(key, _)| !seen.insert(key)) {
            Some((key, _)) => bail!("`{key}` is in the sweep twice; give its values once"),
            None => Ok(points),
        }
    }

    fn list_points(&self) -> Result<Vec<Point>> {
        let points: Vec<Point> = self.list.iter().map(|entry| Point(settings("", entry))).collect();
        let keys =
            |point: &Point| point.0.iter().map(|(key, _)| key.clone()).collect::<HashSet<_>>();
        match points.iter().position(|point| keys(point) != keys(&points[0])) {
            Some(i) => bail!(
                "`sweep.list`: entry {} has other keys than the first entry; give every entry the same keys",
                i + 1
            ),
            None => Ok(points),
        }
    }

    fn random_points(&self) -> Result<Vec<Point>> {
        match (self.random.is_empty(), self.samples) {
            (true, 0) => return Ok(Vec::new()),
            (true, _) => {
                bail!(
                    "`sweep.samples` has no effect without `sweep.random`; name the keys and their distributions there"
                )
            }
            (false, 0) => bail!("`sweep.samples` is missing or 0; allowed: 1 or more random draws"),
            (false, _) => {}
        }
        if self.samples > MAX_POINTS {
            bail!("`sweep.samples` is {}; allowed: up to {MAX_POINTS}", self.samples);
        }
        let draw = |sample: usize| {
            let rng = &mut stream(self.seed, Purpose::Sweep, sample as u64);
            let mut value = |(key, distribution): (&String, &Value)| -> Result<(String, Value)> {
                // Entries of a choice are any values, for example names or whole numbers.
                if let Some(choice) = distribution
                    .get("choice")
                    .and_then(Value::as_array)
                    .filter(|list| !list.is_empty())
                {
                    return Ok((key.clone(), choice[rng.random_range(0..choice.len())].clone()));
                }
                let number = Number::deserialize(distribution.clone());
                let number = number.ok().filter(|number| {
                    !number.is_fixed() && !matches!(number, Number::Trained { .. })
                });
                let number = number.with_context(|| {
                    format!(
                        "`sweep.random`: `{key}` is {distribution}; allowed: {{ uniform = [low, high] }}, or another distribution"
                    )
                })?;
                // Rounds to 4 digits, which keeps names of points short. A rounded value may leave
                // the range of the distribution.
                let drawn = number.draw(rng);
                let rounded: f64 = format!("{drawn:.3e}").parse()?;
                let range = number.extremes();
                let is_inside = range.iter().any(|&end| end <= rounded)
                    && range.iter().any(|&end| rounded <= end);
                Ok((key.clone(), Value::Float(if is_inside { rounded } else { drawn })))
            };
            self.random.iter().map(&mut value).collect::<Result<_>>().map(Point)
        };
        let mut seen = HashSet::new();
        let mut points = (0..self.samples).map(draw).collect::<Result<Vec<Point>>>()?;
        points.retain(|point| seen.insert(point.name()));
        Ok(points)
    }
}

impl Point {
    /// Name of the point: the last parts of its keys, with their values, as in
    /// `batch=8+widths=64x64`. Contains whole keys where the last parts coincide. A folder has this
    /// name, so `_` replaces `/` and `\`. Empty for an empty point.
    pub fn name(&self) -> String {
        let value = |value: &Value| match value {
            Value::Float(x) => x.to_string(),
            value => value.to_string().replace(['"', '[', ']', ' '], "").replace(',', "x"),
        };
        let short = |key: &str| key.rsplit('.').next().unwrap_or(key).to_owned();
        let name = |(key, found): &(String, Value)| {
            let is_ambiguous =
                self.0.iter().filter(|(other, _)| short(other) == short(key)).count() > 1;
            format!("{}={}", if is_ambiguous { key.clone() } else { short(key) }, value(found))
        };
        self.0.iter().map(name).collect::<Vec<_>>().join("+").replace(['/', '\\'], "_")
    }

    /// Sets the values of the point in a scene.
    pub fn apply(&self, source: &mut SceneSource) -> Result<()> {
        for (key, value) in &self.0 {
            if ["field", "seed"].contains(&&**key) {
                bail!(
                    "`{key}` is in the sweep, but a comparison trains several; choose them with --fields, --seed and --seeds"
                );
            }
            source.replace(key, value.clone(), &format!("sweep, {key} = {value}"))?;
        }
        Ok(())
    }
}

/// All settings of a table by dotted key. A drawn or trained number is one setting.
fn settings(section: &str, table: &Table) -> Vec<(String, Value)> {
    let inner = |(key, value): (&String, &Value)| match value {
        Value::Table(inner) if !is_number(inner) => settings(&format!("{section}{key}."), inner),
        value => vec![(format!("{section}{key}"), value.clone())],
    };
    table.iter().flat_map(inner).collect()
}

/// Every point of `first` with every point of `second`. Returns `first` if `second` is empty.
fn product(first: Vec<Point>, second: &[Point]) -> Result<Vec<Point>> {
    if second.is_empty() {
        return Ok(first);
    }
    let count = first.len().saturating_mul(second.len());
    if count > MAX_POINTS {
        return Err(anyhow!("the sweep has {count} or more points; allowed: up to {MAX_POINTS}"));
    }
    let joined =
        first.iter().flat_map(|a| second.iter().map(move |b| Point([&a.0[..], &b.0].concat())));
    Ok(joined.collect())
}

/// Values of an assignment that gives a key several values, as in `0.1,0.01` or `none,norm`. None
/// for a single value.
pub fn several(text: &str) -> Option<Vec<Value>> {
    if text.parse::<Value>().is_ok() || !text.contains(',') {
        return None;
    }
    // Lists and tables contain commas.
    if let Ok(Value::Array(values)) = format!("[{text}]").parse() {
        return Some(values);
    }
    let value =
        |part: &str| part.trim().parse().unwrap_or_else(|_| Value::String(part.trim().into()));
    Some(text.split(',').map(value).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sweep(text: &str) -> Sweep {
        toml::from_str(text).expect("a sweep")
    }

    fn names(sweep: &Sweep) -> Vec<String> {
        sweep.points().expect("points").iter().map(Point::name).collect()
    }

    fn error(text: &str) -> String {
        sweep(text).points().expect_err(text).to_string()
    }

    #[test]
    fn points_are_the_product_of_grid_list_and_random_draws() {
        assert_eq!(names(&sweep("")), [""]);
        let grid = "[grid]\n\"training.batch\" = [8, 16]\n\"policy.widths\" = [[8], [8, 4]]\n";
        let expected =
            ["batch=8+widths=8", "batch=8+widths=8x4", "batch=16+widths=8", "batch=16+widths=8x4"];
        assert_eq!(names(&sweep(grid)), expected);
        let list =
            "[[list]]\n\"a.x\" = 1\n\"b.x\" = \"u\"\n[[list]]\n\"b.x\" = \"v\"\n\"a.x\" = 2\n";
        assert_eq!(names(&sweep(list)), ["a.x=1+b.x=u", "b.x=v+a.x=2"]);
        // The name of a point is the name of a folder.
        assert_eq!(names(&sweep("grid.file = [\"../u/v\", \"w\"]")), ["file=.._u_v", "file=w"]);
        assert!(!names(&sweep("grid.file = ['u\\v']")).concat().contains('\\'));
        assert_eq!(names(&sweep(&format!("{grid}{list}"))).len(), 8);
        let mut added = sweep(grid);
        added.add("epochs", vec![1.into(), 2.into(), 3.into()]).expect("a new key");
        assert_eq!(names(&added).len(), 12);
        assert!(added.add("epochs", Vec::new()).is_err());
    }

    #[test]
    fn the_sweep_of_the_documentation_has_80_points() {
        let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/runs.md");
        let page = std::fs::read_to_string(page)
            .expect("a page")
            .replace("sweep.", "")
            .replace("[sweep]", "[ignored]");
        let block = page
            .split("```toml")
            .nth(1)
            .and_then(|rest| rest.split("```").next())
            .expect("a block");
        let (parts, settings) = block.split_once("[ignored]").expect("the section");
        assert_eq!(names(&sweep(&format!("{settings}{parts}"))).len(), 2 * 2 * 2 * 10);
    }

    #[test]
    fn random_draws_depend_on_seed_and_sample_only() {
        let text = |samples: usize, seed: u64| {
            sweep(&format!(
                "samples = {samples}\nseed = {seed}\n[random]\nx = {{ log_uniform = [0.01, 1] }}\ny = {{ choice = [\"a\", 2] }}\n"
            ))
            .points()
            .expect("points")
        };
        let (few, many, other) = (text(3, 0), text(200, 0), text(3, 1));
        assert_eq!(few, many[..3]);
        assert_ne!(few, other);
        let xs: Vec<f64> =
            many.iter().map(|point| point.0[0].1.as_float().expect("a number")).collect();
        assert!(xs.iter().all(|x| (0.01..1.0).contains(x)));
        // The median of the distribution is 0.1. With a probability above 99.99 %, 70 to 129 of 200
        // draws are below it.
        assert!((70..130).contains(&xs.iter().filter(|&&x| x < 0.1).count()));
        assert!(
            ["a", "2"]
                .iter()
                .all(|y| many.iter().any(|point| point.name().ends_with(&format!("y={y}"))))
        );
    }

    #[test]
    fn equal_draws_are_one_point_and_rounded_draws_keep_their_range() {
        assert_eq!(names(&sweep("samples = 40\n[random]\nx = { choice = [1, 2] }\n")).len(), 2);
        let narrow = sweep("samples = 40\n[random]\nx = { uniform = [0.99996, 0.99999] }\n");
        let points = narrow.points().expect("points");
        assert!(
            points.iter().all(|point| point.0[0]
                .1
                .as_float()
                .is_some_and(|x| (0.99996..0.99999).contains(&x))),
            "{points:?}"
        );
    }

    #[test]
    fn a_drawn_number_of_a_list_is_one_setting() {
        let list = sweep(
            "[[list]]\n\"system.cart_mass\" = { normal = [1, 0.1] }\nloss = { mode = \"running\" }\n",
        );
        let keys: Vec<String> =
            list.points().expect("points").remove(0).0.into_iter().map(|(key, _)| key).collect();
        assert_eq!(keys, ["system.cart_mass", "loss.mode"]);
    }

    #[test]
    fn invalid_sweeps_are_refused() {
        for (text, message) in [
            ("grid.x = []", "needs a list of values"),
            ("grid.x = 3", "needs a list of values"),
            ("samples = 2", "no effect without `sweep.random`"),
            ("random.x = { uniform = [0, 1] }", "`sweep.samples` is missing or 0"),
            ("samples = 2\nrandom.x = 3", "`x` is 3; allowed: { uniform"),
            ("samples = 2\nrandom.x = { start = 1 }", "allowed: { uniform"),
            ("samples = 2\nrandom.x = { choice = [] }", "allowed: { uniform"),
            ("samples = 20000\nrandom.x = { uniform = [0, 1] }", "up to 10000"),
            ("samples = 2\ngrid.x = [1]\nrandom.x = { uniform = [0, 1] }", "twice"),
            ("[[list]]\nx = 1\n[[list]]\ny = 1", "entry 2 has other keys"),
        ] {
            let found = error(text);
            assert!(found.contains(message), "{text}: {found}");
        }
    }

    #[test]
    fn several_values_are_split_at_commas_outside_of_brackets() {
        let strings = |text: &str| {
            several(text).map(|values| values.iter().map(Value::to_string).collect::<Vec<_>>())
        };
        assert_eq!(strings("0.1,0.01"), Some(vec!["0.1".to_owned(), "0.01".to_owned()]));
        assert_eq!(strings("none, norm"), Some(vec!["\"none\"".to_owned(), "\"norm\"".to_owned()]));
        assert_eq!(strings("[8, 8],[4]").map(|values| values.len()), Some(2));
        assert_eq!(
            [strings("[8, 8]"), strings("0.1"), strings("norm"), strings("\"a,b\"")],
            [const { None }; 4]
        );
    }
}

//! [`Point`]: values of the settings that a plan varies, and all combinations of such values.

use std::collections::HashSet;
use toml::{Table, Value};

/// Keys and values of one combination.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Point(Vec<(String, Value)>);

/// Number of [`combinations`].
pub fn count(grid: &Table, list: &[Table]) -> usize {
    let values = grid.values().map(|values| values.as_array().map_or(1, Vec::len));
    values.fold(list.len().max(1), usize::saturating_mul)
}

/// Every combination of the values in the lists of the grid, each with every entry of the list. The
/// last entry varies fastest. A single empty point if nothing varies.
pub fn combinations(grid: &Table, list: &[Table]) -> Vec<Point> {
    let axis = |(key, values): (&String, &Value)| -> Vec<Point> {
        let values = values.as_array().map_or(&[][..], Vec::as_slice);
        values.iter().map(|value| Point(vec![(key.clone(), value.clone())])).collect()
    };
    let entry = |entry: &Table| {
        Point(entry.iter().map(|(key, value)| (key.clone(), value.clone())).collect())
    };
    let list: Vec<Point> = list.iter().map(entry).collect();
    let axes = grid.iter().map(axis).chain((!list.is_empty()).then_some(list));
    axes.fold(vec![Point::default()], |points, axis| {
        let with = |a: &Point| axis.iter().map(|b| Point([&a.0[..], &b.0].concat())).collect();
        points.iter().flat_map::<Vec<Point>, _>(with).collect()
    })
}

impl Point {
    /// Keys and values.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Value)> {
        self.0.iter().map(|(key, value)| (&**key, value))
    }

    /// Value of a key. None for a point without the key.
    pub fn get(&self, key: &str) -> Option<&Value> {
        self.iter().find(|(own, _)| *own == key).map(|(_, value)| value)
    }

    /// Name of the point: the last parts of its keys, with their values, as in
    /// `batch=8+widths=64x64`. Contains whole keys where the last parts coincide. A folder has this
    /// name, so `_` replaces `/` and `\`. Empty for an empty point.
    pub fn name(&self) -> String {
        let value = |value: &Value| match value {
            Value::Float(x) => x.to_string(),
            value => value.to_string().replace(['"', '\'', '[', ']', ' '], "").replace(',', "x"),
        };
        let mut seen = HashSet::new();
        let keys = self.0.iter().map(|(key, _)| last_part(key));
        let ambiguous: HashSet<&str> = keys.filter(|key| !seen.insert(*key)).collect();
        let name = |(key, found): &(String, Value)| {
            let short = last_part(key);
            let shown = if ambiguous.contains(short) { key } else { short };
            format!("{shown}={}", value(found))
        };
        self.0.iter().map(name).collect::<Vec<_>>().join("+").replace(['/', '\\'], "_")
    }
}

/// Last part of a dotted key.
pub fn last_part(key: &str) -> &str {
    key.rsplit('.').next().unwrap_or(key)
}

/// Text of a value in a table.
pub fn text(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), String::from)
}

/// Value as a number. None for any other type.
pub fn number(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|x| x as f64))
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
    // Arguments of functions in expressions have commas too.
    let mut depth = 0;
    let separates = |c: char| {
        depth += i32::from("([{".contains(c)) - i32::from(")]}".contains(c));
        c == ',' && depth == 0
    };
    let values: Vec<_> = text.split(separates).map(value).collect();
    (values.len() > 1).then_some(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(grid: &str, list: &[&str]) -> Vec<String> {
        let table = |text: &str| text.parse::<Table>().expect("TOML");
        let (grid, list) = (table(grid), list.iter().map(|entry| table(entry)).collect::<Vec<_>>());
        let points = combinations(&grid, &list);
        assert_eq!(points.len(), count(&grid, &list));
        points.iter().map(Point::name).collect()
    }

    #[test]
    fn points_are_all_combinations_of_the_grid_and_the_entries_of_the_list() {
        let grid = "\"training.batch\" = [8, 16]\n\"policy.widths\" = [[8], [8, 4]]\n";
        let of_grid =
            ["batch=8+widths=8", "batch=8+widths=8x4", "batch=16+widths=8", "batch=16+widths=8x4"];
        let list = ["\"a.x\" = 1\n\"b.x\" = \"u\"", "\"a.x\" = 2\n\"b.x\" = \"v\""];
        let of_list = ["a.x=1+b.x=u", "a.x=2+b.x=v"];
        assert_eq!(names("", &[]), [""]);
        assert_eq!(names(grid, &[]), of_grid);
        assert_eq!(names("", &list), of_list);
        assert_eq!(names(grid, &list)[1], "batch=8+widths=8+a.x=2+b.x=v");
        assert_eq!(names(grid, &list).len(), 8);
        // The name of a point is the name of a folder.
        assert_eq!(names("file = [\"../u/v\", 'u\\v']", &[]), ["file=.._u_v", "file=u_v"]);
    }

    #[test]
    fn several_values_are_split_at_commas_outside_of_brackets() {
        let strings = |text: &str| {
            several(text).map(|values| values.iter().map(Value::to_string).collect::<Vec<_>>())
        };
        assert_eq!(strings("0.1,0.01"), Some(vec!["0.1".to_owned(), "0.01".to_owned()]));
        assert_eq!(strings("none, norm"), Some(vec!["\"none\"".to_owned(), "\"norm\"".to_owned()]));
        assert_eq!(strings("[8, 8],[4]").map(|values| values.len()), Some(2));
        assert_eq!(strings("where(x < 1, 1, 0)"), None);
        assert_eq!(strings("max(0, x), abs(x)").map(|values| values.len()), Some(2));
        assert_eq!(
            [strings("[8, 8]"), strings("0.1"), strings("norm"), strings("\"a,b\"")],
            [const { None }; 4]
        );
    }
}

//! Results as JSON (option `--json`): one object on standard output.

use super::csv::unguarded;
use super::terminal::{is_plain, is_shown, print_result};
use anyhow::Result;
use serde_json::{Map, Value};

/// Columns of text. A name such as `1` stays text.
const TEXT: [&str; 13] = [
    "run",
    "scene",
    "case",
    "field",
    "name",
    "task",
    "tags",
    "method",
    "precision",
    "stop",
    "clip",
    "setting",
    "checked",
];

/// Prints an object. JSON escapes stand for the control characters in it, including those that JSON
/// permits in text.
///
/// # Errors
/// As [`print_result`].
pub fn print_json(object: &Value) -> Result<()> {
    print_result(&escaped(&serde_json::to_string_pretty(object)?))
}

/// The JSON text with its remaining control characters and marks of direction as JSON escapes. They
/// occur in strings only, where the escape has the same meaning.
fn escaped(json: &str) -> String {
    if is_plain(json) {
        return json.to_owned();
    }
    json.chars()
        .map(|c| if is_shown(c) { c.to_string() } else { format!("\\u{:04x}", c as u32) })
        .collect()
}

/// Rows of a CSV file from [`csv`](super::csv::csv), as objects whose keys are the columns.
///
/// # Errors
/// The text is not CSV.
pub fn rows(csv: &[u8]) -> Result<Value> {
    let mut csv = csv::Reader::from_reader(csv);
    let header = csv.headers()?.clone();
    let object = |row: csv::StringRecord| object(header.iter().zip(row.iter().map(unguarded)));
    csv.records().map(|row| Ok(object(row?))).collect()
}

/// Object of cells by their columns. Empty cells become null. In columns of text, all other cells
/// stay text. In the remaining columns, numbers, `true` and `false` become JSON values, non-finite
/// numbers become null, and all other cells stay text.
pub fn object<'a>(cells: impl IntoIterator<Item = (&'a str, &'a str)>) -> Value {
    let value = |column: &str, cell: &str| match cell {
        "" => Value::Null,
        _ if TEXT.contains(&column) => cell.into(),
        "true" | "false" => Value::Bool(cell == "true"),
        _ => match (cell.parse::<i64>(), cell.parse::<f64>()) {
            (Ok(whole), _) => whole.into(),
            // JSON has no NaN and no infinity: they become null.
            (_, Ok(number)) => number.into(),
            _ => cell.into(),
        },
    };
    let entries = cells.into_iter().map(|(column, cell)| (column.to_owned(), value(column, cell)));
    Value::Object(entries.collect::<Map<_, _>>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn cells_become_numbers_text_and_null() {
        let found = rows(b"run,seed,loss,failed\n7,3,0.5,true\ntrue,5,1e3,false\nb,4,NaN,false\n")
            .expect("CSV");
        let expected = json!([
            { "run": "7", "seed": 3, "loss": 0.5, "failed": true },
            { "run": "true", "seed": 5, "loss": 1000.0, "failed": false },
            { "run": "b", "seed": 4, "loss": null, "failed": false },
        ]);
        assert_eq!(found, expected);
    }
}

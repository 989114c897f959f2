//! [`csv`]: tables as comma-separated values. Callers write the bytes to a file.

use ::csv::WriterBuilder;
use anyhow::Result;

/// A header and rows of cells, quoted as in RFC 4180. Each record ends in `\n`. A cell that a
/// spreadsheet would evaluate as a formula begins with an apostrophe, which [`unguarded`] removes.
pub fn csv(
    header: impl IntoIterator<Item = impl AsRef<[u8]>>,
    rows: impl IntoIterator<Item = impl IntoIterator<Item = String>>,
) -> Result<Vec<u8>> {
    // Quotes a cell that begins with `#`, because a reader may take the line for a comment.
    let mut csv = WriterBuilder::new().comment(Some(b'#')).from_writer(Vec::new());
    csv.write_record(header)?;
    for row in rows {
        csv.write_record(row.into_iter().map(guarded))?;
    }
    Ok(csv.into_inner()?)
}

/// Returns whether a spreadsheet evaluates this cell as a formula.
fn is_formula(cell: &str) -> bool {
    cell.len() > 1
        && cell.starts_with(['=', '+', '-', '@', '\t', '\r'])
        && cell.parse::<f64>().is_err()
}

/// A cell with an apostrophe before a formula. A formula after apostrophes gets one more, so that
/// every cell can be recovered.
fn guarded(cell: String) -> String {
    if is_formula(cell.trim_start_matches('\'')) { format!("'{cell}") } else { cell }
}

/// The cell from which [`csv`] wrote this one.
pub fn unguarded(cell: &str) -> &str {
    cell.strip_prefix('\'').filter(|_| is_formula(cell.trim_start_matches('\''))).unwrap_or(cell)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formulas_begin_with_an_apostrophe_and_every_cell_is_recovered() {
        let cells = [
            "=1+1", "@SUM(A1)", "+x", "-x", "\t=1", "'=1", "''=1", "-", "-1.5e3", "+2", "-inf",
            "NaN", "'a", "a=b", "",
        ];
        let guards = ["'=1+1", "'@SUM(A1)", "'+x", "'-x", "'\t=1", "''=1", concat!("''", "'=1")];
        for (i, &cell) in cells.iter().enumerate() {
            let written = guarded(cell.to_owned());
            assert_eq!(written, *guards.get(i).unwrap_or(&cell));
            assert_eq!(unguarded(&written), cell);
        }
        let text =
            csv(["tag", "n"], [["=HYPERLINK(\"x\",1)".to_owned(), "-1".to_owned()]]).expect("CSV");
        assert_eq!(
            String::from_utf8(text).expect("text"),
            "tag,n\n\"'=HYPERLINK(\"\"x\"\",1)\",-1\n"
        );
    }
}

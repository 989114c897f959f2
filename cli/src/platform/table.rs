//! [`Table`]: a table of results, fitted to the width of the terminal.

use super::{json, terminal};
use comfy_table::presets::{ASCII_MARKDOWN, UTF8_FULL_CONDENSED};
use comfy_table::{CellAlignment, ColumnConstraint, ContentArrangement, TableStyle, Width};
use serde_json::Value;
use std::fmt;

/// Largest width of a column if the width of the terminal is unknown, in characters.
const COLUMN: usize = 60;

/// Smallest width of a column at which a line of text has several words, in characters.
const WORDS: usize = 24;

/// Length of the longest word that is never broken, in characters. Longer words, for example paths,
/// may be broken.
const WORD: usize = 30;

/// Length of the longest cell in a terminal, in characters. The time to fit a table is quadratic in
/// the length of its longest cell.
const CELL: usize = 1000;

/// Header and rows, as [`plain`](terminal::plain) text.
///
/// Columns of numbers are aligned to the right. In a terminal of known width, a table that is too
/// wide breaks cells of text between words. Before it makes columns of text narrower than about 24
/// characters, it omits optional columns, the last one first. A note below the table names them.
/// Without a known width, a table breaks only lines of more than 60 characters.
#[derive(Clone, Debug)]
pub struct Table {
    header: Vec<String>,
    rows: Vec<Vec<String>>,
    /// Optional columns, the first one most important.
    optional: Vec<usize>,
}

impl Table {
    pub fn new(header: impl IntoIterator<Item = impl Into<String>>) -> Self {
        Self { header: plain(header), rows: Vec::new(), optional: Vec::new() }
    }

    /// Sets the columns that a narrow terminal omits, by their titles, the first one most
    /// important. Ignores titles without a column.
    pub fn optional(mut self, titles: &[&str]) -> Self {
        let column = |title: &&str| self.header.iter().position(|header| header == title);
        self.optional = titles.iter().filter_map(column).collect();
        self
    }

    pub fn row(&mut self, cells: impl IntoIterator<Item = impl Into<String>>) {
        self.rows.push(plain(cells));
    }

    /// The whole table in Markdown, on one line per row.
    pub fn markdown(&self) -> String {
        let escaped = |row: &Vec<String>| row.iter().map(|cell| cell.replace('|', "\\|")).collect();
        let (header, rows) = (escaped(&self.header), self.rows.iter().map(escaped).collect());
        Self { header, rows, optional: Vec::new() }.layout(&[], ASCII_MARKDOWN).to_string()
    }

    /// One object per row. Keys are the titles in lower case, with `_` in place of each space and
    /// comma.
    pub fn objects(&self) -> Value {
        let key = |title: &String| title.to_lowercase().replace([' ', ','], "_");
        let keys: Vec<String> = self.header.iter().map(key).collect();
        let row = |row: &Vec<String>| {
            json::object(keys.iter().map(String::as_str).zip(row.iter().map(String::as_str)))
        };
        self.rows.iter().map(row).collect()
    }

    /// Text of the table, fitted to a width in characters. The note about omitted columns may be
    /// longer.
    fn fitted(&self, width: Option<usize>) -> String {
        if self.header.iter().chain(self.rows.iter().flatten()).any(|cell| is_long(cell)) {
            return self.shortened().fitted(width);
        }
        let mut hidden: Vec<usize> = Vec::new();
        let mut rest = self.optional.clone();
        while width.is_some_and(|width| self.width(&hidden, |i| self.least(i)) > width) {
            let Some(column) = rest.pop() else { break };
            hidden.push(column);
        }
        let mut table = self.layout(&hidden, UTF8_FULL_CONDENSED);
        let natural = self.width(&hidden, |i| {
            self.widest(i).min(if width.is_some() { usize::MAX } else { COLUMN })
        });
        table.set_content_arrangement(ContentArrangement::Dynamic);
        table.set_width(
            u16::try_from(width.map_or(natural, |width| width.min(natural))).unwrap_or(u16::MAX),
        );
        for i in 0..self.header.len() {
            if let Some(column) = table.column_mut(i).filter(|_| !hidden.contains(&i)) {
                // Widths of columns include one space on either side.
                let lower = Width::Fixed(u16::try_from(self.narrowest(i) + 2).unwrap_or(u16::MAX));
                column.set_constraint(ColumnConstraint::LowerBoundary(lower));
            }
        }
        let omitted: Vec<&str> = self
            .optional
            .iter()
            .filter(|i| hidden.contains(i))
            .map(|&i| &*self.header[i])
            .collect();
        let note = if omitted.is_empty() {
            String::new()
        } else {
            format!("\nomitted at this width: {}", omitted.join(", "))
        };
        format!("{table}{note}")
    }

    /// The table with the first characters of each cell that is longer than [`CELL`].
    fn shortened(&self) -> Self {
        let short =
            |cell: &String| match cell.char_indices().nth(CELL - 1).filter(|_| is_long(cell)) {
                Some((end, _)) => format!("{}…", &cell[..end]),
                None => cell.clone(),
            };
        let row = |cells: &Vec<String>| cells.iter().map(short).collect();
        Self {
            header: row(&self.header),
            rows: self.rows.iter().map(row).collect(),
            optional: self.optional.clone(),
        }
    }

    fn layout(&self, hidden: &[usize], style: TableStyle) -> comfy_table::Table {
        let mut table = comfy_table::Table::new();
        table.load_style(style).set_header(&self.header).add_rows(&self.rows);
        for i in 0..self.header.len() {
            let Some(column) = table.column_mut(i) else { continue };
            if self.is_numeric(i) {
                column.set_cell_alignment(CellAlignment::Right);
            }
            if hidden.contains(&i) {
                column.set_constraint(ColumnConstraint::Hidden);
            }
        }
        table
    }

    /// Width of the table with the given widths of its visible columns.
    fn width(&self, hidden: &[usize], width: impl Fn(usize) -> usize) -> usize {
        let visible = (0..self.header.len()).filter(|i| !hidden.contains(i));
        visible.map(|i| width(i) + 3).sum::<usize>() + 1
    }

    fn cells(&self, column: usize) -> impl Iterator<Item = &str> {
        self.rows.iter().filter_map(move |row| row.get(column)).map(String::as_str)
    }

    /// Width of a column whose cells are not broken.
    fn widest(&self, column: usize) -> usize {
        let lines = self.cells(column).chain([&*self.header[column]]).flat_map(str::lines);
        lines.map(terminal::width_of).max().unwrap_or(0)
    }

    /// Smallest width at which a column is readable: unbroken numbers, or lines of several words.
    fn least(&self, column: usize) -> usize {
        let narrowest = self.narrowest(column);
        if self.is_numeric(column) {
            narrowest
        } else {
            self.widest(column).min(narrowest.max(WORDS))
        }
    }

    /// Smallest width of a column. In a column of numbers, the longest cell or word of the header
    /// fits. In a column of text, the longest word of the header or of a cell fits, up to [`WORD`].
    fn narrowest(&self, column: usize) -> usize {
        let words = self.header[column].split(' ').map(terminal::width_of).max().unwrap_or(0);
        let numeric = self.is_numeric(column);
        let cells = self
            .cells(column)
            .flat_map(|cell| if numeric { vec![cell] } else { cell.split([' ', '\n']).collect() });
        let longest = cells.map(terminal::width_of).max().unwrap_or(0).max(words);
        if numeric { longest } else { longest.min(WORD) }
    }

    /// Returns whether at least one cell starts with a number, and all others do or are
    /// placeholders of a number. A cell that contains a comma or a colon, followed by a space, is
    /// text.
    fn is_numeric(&self, column: usize) -> bool {
        let starts = |cell: &str| {
            cell.trim_start_matches(['-', '+']).starts_with(|first: char| first.is_ascii_digit())
        };
        let is_number = |cell: &str| starts(cell) && !cell.contains(", ") && !cell.contains(": ");
        let is_placeholder = |cell: &str| {
            ["", "-", "NaN", "inf", "-inf", "diverged", "diverges", "non-finite"].contains(&cell)
        };
        self.cells(column).any(is_number)
            && self.cells(column).all(|cell| is_number(cell) || is_placeholder(cell))
    }
}

fn is_long(cell: &str) -> bool {
    cell.chars().nth(CELL).is_some()
}

fn plain(cells: impl IntoIterator<Item = impl Into<String>>) -> Vec<String> {
    cells.into_iter().map(|cell| terminal::plain(&cell.into()).into_owned()).collect()
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.fitted(terminal::width()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let mut table = Table::new(["field", "lowest loss", "seconds", "remark"])
            .optional(&["lowest loss", "seconds"]);
        table.row(["combined", "0.5322", "12.1", "three words here"]);
        table.row(["regular", "NaN", "9.9", "|R|"]);
        table
    }

    fn widths(text: &str) -> Vec<usize> {
        text.lines().map(terminal::width_of).collect()
    }

    #[test]
    fn a_table_without_a_limit_has_every_column_and_aligns_numbers_to_the_right() {
        let text = table().fitted(None);
        assert!(text.contains("│ combined ┆      0.5322 ┆    12.1 ┆ three words here │"), "{text}");
        assert!(text.contains("│ regular  ┆         NaN ┆     9.9 ┆ |R|              │"), "{text}");
    }

    #[test]
    fn texts_that_start_with_numbers_are_aligned_to_the_left() {
        let mut table = Table::new(["checked", "ratio"]);
        table.row(["1 pole, terminal loss: system", "1"]);
        table.row(["2 poles: task", "0.2560 (0.06851 to 1.133)"]);
        let text = table.fitted(None);
        assert!(text.contains("│ 2 poles: task                 ┆"), "{text}");
        assert!(text.contains("┆                         1 │"), "{text}");
    }

    #[test]
    fn a_narrow_table_omits_the_least_important_column_first() {
        let whole = table().fitted(Some(50));
        assert!(whole.contains("12.1") && whole.contains("0.5322"), "{whole}");
        let one = table().fitted(Some(49));
        assert!(
            !one.contains("12.1")
                && one.contains("0.5322")
                && one.ends_with("\nomitted at this width: seconds"),
            "{one}"
        );
        let two = table().fitted(Some(32));
        assert!(
            !two.contains("0.5322") && two.ends_with("omitted at this width: lowest loss, seconds"),
            "{two}"
        );
    }

    #[test]
    fn cells_break_between_words_and_numbers_do_not_break() {
        let mut table = Table::new(["name", "mean"]);
        table.row(["several words of text", "0.1234 ± 0.0012"]);
        for width in 29..45 {
            let text = table.fitted(Some(width));
            assert!(widths(&text).iter().all(|&of_line| of_line <= width), "{width}\n{text}");
            for word in ["several", "words", "text", "0.1234 ± 0.0012"] {
                assert!(text.contains(word), "{width}: {word} is broken\n{text}");
            }
        }
    }

    #[test]
    fn a_cell_of_a_megabyte_is_shortened_in_a_terminal_only() {
        for long in ["x".repeat(1_000_000), "é ".repeat(500_000)] {
            let mut table = Table::new(["name", "tags"]);
            table.row(["a", &long]);
            let text = table.fitted(Some(80));
            assert!(text.contains('…') && text.len() < 10_000, "{}", text.len());
        }
        let mut table = Table::new(["name", "tags"]);
        let long = "x".repeat(2 * CELL);
        table.row(["a", &long]);
        assert!(table.markdown().contains(&long));
    }

    #[test]
    fn markdown_has_every_column_and_one_line_per_row() {
        let text = table().markdown();
        assert_eq!(text.lines().count(), 4, "{text}");
        assert!(
            text.contains("three words here") && text.contains("\\|R\\|") && text.contains("12.1"),
            "{text}"
        );
    }
}

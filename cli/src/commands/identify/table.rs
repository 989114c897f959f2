//! CSV files with measured trajectories: encoding, columns and cells.

use crate::platform::terminal::listed;
use crate::tasks::Scene;
use anyhow::{Context, Result, anyhow, bail};
use physgrad::Number;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Largest size of a file, bytes.
const MOST_BYTES: u64 = 500_000_000;

/// Largest number of characters of a cell in a message.
const QUOTED: usize = 40;

/// Meaning of a column.
#[derive(Clone, Copy, PartialEq)]
enum Column {
    Segment,
    Time,
    State(usize),
    Control(usize),
    /// A parameter, constant within a segment.
    Param(usize),
    /// A column of `trajectory.csv` without measurements: the step, or an applied control.
    Ignored,
}

/// A CSV file whose columns are known.
pub struct Table {
    /// Path for messages.
    pub name: String,
    bytes: Vec<u8>,
    columns: Vec<Column>,
    /// Numbers of states, controls and parameters.
    sizes: [usize; 3],
}

/// Cells of a row. Missing numbers are NaN, except for the time.
pub struct Row {
    pub line: u64,
    /// Name of the segment.
    pub key: String,
    /// Time, s.
    pub time: f64,
    pub x: Vec<f64>,
    pub u: Vec<f64>,
    pub p: Vec<f64>,
}

impl Table {
    /// Reads a file and its header.
    ///
    /// # Errors
    /// The file cannot be read, has more than 500 MB, or is in UTF-16. The header has no column `t`
    /// or `time`, or an unknown, repeated or unnamed one, or an applied control without its control.
    /// A line after the header is a comment.
    /// Columns are separated by semicolons or tabs.
    pub fn read(path: &Path, scene: &Scene, ignored: &[String]) -> Result<Self> {
        let name = path.display().to_string();
        let bytes = read(path).with_context(|| format!("cannot read {name}"))?;
        if bytes.len() as u64 > MOST_BYTES {
            bail!("{name} has more than {} MB; split the file", MOST_BYTES / 1_000_000);
        }
        let is_utf_16 = bytes.starts_with(&[0xff, 0xfe])
            || bytes.starts_with(&[0xfe, 0xff])
            || bytes.iter().take(4).any(|&b| b == 0);
        if is_utf_16 {
            bail!("{name} is in UTF-16 or is no text; save it as text in UTF-8");
        }
        let names = [scene.state_names(), scene.control_names(), scene.param_names()];
        let mut table =
            Self { name, bytes, columns: Vec::new(), sizes: names.each_ref().map(Vec::len) };
        let header = table
            .reader()
            .headers()
            .with_context(|| format!("cannot read {}", table.name))?
            .clone();
        // Noise has no constant value; the fit uses its mean.
        let varied = scene.varied().into_iter();
        let noise = varied.filter(|(_, number)| matches!(number, Number::Noise(_)));
        let noise = noise.map(|(name, _)| name).collect();
        let ignored =
            [scene.applied_names(), vec!["step".into()], noise, ignored.to_vec()].concat();
        let columns = header.iter().map(|header| column(header, &names, &ignored));
        table.columns = columns
            .collect::<Option<_>>()
            .ok_or_else(|| table.unknown(&header, &names, &ignored))?;
        for (i, column) in
            table.columns.iter().enumerate().filter(|(_, column)| **column != Column::Ignored)
        {
            if let Some(first) = table.columns[..i].iter().position(|earlier| earlier == column) {
                let [first, second] = [first, i].map(|i| &header[i]);
                bail!(
                    "{}: the columns `{first}` and `{second}` have one meaning; remove one of them",
                    table.name
                );
            }
        }
        if !table.columns.contains(&Column::Time) {
            bail!("{}: there is no column `t` with the time in s", table.name);
        }
        table.refuse_comments()?;
        for (i, (control, applied)) in names[1].iter().zip(scene.applied_names()).enumerate() {
            if !table.has_control(i) && header.iter().any(|header| header == applied) {
                bail!(
                    "{}: the column `{control}` is missing; `{applied}` is the output of the actuator, which the simulation \
                     computes from `{control}`. Add this column, with zeros if the control was 0; or rename `{applied}` to \
                     `{control}`, and remove [actuator] from the scene",
                    table.name
                );
            }
        }
        Ok(table)
    }

    /// Refuses a row that begins with `#`, which may be a comment or the name of a segment.
    fn refuse_comments(&self) -> Result<()> {
        let is_comment = |line: &[u8]| line.trim_ascii_start().starts_with(b"#");
        let is_blank = |line: &[u8]| line.trim_ascii().is_empty();
        let mut rows = (1..)
            .zip(self.bytes.split(|&byte| byte == b'\n'))
            .skip_while(|(_, line)| is_comment(line) || is_blank(line));
        match rows.find(|(_, line)| is_comment(line)) {
            Some((number, _)) => bail!(
                "{}:{number}: the line begins with `#`; comments are allowed before the header only; remove the line, or \
                 write a name in quotation marks",
                self.name
            ),
            None => Ok(()),
        }
    }

    /// Returns whether there is a column of this control.
    pub fn has_control(&self, i: usize) -> bool {
        self.columns.contains(&Column::Control(i))
    }

    /// Returns whether there is a column of this parameter.
    pub fn has_param(&self, i: usize) -> bool {
        self.columns.contains(&Column::Param(i))
    }

    fn reader(&self) -> csv::Reader<&[u8]> {
        csv::ReaderBuilder::new()
            .comment(Some(b'#'))
            .trim(csv::Trim::All)
            .flexible(true)
            .from_reader(&self.bytes)
    }

    /// The error of a header with a column that has no meaning.
    fn unknown(
        &self,
        header: &csv::StringRecord,
        names: &[Vec<String>; 3],
        ignored: &[String],
    ) -> anyhow::Error {
        let name = &self.name;
        for (separator, what) in [(';', "semicolons"), ('\t', "tabs")] {
            if header.iter().any(|cell| cell.contains(separator)) {
                return anyhow!(
                    "{name}: the columns are separated by {what}; allowed: commas, and points in numbers"
                );
            }
        }
        let unknown =
            header.iter().position(|cell| column(cell, names, ignored).is_none()).unwrap_or(0);
        if header[unknown].is_empty() {
            return anyhow!(
                "{name}: column {} has no name; remove the column, or the comma at the end of each line",
                unknown + 1
            );
        }
        let known = names.iter().map(|names| {
            names.iter().filter(|name| !ignored.contains(name)).cloned().collect::<Vec<_>>()
        });
        let known: Vec<String> =
            known.filter(|names| !names.is_empty()).map(|names| listed(&names)).collect();
        anyhow!(
            "{name}: unknown column `{}`; allowed: segment, t, {}",
            quoted(&header[unknown]),
            known.join(", ")
        )
    }

    /// Smallest decimal unit of the times in s, for instance 0.001 for three decimals. Writers may
    /// omit zeros at the end, so the unit is that of all rows.
    pub fn unit(&self) -> f64 {
        let time = self.columns.iter().position(|column| *column == Column::Time).unwrap_or(0);
        let (mut reader, mut record, mut least) =
            (self.reader(), csv::ByteRecord::new(), f64::INFINITY);
        while reader.read_byte_record(&mut record).is_ok_and(|is_row| is_row) {
            least = least.min(
                record
                    .get(time)
                    .and_then(|cell| std::str::from_utf8(cell).ok())
                    .map_or(least, unit),
            );
        }
        least
    }

    /// Rows of the file.
    ///
    /// # Errors
    /// The file has no rows. A row has more or fewer cells than the header. A cell is not a finite
    /// number. A time is missing.
    pub fn rows(&self) -> impl Iterator<Item = Result<Row>> {
        self.reader()
            .into_records()
            .map(|record| self.row(&record.with_context(|| format!("cannot read {}", self.name))?))
    }

    fn row(&self, record: &csv::StringRecord) -> Result<Row> {
        let (name, line, [n, m, params]) =
            (&self.name, record.position().map_or(0, csv::Position::line), self.sizes);
        let columns = self.columns.len();
        if record.len() == columns + 1 && record[columns].is_empty() {
            bail!(
                "{name}:{line}: the line ends in a comma, but the header does not; remove the comma"
            );
        }
        if record.len() != columns {
            bail!(
                "{name}:{line}: the row has {} cells; expected {columns}, as in the header",
                record.len()
            );
        }
        let [x, u, p] = [n, m, params].map(|count| vec![f64::NAN; count]);
        let mut row = Row { line, key: String::new(), time: 0.0, x, u, p };
        for (column, cell) in self.columns.iter().zip(record) {
            let number = || number(cell).with_context(|| format!("{name}:{line}"));
            match *column {
                Column::Segment => row.key = cell.to_owned(),
                Column::Time => row.time = number()?,
                Column::State(i) => row.x[i] = number()?,
                Column::Control(i) => row.u[i] = number()?,
                Column::Param(i) => row.p[i] = number()?,
                Column::Ignored => {}
            }
        }
        if row.time.is_nan() {
            bail!("{name}:{line}: the time is missing; give every row a time in s");
        }
        Ok(row)
    }
}

/// The first [`MOST_BYTES`] + 1 bytes of a file.
fn read(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?.take(MOST_BYTES + 1).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Meaning of a column with this header. `names` are those of states, controls and parameters.
fn column(header: &str, names: &[Vec<String>; 3], ignored: &[String]) -> Option<Column> {
    match header {
        "segment" | "sample" => return Some(Column::Segment),
        "t" | "time" => return Some(Column::Time),
        _ if ignored.iter().any(|known| known == header) => return Some(Column::Ignored),
        _ => {}
    }
    let kinds = [Column::State, Column::Control, Column::Param].into_iter().zip(names);
    { kinds }.find_map(|(kind, names)| names.iter().position(|known| known == header).map(kind))
}

/// The number in a cell. An empty cell is a missing number, NaN.
fn number(cell: &str) -> Result<f64> {
    if cell.is_empty() {
        return Ok(f64::NAN);
    }
    let number =
        cell.parse::<f64>().ok().with_context(|| format!("`{}` is not a number", quoted(cell)))?;
    if number.is_infinite() {
        bail!("`{}` is infinite; leave the cell of a missing sample empty", quoted(cell));
    }
    Ok(number)
}

/// Value of the last digit of a number.
fn unit(number: &str) -> f64 {
    let (digits, exponent) = number.split_once(['e', 'E']).unwrap_or((number, "0"));
    let decimals = digits.split_once('.').map_or(0, |(_, decimals)| decimals.len().min(400));
    10_f64.powi(exponent.parse::<i32>().unwrap_or(0).saturating_sub(decimals as i32))
}

/// The beginning of a cell, for messages.
pub fn quoted(cell: &str) -> String {
    match cell.char_indices().nth(QUOTED) {
        Some((end, _)) => format!("{}…", &cell[..end]),
        None => cell.to_owned(),
    }
}

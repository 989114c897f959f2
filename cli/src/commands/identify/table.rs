//! Tables of measured trajectories, in CSV files and in memory: encoding, columns and cells.

use crate::platform::terminal::listed;
use crate::tasks::Scene;
use anyhow::{Context, Result, anyhow, bail};
use physgrad::Number;
use std::collections::{HashMap, HashSet};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Largest size of a file, bytes.
const MOST_BYTES: u64 = 500_000_000;

/// Largest number of characters of a cell in a message.
const QUOTED: usize = 40;

/// Meaning of a column.
#[derive(Clone, Copy, PartialEq)]
enum Meaning {
    Segment,
    Time,
    State(usize),
    Control(usize),
    /// A parameter, constant within a segment.
    Param(usize),
    /// A column without measurements: the step, an applied control, or a number that the fit or
    /// noise replaces.
    Ignored,
}

/// What a caller tells about the columns of a table.
#[derive(Clone, Debug, Default)]
pub struct Reading {
    /// Name of the column of the times; None: `t` or `time`.
    pub time: Option<String>,
    /// Factors from the units of columns to those of the scene, by name. The factor of other columns
    /// is 1.
    pub factors: HashMap<String, f64>,
}

/// Columns of a table, whose meanings are known.
pub struct Columns {
    header: Vec<String>,
    meanings: Vec<Meaning>,
    factors: Vec<f64>,
    /// Numbers of states, controls and parameters.
    sizes: [usize; 3],
}

/// Kind of the cells that [`Columns`] expect in a column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Names of segments.
    Texts,
    Numbers,
    Ignored,
}

/// Cells of a column.
pub enum Cells {
    Texts(Vec<String>),
    /// NaN is a missing number.
    Numbers(Vec<f64>),
    Ignored,
}

/// Where rows are, for messages.
#[derive(Clone)]
pub struct Origin {
    /// Path of a file, or name of a table in memory.
    pub name: String,
    /// Whether numbers of rows are lines of a file.
    is_file: bool,
}

impl Origin {
    /// A row within a sentence.
    pub fn row(&self, number: u64) -> String {
        format!("{} {number}", if self.is_file { "line" } else { "row" })
    }

    /// A row with the name of its table.
    pub fn place(&self, number: u64) -> String {
        let name = &self.name;
        if self.is_file { format!("{name}:{number}") } else { format!("{name}, row {number}") }
    }
}

/// A table whose columns are known.
pub struct Table {
    pub origin: Origin,
    pub columns: Columns,
    content: Content,
}

enum Content {
    /// Bytes of a CSV file.
    Csv(Vec<u8>),
    /// Columns of equal lengths.
    Memory(Vec<Cells>),
}

/// Cells of a row. Missing numbers are NaN.
pub struct Row {
    /// Line of the file, or number of the row in memory.
    pub number: u64,
    /// Name of the segment.
    pub key: String,
    /// Time, s.
    pub time: f64,
    pub x: Vec<f64>,
    pub u: Vec<f64>,
    pub p: Vec<f64>,
}

impl Row {
    /// Whether the row has no state and no control, as rows of a data frame after `reindex`.
    pub fn is_empty(&self) -> bool {
        self.x.iter().chain(&self.u).all(|value| value.is_nan())
    }
}

/// Names of the columns that a scene knows.
struct Names {
    /// States, controls and parameters.
    kinds: [Vec<String>; 3],
    /// Outputs of the actuator, by control.
    applied: Vec<String>,
    ignored: Vec<String>,
}

impl Names {
    /// `scene` is `whole` without its sensor.
    fn new(scene: &Scene, whole: &Scene) -> Self {
        let kinds = [scene.state_names(), scene.control_names(), scene.param_names()];
        let applied = scene.applied_names();
        // The fit replaces trained numbers. Noise has no constant value; the fit uses its mean.
        let is_replaced =
            |number: &Number| matches!(number, Number::Trained { .. } | Number::Noise(_));
        let varied = scene.varied().into_iter();
        let replaced = varied.filter(|(_, number)| is_replaced(number)).map(|(name, _)| name);
        // Components that the sensor adds to the state are in the trajectories of a run.
        let sensed = whole.state_names().into_iter().filter(|name| !kinds[0].contains(name));
        let own = applied.iter().cloned().chain(["step".to_owned()]);
        Self { ignored: own.chain(replaced).chain(sensed).collect(), kinds, applied }
    }

    /// Meaning of a column with this header.
    fn meaning(&self, header: &str, time: Option<&str>) -> Option<Meaning> {
        let is_time = |header: &str| match time {
            Some(time) => header == time,
            None => ["t", "time"].contains(&header),
        };
        match header {
            "segment" | "sample" => return Some(Meaning::Segment),
            _ if is_time(header) => return Some(Meaning::Time),
            _ if self.ignored.iter().any(|known| known == header) => return Some(Meaning::Ignored),
            _ => {}
        }
        let kinds = [Meaning::State, Meaning::Control, Meaning::Param].into_iter().zip(&self.kinds);
        { kinds }.find_map(|(kind, names)| names.iter().position(|known| known == header).map(kind))
    }

    /// The error of a header with the column `unknown`, which has no meaning.
    fn unknown(&self, table: &str, header: &[String], unknown: usize, time: &str) -> anyhow::Error {
        if header[unknown].is_empty() {
            return anyhow!(
                "{table}: column {} has no name; remove the column, or the comma at the end of each line",
                unknown + 1
            );
        }
        let known = self.kinds.iter().map(|names| {
            let names = names.iter().filter(|name| !self.ignored.contains(name));
            names.cloned().collect::<Vec<_>>()
        });
        let known: Vec<String> =
            known.filter(|names| !names.is_empty()).map(|names| listed(&names)).collect();
        anyhow!(
            "{table}: unknown column `{}`; leave it out; allowed: segment, {time}, {}",
            quoted(&header[unknown]),
            known.join(", ")
        )
    }
}

impl Columns {
    /// Columns of the table with this name and header. `scene` is `whole` without its sensor.
    ///
    /// # Errors
    /// There is no column of the time or of a state. A column is unknown, repeated or unnamed, or an
    /// applied control without its control.
    pub fn new(
        table: &str,
        header: Vec<String>,
        [scene, whole]: [&Scene; 2],
        reading: &Reading,
    ) -> Result<Self> {
        let (names, time) = (Names::new(scene, whole), reading.time.as_deref());
        let meaning = |(i, column): (usize, &String)| {
            let unknown = || names.unknown(table, &header, i, time.unwrap_or("t"));
            names.meaning(column, time).ok_or_else(unknown)
        };
        let meanings = header.iter().enumerate().map(meaning).collect::<Result<Vec<_>>>()?;
        for (i, meaning) in
            meanings.iter().enumerate().filter(|(_, meaning)| **meaning != Meaning::Ignored)
        {
            if let Some(first) = meanings[..i].iter().position(|earlier| earlier == meaning) {
                let [first, second] = [first, i].map(|i| &header[i]);
                bail!(
                    "{table}: the columns `{first}` and `{second}` have one meaning; remove one of them"
                );
            }
        }
        if !meanings.contains(&Meaning::Time) {
            bail!("{table}: there is no column `{}` with the time in s", time.unwrap_or("t"));
        }
        if !meanings.iter().any(|meaning| matches!(meaning, Meaning::State(_))) {
            bail!("{table}: there is no column of a state; states: {}", listed(&names.kinds[0]));
        }
        for (i, (control, applied)) in names.kinds[1].iter().zip(&names.applied).enumerate() {
            if !meanings.contains(&Meaning::Control(i)) && header.contains(applied) {
                bail!(
                    "{table}: the column `{control}` is missing; `{applied}` is the output of the actuator, which the simulation \
                     computes from `{control}`. Add this column, with zeros if the control was 0; or rename `{applied}` to \
                     `{control}`, and remove the actuator from the scene"
                );
            }
        }
        let factor = |name: &String| reading.factors.get(name).copied().unwrap_or(1.0);
        let factors = header.iter().map(factor).collect();
        Ok(Self { header, meanings, factors, sizes: names.kinds.map(|names| names.len()) })
    }

    /// Names of the columns.
    pub fn header(&self) -> &[String] {
        &self.header
    }

    /// Kinds of the cells of the columns.
    pub fn kinds(&self) -> Vec<Kind> {
        let kind = |meaning: &Meaning| match meaning {
            Meaning::Segment => Kind::Texts,
            Meaning::Ignored => Kind::Ignored,
            _ => Kind::Numbers,
        };
        self.meanings.iter().map(kind).collect()
    }

    /// Returns whether there is a column of this control.
    pub fn has_control(&self, i: usize) -> bool {
        self.meanings.contains(&Meaning::Control(i))
    }

    /// Returns whether there is a column of this parameter.
    pub fn has_param(&self, i: usize) -> bool {
        self.meanings.contains(&Meaning::Param(i))
    }

    /// Index of the column of the times.
    fn time(&self) -> usize {
        self.meanings.iter().position(|meaning| *meaning == Meaning::Time).unwrap_or(0)
    }
}

impl Table {
    /// Reads a CSV file and its header.
    ///
    /// # Errors
    /// See [`Columns::new`]. The file cannot be read, has more than 500 MB, or is in UTF-16. A line
    /// after the header is a comment. Columns are separated by semicolons or tabs.
    pub fn read(path: &Path, scenes: [&Scene; 2], reading: &Reading) -> Result<Self> {
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
        let mut reader = reader(&bytes);
        let header = reader.headers().with_context(|| format!("cannot read {name}"))?;
        let header: Vec<String> = header.iter().map(str::to_owned).collect();
        if header.is_empty() {
            bail!("{name} has no samples");
        }
        refuse_separators(&name, &header, reader)?;
        let columns = Columns::new(&name, header, scenes, reading)?;
        refuse_comments(&name, &bytes)?;
        Ok(Self { origin: Origin { name, is_file: true }, columns, content: Content::Csv(bytes) })
    }

    /// A table in memory. `name` is for messages.
    ///
    /// # Errors
    /// The columns have different lengths.
    pub fn of(name: String, columns: Columns, cells: Vec<Cells>) -> Result<Self> {
        let lengths = cells.iter().filter_map(Cells::len).collect::<HashSet<_>>();
        if lengths.len() > 1 {
            bail!("{name}: the columns have different lengths");
        }
        let origin = Origin { name, is_file: false };
        Ok(Self { origin, columns, content: Content::Memory(cells) })
    }

    /// Smallest decimal unit of the times in s, for instance 0.001 for three decimals. Writers may
    /// omit zeros at the end, so the unit is that of all rows.
    pub fn unit(&self) -> f64 {
        let time = self.columns.time();
        let least = match &self.content {
            Content::Csv(bytes) => {
                let (mut reader, mut record, mut least) =
                    (reader(bytes), csv::ByteRecord::new(), f64::INFINITY);
                while reader.read_byte_record(&mut record).is_ok_and(|is_row| is_row) {
                    let cell = record.get(time).and_then(|cell| std::str::from_utf8(cell).ok());
                    least = least.min(cell.map_or(least, unit));
                }
                least
            }
            Content::Memory(cells) => match &cells[time] {
                Cells::Numbers(times) => times
                    .iter()
                    .fold(f64::INFINITY, |least, time| least.min(unit(&time.to_string()))),
                _ => f64::INFINITY,
            },
        };
        least * self.columns.factors[time].abs()
    }

    /// Rows of the table.
    ///
    /// # Errors
    /// A row has more or fewer cells than the header. A cell is not a finite number.
    pub fn rows(&self) -> Box<dyn Iterator<Item = Result<Row>> + '_> {
        match &self.content {
            Content::Csv(bytes) => {
                let failed = || format!("cannot read {}", self.origin.name);
                let row = move |record: csv::Result<csv::StringRecord>| {
                    let record = record.with_context(failed)?;
                    let line = record.position().map_or(0, |position| line(bytes, position));
                    self.row(line, &record)
                };
                Box::new(reader(bytes).into_records().map(row))
            }
            Content::Memory(cells) => {
                let count = cells.iter().find_map(Cells::len).unwrap_or(0);
                let row = |row: usize| {
                    let key = |column: usize| match &cells[column] {
                        Cells::Texts(texts) => texts[row].clone(),
                        _ => String::new(),
                    };
                    let number = |column: usize| match &cells[column] {
                        Cells::Numbers(numbers) => Ok(numbers[row]),
                        _ => Ok(f64::NAN),
                    };
                    self.cells(row as u64, &key, &number)
                };
                Box::new((0..count).map(row))
            }
        }
    }

    /// A row of a file.
    fn row(&self, line: u64, record: &csv::StringRecord) -> Result<Row> {
        let (place, columns) = (|| self.origin.place(line), self.columns.header.len());
        if record.len() == columns + 1 && record[columns].is_empty() {
            bail!(
                "{}: the line ends in a comma, but the header does not; remove the comma",
                place()
            );
        }
        if record.len() != columns {
            bail!(
                "{}: the row has {} cells; expected {columns}, as in the header",
                place(),
                record.len()
            );
        }
        let number = |i: usize| {
            number(&record[i]).with_context(|| {
                let column = &self.columns.header[i];
                format!(
                    "{}: `{}` in column `{column}` is not a number",
                    place(),
                    quoted(&record[i])
                )
            })
        };
        self.cells(line, &|i| record[i].to_owned(), &number)
    }

    /// The row with this number, from the keys and numbers of its columns.
    fn cells(
        &self,
        row: u64,
        key: &dyn Fn(usize) -> String,
        number: &dyn Fn(usize) -> Result<f64>,
    ) -> Result<Row> {
        let Columns { header, meanings, factors, sizes } = &self.columns;
        let [x, u, p] = sizes.map(|count| vec![f64::NAN; count]);
        let mut cells = Row { number: row, key: String::new(), time: f64::NAN, x, u, p };
        for (i, meaning) in meanings.iter().enumerate() {
            let number = || {
                let number = number(i)?;
                if number.is_infinite() {
                    bail!(
                        "{}: `{}` is infinite; leave the cell of a missing sample empty",
                        self.origin.place(row),
                        header[i]
                    );
                }
                Ok(number * factors[i])
            };
            match *meaning {
                Meaning::Segment => cells.key = key(i),
                Meaning::Time => cells.time = number()?,
                Meaning::State(i) => cells.x[i] = number()?,
                Meaning::Control(i) => cells.u[i] = number()?,
                Meaning::Param(i) => cells.p[i] = number()?,
                Meaning::Ignored => {}
            }
        }
        Ok(cells)
    }
}

impl Cells {
    /// Number of rows. None for an ignored column.
    fn len(&self) -> Option<usize> {
        match self {
            Self::Texts(texts) => Some(texts.len()),
            Self::Numbers(numbers) => Some(numbers.len()),
            Self::Ignored => None,
        }
    }
}

fn reader(bytes: &[u8]) -> csv::Reader<&[u8]> {
    csv::ReaderBuilder::new()
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .flexible(true)
        .from_reader(bytes)
}

/// Line of the record at this position, which is before empty lines, and before the `\n` of `\r\n`.
fn line(bytes: &[u8], position: &csv::Position) -> u64 {
    let rest = bytes.get(position.byte() as usize..).unwrap_or_default();
    let ends = rest.iter().take_while(|byte| b"\r\n".contains(byte));
    position.line() + ends.filter(|&&byte| byte == b'\n').count() as u64
}

/// Refuses a header with semicolons or tabs between its columns, as spreadsheets write under a
/// locale with decimal commas.
fn refuse_separators(name: &str, header: &[String], reader: csv::Reader<&[u8]>) -> Result<()> {
    let separators = [(';', ";", "semicolons"), ('\t', "\\t", "tabs")];
    let Some((_, escaped, what)) = separators
        .into_iter()
        .find(|(separator, ..)| header.iter().any(|cell| cell.contains(*separator)))
    else {
        return Ok(());
    };
    // Commas in rows without commas between columns are those of numbers.
    let has_commas = reader.into_records().flatten().any(|record| record.len() > 1);
    let (found, first, decimal) = match has_commas && header.len() == 1 {
        true => (
            ", and numbers have decimal commas",
            "commas by points first, and then ",
            ", decimal=\",\"",
        ),
        false => ("", "", ""),
    };
    bail!(
        "{name}: the columns are separated by {what}{found}; allowed: commas, and points in numbers; replace {first}{what} by \
         commas, or convert the file with pandas: read_csv(\"{name}\", sep=\"{escaped}\"{decimal}).to_csv(\"converted.csv\", \
         index=False)"
    )
}

/// Refuses a row that begins with `#`, which may be a comment or the name of a segment.
fn refuse_comments(name: &str, bytes: &[u8]) -> Result<()> {
    let is_comment = |line: &[u8]| line.trim_ascii_start().starts_with(b"#");
    let is_blank = |line: &[u8]| line.trim_ascii().is_empty();
    let mut rows = (1..)
        .zip(bytes.split(|&byte| byte == b'\n'))
        .skip_while(|(_, line)| is_comment(line) || is_blank(line));
    match rows.find(|(_, line)| is_comment(line)) {
        Some((number, _)) => bail!(
            "{name}:{number}: the line begins with `#`; comments are allowed before the header only; remove the line, or \
             write a name in quotation marks"
        ),
        None => Ok(()),
    }
}

/// The first [`MOST_BYTES`] + 1 bytes of a file.
fn read(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?.take(MOST_BYTES + 1).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// The number in a cell. An empty cell is a missing number, NaN. None if it is no number.
fn number(cell: &str) -> Option<f64> {
    if cell.is_empty() { Some(f64::NAN) } else { cell.parse().ok() }
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

//! [`Recordings`]: measured segments from CSV files and from tables in memory, by the rules of
//! `physgrad identify`.

use super::Scene;
use crate::commands::identify::data::Measured;
use crate::commands::identify::remarks::CALL;
use crate::commands::identify::table::{Cells, Columns, Reading, Table};
use anyhow::Result;
use physgrad::identify::Segment;
use std::path::Path;

/// Measured segments of a table.
pub struct Recordings {
    /// Segments with the times of their first rows, s.
    pub segments: Vec<(Segment, f64)>,
    /// What the reading assumes of the data.
    pub notes: Vec<String>,
    /// Names of all columns of the table.
    pub columns: Vec<String>,
}

impl Scene {
    /// Reads a CSV file, as `physgrad identify` does.
    ///
    /// # Errors
    /// The file is no table of this scene. [`TooLong`](super::TooLong) if the segments need more than
    /// 1 GB.
    pub fn read_file(&self, path: &Path, reading: &Reading) -> Result<Recordings> {
        let bare = self.scene.clone().without_sensor()?;
        self.recordings(&Table::read(path, [&bare, &self.scene], reading)?)
    }

    /// Meanings of the columns of the table with this name and header.
    ///
    /// # Errors
    /// A column is missing, unknown or given twice.
    pub fn columns(&self, table: &str, header: Vec<String>, reading: &Reading) -> Result<Columns> {
        let bare = self.scene.clone().without_sensor()?;
        Columns::new(table, header, [&bare, &self.scene], reading)
    }

    /// Reads a table in memory, with the cells of its columns.
    ///
    /// # Errors
    /// Those of [`read_file`](Self::read_file).
    pub fn read_columns(
        &self,
        table: String,
        columns: Columns,
        cells: Vec<Cells>,
    ) -> Result<Recordings> {
        self.recordings(&Table::of(table, columns, cells)?)
    }

    fn recordings(&self, table: &Table) -> Result<Recordings> {
        let bare = self.scene.clone().without_sensor()?;
        let measured = Measured::read(table, &bare, &self.source, &CALL)?;
        let all: Vec<usize> = (0..measured.count()).collect();
        let begin = |&i: &usize| measured.begin_at_step(i, &bare);
        Ok(Recordings {
            segments: measured.chosen(&all, &bare).into_iter().zip(all.iter().map(begin)).collect(),
            notes: measured.notes(&all),
            columns: table.columns.header().to_vec(),
        })
    }
}

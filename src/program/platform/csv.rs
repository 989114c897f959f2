//! [`csv`]: tables as comma-separated values. Callers write the bytes to a file.

use ::csv::Writer;
use anyhow::Result;

/// A header and rows of cells, quoted as in RFC 4180. Each record ends in `\n`.
pub fn csv(
    header: impl IntoIterator<Item = impl AsRef<[u8]>>,
    rows: impl IntoIterator<Item = impl IntoIterator<Item = String>>,
) -> Result<Vec<u8>> {
    let mut csv = Writer::from_writer(Vec::new());
    csv.write_record(header)?;
    for row in rows {
        csv.write_record(row)?;
    }
    Ok(csv.into_inner()?)
}

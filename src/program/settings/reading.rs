//! Deserialization of settings. Errors name the key.

use serde::de::DeserializeOwned;
use toml::Table;

/// Error of serde, and the key of the value: `policy.widths[1]`. The key is empty for the whole
/// table.
#[derive(Debug, thiserror::Error)]
#[error("`{key}`: {message}")]
pub struct Unreadable {
    pub key: String,
    pub message: String,
}

/// Reads a value from a table.
pub fn read<T: DeserializeOwned>(table: Table) -> Result<T, Unreadable> {
    serde_path_to_error::deserialize(table).map_err(|error| {
        let key = error.path().to_string();
        Unreadable { key: if key == "." { String::new() } else { key }, message: error.into_inner().message().to_owned() }
    })
}

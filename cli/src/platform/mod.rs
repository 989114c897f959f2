//! Files, folders and their locks, memory, CSV, JSON, signals, ranks of MPI, tables, threads, terminal.
//!
//! Imports no other part of the program. Start with `folder`.

pub mod csv;
pub mod files;
pub mod folder;
pub mod json;
pub mod lock;
pub mod memory;
#[cfg(feature = "mpi")]
mod mpi;
pub mod parallel;
pub mod ranks;
pub mod signals;
pub mod table;
pub mod terminal;

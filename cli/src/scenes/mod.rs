//! Scene files, presets, sweeps, plans of studies and command-line overrides.
//!
//! Errors name the line or option of a key. Imports `settings`, `tasks` and `platform`. Start with
//! `source`.

pub mod overrides;
pub mod plan;
pub mod presets;
mod ranges;
pub mod source;
pub mod sweep;

//! Scene files, presets, plans of many trainings and command-line overrides.
//!
//! Errors name the line or option of a key. Imports `settings`, `tasks` and `platform`. Start with
//! `source`.

pub mod grid;
pub mod overrides;
pub mod plan;
pub mod presets;
mod ranges;
pub mod source;

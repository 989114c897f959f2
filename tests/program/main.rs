//! The `physgrad` program, and the documentation pages that quote it.

#[path = "../common/running.rs"]
mod running;

mod accuracy;
mod commands;
mod docs;
mod eval;
mod explain;
mod extreme_settings;
mod json;
mod limits;
mod numbers;
mod optimize;
mod own;
mod pages;
mod paper;
mod report;
mod scenes;
mod sweeps;
mod terminal;

//! The `physgrad` program, and the documentation pages that quote it.

#[path = "../common/running.rs"]
mod running;

/// Compiles the unit tests of a module of the program.
#[allow(dead_code)]
#[path = "../../src/program/runs/statistics.rs"]
mod statistics;

mod accuracy;
mod commands;
mod docs;
mod explain;
mod extreme_settings;
mod limits;
mod pages;
mod paper;
mod report;
mod scenes;

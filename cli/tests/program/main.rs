//! The `physgrad` program, and the documentation pages that quote it.

#[path = "../common/running.rs"]
mod running;

#[path = "../common/python.rs"]
mod python;

mod accuracy;
mod book;
mod commands;
mod controllers;
mod docs;
mod equations;
mod eval;
mod explain;
mod export;
mod extreme_settings;
mod foreign;
mod json;
mod limits;
mod links;
mod logs;
mod markdown;
mod noise;
mod numbers;
mod optimize;
mod own;
mod packages;
mod pages;
mod paper;
mod plans;
mod policies;
mod report;
mod runs;
mod scenes;
mod shown_commands;
mod terminal;
mod tutorials;

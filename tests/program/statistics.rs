//! Statistics over several runs: compiles the unit tests of a module of the program.

#[allow(dead_code)]
#[path = "../../src/program/runs/statistics.rs"]
mod statistics;

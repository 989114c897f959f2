//! What several runs say together: the unit tests of a module of the program, which is compiled alone here.

#[allow(dead_code)]
#[path = "../src/program/statistics.rs"]
mod statistics;

//! Tests of the built-in systems: formulas, other engines, the numbers of the authors, hard cases.

mod paper_examples;
mod physics;
mod reference;
mod stress;

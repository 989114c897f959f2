//! Tests of the library, by topic. `cargo test --release -p physgrad-tests TOPIC` runs one topic.
//! `simulations.rs` has those of the built-in systems, so that both compile at the same time.

#![cfg(test)]

mod common {
    pub mod operations;
}
mod derivatives;
mod engine;
mod graph;
mod identify;
mod numbers;
mod optimize;
mod ports;

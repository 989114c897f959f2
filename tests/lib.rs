//! Tests of the library, by topic. `cargo test --release -p physgrad-tests TOPIC` runs one topic.

#![cfg(test)]

mod common {
    pub mod operations;
}
mod derivatives;
mod engine;
mod identify;
mod numbers;
mod optimize;
mod paper_examples;
mod physics;
mod reference;
mod stress;

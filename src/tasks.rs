//! The tasks that come with the framework: physics only, each file self-contained.

mod cart_pole;
mod quantum;

pub use cart_pole::{CartPole, CartPoleSystem, LossMode};
pub use quantum::{Quantum, QuantumSystem};

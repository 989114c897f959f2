//! Physics as one would write it for one scene: one function each way, nothing that could be left out or added.

pub mod cart_pole;
pub mod guidance;
pub mod quantum;

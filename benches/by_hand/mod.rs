//! Handwritten physics: one step and one VJP per scene, without the effect system.

pub mod cart_pole;
pub mod guidance;
pub mod quantum;

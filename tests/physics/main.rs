//! Built-in systems, effects and integrators, against formulas written independently of the code.

#[path = "../../benches/by_hand/mod.rs"]
mod by_hand;

mod boxes;
mod cart_pole_effects;
mod effects;
mod formulas;
mod guidance;
mod guidance_effects;
mod hard_contacts;
mod hard_systems;
mod integrators;
mod numbers;
mod quantum;
mod quantum_effects;
mod quantum_physics;
mod quantum_schemes;

//! Built-in systems, effects and integrators, compared with dual numbers and independent formulas.

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

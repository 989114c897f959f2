//! The tasks that come with the framework: physics only, each self-contained.

mod cart_pole;
mod contact;
mod guidance;
mod loss;
mod quantum;
mod slider;
mod toy;

pub use cart_pole::{
    Bumpers, CartDamping, CartPole, CartPoleEffect, CartPoleModel, CartPoleSystem, CoupledCartPole, DryFriction, GustyWind,
    PoleDamping, SteadyWind,
};
pub use contact::{Bounce, BouncingBall, Contact, Push, TwoBodies};
pub use guidance::{
    Center, Drive, Evade, Flock, Friction, Guidance, GuidanceEffect, GuidanceSystem, Herding, Obstacles, Spread, Walls,
};
pub use loss::LossMode;
pub use quantum::{
    Absorbing, AbsorbingEdges, Barrier, ControlShape, Cubic, DoubleWell, Harmonic, Pade, Quantum, QuantumEffect, QuantumScheme,
    QuantumSystem, Renormalized, Strang, Tabulated,
};
pub use slider::{FrictionScheme, Slider, SliderSystem};
pub use toy::{Bowl, Integrator, Reach};

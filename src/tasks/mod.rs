//! Built-in tasks and their systems and effects. Start with [`CartPole`].
//!
//! - Tasks of the ICLR 2024 paper: [`CartPole`], [`Guidance`], [`Quantum`].
//! - Two-parameter examples of the paper: [`Reach`], [`Bowl`].
//! - Small tasks: [`Lqr`], [`Upright`], [`Slider`], [`Bounce`], [`Push`].

mod cart_pole;
mod contact;
mod double_pendulum;
mod guidance;
mod linear;
mod loss;
mod multi_pendulum;
mod paper_examples;
mod pole_chain;
mod quantum;
mod slider;
mod upright;

pub use cart_pole::{
    Bumpers, CartDamping, CartPole, CartPoleEffect, CartPoleModel, CartPoleSystem, CoupledCartPole,
    DryFriction, GustyWind, MassError, PoleDamping, SteadyWind,
};
pub use contact::{Bounce, BouncingBall, Contact, Push, TwoBodies};
pub use double_pendulum::DoublePendulum;
pub use guidance::{
    Center, Drive, Evade, Flock, Friction, Guidance, GuidanceEffect, GuidanceSystem, Herding,
    Obstacles, Spread, Walls,
};
pub use linear::{LinearPlant, Lqr, NoOptimum, Optimum};
pub use loss::LossMode;
pub use multi_pendulum::{Arm, MultiPendulum};
pub use paper_examples::{Accumulator, Bowl, Reach};
pub use pole_chain::PoleChain;
pub use quantum::{
    Absorbing, AbsorbingEdges, Barrier, ControlShape, Cubic, DoubleWell, Harmonic, Pade, Quantum,
    QuantumEffect, QuantumScheme, QuantumSystem, Renormalized, Strang, Tabulated,
};
pub use slider::{FrictionScheme, Slider, SliderSystem};
pub use upright::Upright;

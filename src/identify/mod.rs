//! Identification of physical parameters from measured trajectories.
//!
//! [`identify`] adjusts entries of the parameters `p` of a [`System`](crate::System) until
//! simulated states agree with measured ones. By default, it also adjusts the initial states of all
//! segments. It minimizes
//!
//! ```text
//! χ² = Σ ((x_i(t) - y_i(t)) / σ_i)²      over all finite measurements y_i(t)
//! ```
//!
//! by the method of Levenberg and Marquardt (Moré 1978, doi:10.1007/BFb0067700), with exact
//! Jacobians by dual numbers. Segments consist of windows, each with its own initial state
//! (multiple shooting; Bock 1981, doi:10.1007/978-3-642-68220-9_8). The iterations minimize the sum
//! of χ² and the weighted squared jumps between windows. The weight grows in fixed stages. The last
//! weight reduces the jumps to rounding errors.
//!
//! This module implements the iterations, because crates for least squares support neither bounds
//! nor the block structure of many initial states.
//!
//! Imports `numbers` and `dynamics`. Start reading in `fit.rs`.

mod angles;
mod descent;
mod elimination;
mod error;
mod fit;
mod jacobian;
mod problem;
mod result;
mod statistics;
mod status;

pub use error::IdentifyError;
pub use fit::{Options, Segment, Unknown, identify};
pub use result::Fit;
pub use status::Status;

//! Errors of an identification.

/// Reason why an identification cannot begin.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum IdentifyError {
    /// Neither parameters nor initial states are free.
    #[error("neither parameters nor initial states are unknown; name at least one parameter")]
    NothingUnknown,
    /// There are fewer measurements than unknowns.
    #[error("{measurements} measurements cannot determine {unknowns} unknowns; use more samples or fewer unknowns")]
    TooFewMeasurements {
        /// Number of finite measurements.
        measurements: usize,
        /// Number of unknown parameters and initial states.
        unknowns: usize,
    },
    /// A list has the wrong length.
    #[error("segment {segment}: {what} has {found} numbers; expected {expected}")]
    Shape {
        /// Index of the segment.
        segment: usize,
        /// Name of the list.
        what: &'static str,
        /// Length found.
        found: usize,
        /// Length expected.
        expected: usize,
    },
    /// An initial value is not within its bounds, or an index is out of range.
    #[error("unknown `{name}`: start {start} with bounds {min} to {max}, entry {index} of {params} parameters")]
    Unknown {
        /// Name of the parameter.
        name: String,
        /// Initial value.
        start: f64,
        /// Lower bound.
        min: f64,
        /// Upper bound.
        max: f64,
        /// Index in `p`.
        index: usize,
        /// Number of parameters.
        params: usize,
    },
    /// The simulation with the initial values diverges.
    #[error("segment {segment} diverges at step {step} with the initial values; choose values closer to the physics")]
    Diverged {
        /// Index of the segment.
        segment: usize,
        /// Step within the segment.
        step: usize,
    },
}

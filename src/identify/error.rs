//! Errors of an identification.

/// Reason why an identification cannot begin, or has no result.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum IdentifyError {
    /// Neither parameters nor initial states are unknown.
    #[error("neither parameters nor initial states are unknown; name at least one parameter")]
    NothingUnknown,
    /// Two unknowns refer to one entry of the parameters.
    #[error("`{}` and `{}` are both entry {index} of the parameters; name each entry once", names[0], names[1])]
    Twice {
        /// Names of the two unknowns.
        names: [String; 2],
        /// Index in `p`.
        index: usize,
    },
    /// There are fewer measurements than unknowns.
    #[error(
        "{measurements} measurements cannot determine {unknowns} unknowns; use more samples or fewer unknowns"
    )]
    TooFewMeasurements {
        /// Number of finite measurements, without first samples that are exact.
        measurements: usize,
        /// Number of unknown parameters and components of initial states that affect the data.
        unknowns: usize,
    },
    /// A list has the wrong length.
    #[error("segment {segment}: {what} has length {found}; expected {expected}")]
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
    /// A control or a parameter is non-finite, or a measured state is infinite.
    #[error("segment {segment}: a {what} is not finite; allowed: finite numbers")]
    NonFinite {
        /// Index of the segment.
        segment: usize,
        /// `control`, `parameter` or `measured state`.
        what: &'static str,
    },
    /// A segment has no samples.
    #[error("segment {segment} has no samples; remove it")]
    Empty {
        /// Index of the segment.
        segment: usize,
    },
    /// The options declare the first samples exact, but a component of a first sample is
    /// non-finite.
    #[error(
        "segment {segment}: component {component} of the first sample is missing, but the options declare the first sample \
         exact; begin at a complete sample, or set `free_starts`"
    )]
    MissingStart {
        /// Index of the segment.
        segment: usize,
        /// Component of the state.
        component: usize,
    },
    /// A parameter has no value in the data and no nominal value.
    #[error(
        "segment {segment}: the parameter `{name}` has no value; add a column of this name to the data"
    )]
    MissingParam {
        /// Index of the segment.
        segment: usize,
        /// Name of the parameter.
        name: String,
    },
    /// The number of standard deviations of the noise differs from the number of state components.
    #[error(
        "the list of noise levels has {found} numbers; expected {expected}, one per state component"
    )]
    NoiseCount {
        /// Length of the list.
        found: usize,
        /// Number of state components.
        expected: usize,
    },
    /// A standard deviation of the noise is not positive and finite, or its square is out of range.
    #[error("the noise of state component {component} is {noise}; allowed: 1e-100 to 1e100")]
    Noise {
        /// Component of the state.
        component: usize,
        /// Standard deviation.
        noise: f64,
    },
    /// The options name an angle that is no component of the state.
    #[error(
        "component {component} in `angles` does not exist; the state has {states} components, from 0"
    )]
    Angle {
        /// Component in the options.
        component: usize,
        /// Number of state components.
        states: usize,
    },
    /// An initial value is non-finite or not within its bounds, or an index is out of range.
    #[error(
        "unknown `{name}`: start {start} with bounds {min} to {max}, entry {index} of {params} parameters; allowed: a finite \
         start within the bounds, and an entry below {params}"
    )]
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
    /// A state or a squared residual of the simulation with the initial values is non-finite.
    #[error(
        "segment {segment} diverges at step {step} with the initial values; choose values closer to the physics, or a shorter time step, such as more substeps"
    )]
    Diverged {
        /// Index of the segment.
        segment: usize,
        /// Step within the segment.
        step: usize,
    },
    /// The flag of the options stopped the identification.
    #[error("the identification was stopped before its end; start it again")]
    Stopped,
    /// χ² will be higher than that of the options.
    #[error("χ² will be higher than `give_up`; raise it, or choose another model")]
    Worse,
}

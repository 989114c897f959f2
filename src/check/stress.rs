//! Stress cases: long horizons, stiffness, chaos, singular geometry and overflow (feature
//! `stress`).
//!
//! Each [`Case`] states a pass criterion, fixed before the first measurement, and reports its
//! [`Finding`]s. Start with [`cases`]. `physgrad stress` prints the results, `tests/stress.rs`
//! tests them, and `docs/stability.md` explains them.
//!
//! ```
//! let case = physgrad::stress::cases().find(|case| case.name == "saturated_policy").expect("a case");
//! assert!(case.run().iter().all(|finding| finding.pass));
//! ```

mod approach;
mod cart_mass;
mod chaos;
mod contact;
mod distances;
mod dry_friction;
mod energy;
mod exponents;
mod failures;
mod lqr_optimum;
mod lqr_unstable;
mod policies;
mod quantum_long;
mod quantum_plateau;
mod random_states;
mod steps;

use std::fmt;

/// Numerically difficult problem with a pass criterion.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// Identifier.
    pub name: &'static str,
    /// Setup in one line.
    pub about: &'static str,
    /// Pass criterion in words.
    pub criterion: &'static str,
    /// Usual failure, remedy in this library, and remaining limits.
    pub explanation: &'static str,
    run: fn() -> Vec<Finding>,
}

impl Case {
    /// Creates a case from its fields.
    pub const fn new(
        name: &'static str,
        about: &'static str,
        criterion: &'static str,
        explanation: &'static str,
        run: fn() -> Vec<Finding>,
    ) -> Self {
        Self { name, about, criterion, explanation, run }
    }

    /// Runs the case. Takes up to several seconds.
    pub fn run(&self) -> Vec<Finding> {
        (self.run)()
    }
}

/// All cases of the library, in the order of `docs/stability.md`. `physgrad stress` adds the case
/// `reproducible`.
pub fn cases() -> impl Iterator<Item = Case> {
    [
        exponents::CASES,
        lqr_optimum::CASES,
        lqr_unstable::CASES,
        chaos::CASES,
        energy::CASES,
        cart_mass::CASES,
        distances::CASES,
        approach::CASES,
        quantum_long::CASES,
        quantum_plateau::CASES,
        dry_friction::CASES,
        contact::CASES,
        policies::CASES,
        random_states::CASES,
        failures::CASES,
    ]
    .concat()
    .into_iter()
}

/// Measured number or fact, with its limit.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// Measured quantity.
    pub what: String,
    /// Measured value.
    pub measured: String,
    /// Required value; empty for information.
    pub limit: String,
    /// True if the value meets the limit, or if there is none.
    pub pass: bool,
}

impl Finding {
    /// Passes if `measured <= limit`. Fails for NaN.
    pub fn at_most(what: impl Into<String>, measured: f64, limit: f64) -> Self {
        Self::new(what, short(measured), format!("at most {}", short(limit)), measured <= limit)
    }

    /// Passes if `measured >= limit`. Fails for NaN.
    pub fn at_least(what: impl Into<String>, measured: f64, limit: f64) -> Self {
        Self::new(what, short(measured), format!("at least {}", short(limit)), measured >= limit)
    }

    /// Passes within the relative tolerance `share` of `expected`. Fails for NaN.
    pub fn near(what: impl Into<String>, measured: f64, expected: f64, share: f64) -> Self {
        let limit = format!("{} to within {} %", short(expected), share * 100.0);
        Self::new(what, short(measured), limit, (measured - expected).abs() <= share * expected.abs())
    }

    /// Passes if `pass` is true.
    pub fn holds(what: impl Into<String>, limit: impl Into<String>, pass: bool, measured: impl Into<String>) -> Self {
        Self::new(what, measured.into(), limit.into(), pass)
    }

    /// Passes if `good == of` and `of > 0`.
    pub fn all(what: impl Into<String>, good: usize, of: usize) -> Self {
        Self::new(what, format!("{good} of {of}"), "all".into(), good == of && of > 0)
    }

    /// Information without a limit; always passes.
    pub fn info(what: impl Into<String>, measured: impl Into<String>) -> Self {
        Self::new(what, measured.into(), String::new(), true)
    }

    fn new(what: impl Into<String>, measured: String, limit: String, pass: bool) -> Self {
        Self { what: what.into(), measured, limit, pass }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { what, measured, limit, pass } = self;
        let required = if limit.is_empty() { String::new() } else { format!(" (required: {limit})") };
        write!(f, "{}: {what}: {measured}{required}", if *pass { "pass" } else { "FAIL" })
    }
}

/// Formats a number. Nonzero magnitudes below 1e-3 or from 1e5 on have an exponent and two
/// decimals. Other integers and other magnitudes of at least 100 have no decimals. The rest have
/// three.
fn short(x: f64) -> String {
    if x == 0.0 || (1e-3..1e5).contains(&x.abs()) {
        let digits = if x.abs() >= 100.0 || x == x.round() { 0 } else { 3 };
        format!("{x:.digits$}")
    } else {
        format!("{x:.2e}")
    }
}

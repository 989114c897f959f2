//! Hard cases: long horizons, stiffness, chaos, singular geometry, overflow. Each has a criterion that was written down before
//! it was measured, and says what came out (feature `stress`).
//!
//! `physgrad stress` prints them, `tests/stress.rs` holds them, and `docs/stability.md` tells of them.
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

/// Something that breaks easily, and what has to come out of it.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// Its name.
    pub name: &'static str,
    /// What is done, in a line.
    pub about: &'static str,
    /// When it passes, in words.
    pub criterion: &'static str,
    /// What goes wrong elsewhere, what is done about it here, and what remains.
    pub story: &'static str,
    run: fn() -> Vec<Finding>,
}

impl Case {
    /// A case of one's own; what the texts say is said at the fields.
    pub const fn new(
        name: &'static str,
        about: &'static str,
        criterion: &'static str,
        story: &'static str,
        run: fn() -> Vec<Finding>,
    ) -> Self {
        Self { name, about, criterion, story, run }
    }

    /// Measures it. Takes up to some seconds.
    pub fn run(&self) -> Vec<Finding> {
        (self.run)()
    }
}

/// All of them, in the order of `docs/stability.md`.
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

/// One number or fact that was measured, and what it had to be.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// What was measured.
    pub what: String,
    /// What came out.
    pub measured: String,
    /// What is asked for.
    pub limit: String,
    /// Whether it is as asked for.
    pub pass: bool,
}

impl Finding {
    /// A number that may be at most `limit`. A NaN is not.
    pub fn at_most(what: impl Into<String>, measured: f64, limit: f64) -> Self {
        Self::new(what, short(measured), format!("at most {}", short(limit)), measured <= limit)
    }

    /// A number that has to be at least `limit`.
    pub fn at_least(what: impl Into<String>, measured: f64, limit: f64) -> Self {
        Self::new(what, short(measured), format!("at least {}", short(limit)), measured >= limit)
    }

    /// A number that may differ from another by a share of it.
    pub fn near(what: impl Into<String>, measured: f64, expected: f64, share: f64) -> Self {
        let limit = format!("{} to within {} %", short(expected), share * 100.0);
        Self::new(what, short(measured), limit, (measured - expected).abs() <= share * expected.abs())
    }

    /// A fact.
    pub fn holds(what: impl Into<String>, limit: impl Into<String>, pass: bool, measured: impl Into<String>) -> Self {
        Self::new(what, measured.into(), limit.into(), pass)
    }

    /// So many of so many, all of which have to be.
    pub fn all(what: impl Into<String>, good: usize, of: usize) -> Self {
        Self::new(what, format!("{good} of {of}"), "all".into(), good == of && of > 0)
    }

    /// A number that is told and not judged.
    pub fn told(what: impl Into<String>, measured: impl Into<String>) -> Self {
        Self::new(what, measured.into(), String::new(), true)
    }

    fn new(what: impl Into<String>, measured: String, limit: String, pass: bool) -> Self {
        Self { what: what.into(), measured, limit, pass }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { what, measured, limit, pass } = self;
        let asked = if limit.is_empty() { String::new() } else { format!(" (asked for: {limit})") };
        write!(f, "{}: {what}: {measured}{asked}", if *pass { "pass" } else { "FAIL" })
    }
}

/// Three digits.
fn short(x: f64) -> String {
    if x == 0.0 || (1e-3..1e5).contains(&x.abs()) {
        let digits = if x.abs() >= 100.0 || x == x.round() { 0 } else { 3 };
        format!("{x:.digits$}")
    } else {
        format!("{x:.2e}")
    }
}

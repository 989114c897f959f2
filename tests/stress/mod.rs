//! Hard cases: long horizons, stiffness, chaos, singular geometry and overflow.
//!
//! Each [`Case`] states a pass criterion, fixed before the first measurement, and reports its
//! [`Finding`]s, which `docs/stability.md` explains. It also has the command that prints them.

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

use physgrad::scalar::{CotangentPack, Dual};
use physgrad::{Cotangent as _, Cotangents, Inputs, Real, Scalar, System, Tangents};
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
    /// Runs the case. Takes up to several seconds.
    pub fn run(&self) -> Vec<Finding> {
        (self.run)()
    }
}

/// All cases, in the order of `docs/stability.md`.
fn cases() -> impl Iterator<Item = Case> {
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
        Self::new(
            what,
            short(measured),
            limit,
            (measured - expected).abs() <= share * expected.abs(),
        )
    }

    /// Passes if `pass` is true.
    pub fn holds(
        what: impl Into<String>,
        limit: impl Into<String>,
        pass: bool,
        measured: impl Into<String>,
    ) -> Self {
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
        let required =
            if limit.is_empty() { String::new() } else { format!(" (required: {limit})") };
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

/// Runs a case and prints its findings.
fn passes(name: &str) {
    let case = cases()
        .find(|case| case.name == name)
        .unwrap_or_else(|| panic!("there is no case `{name}`"));
    let findings = case.run();
    println!("{name}: {}\n  passes when: {}\n  {}", case.about, case.criterion, case.explanation);
    findings.iter().for_each(|finding| println!("  {finding}"));
    let failed: Vec<String> =
        findings.iter().filter(|finding| !finding.pass).map(ToString::to_string).collect();
    assert!(
        !findings.is_empty() && failed.is_empty(),
        "{name} requires: {}\n{}",
        case.criterion,
        failed.join("\n")
    );
}

/// Defines one test per case, with the name of the case, and a test that no case is missing. Long
/// cases are ignored by default.
macro_rules! tests {
    ($($name:ident),+ $(,)?; long: $($long:ident),+ $(,)?) => {
        mod case {
            $(#[test]
            fn $name() {
                $crate::stress::passes(stringify!($name));
            })+
            $(#[test]
            #[ignore = "long: up to a minute"]
            fn $long() {
                $crate::stress::passes(stringify!($long));
            })+
        }

        #[test]
        fn every_case_has_a_test() {
            let tested = [$(stringify!($name)),+, $(stringify!($long)),+];
            for case in cases() {
                assert!(tested.contains(&case.name), "no test runs `{}`", case.name);
            }
        }
    };
}

tests!(
    exploding_adjoint,
    lqr_optimum,
    energy,
    cart_mass,
    guidance_distances,
    guidance_close_approach,
    quantum_plateau,
    dry_friction,
    saturated_policy,
    injected_nan;
    long: lqr_unstable, double_pendulum, quantum_long, contact, random_states
);

/// [`System`] for one scalar type, behind a pointer, so that loops over systems compile once.
trait AnySystem<R: Real> {
    fn state_dim(&self) -> usize;
    fn control_dim(&self) -> usize;
    fn step(&self, inputs: Inputs<'_, R>, next: &mut [R]);
    fn vjp(&self, inputs: Inputs<'_, R>, next_bar: &[One<R>], cotangents: Cotangents<'_, One<R>>);
    fn jvp(&self, inputs: Inputs<'_, R>, tangents: Tangents<'_, R>, next_tan: &mut [R]);
    fn step_by_duals(&self, inputs: Inputs<'_, Four<R>>, next: &mut [Four<R>]);
}

/// One cotangent.
type One<R> = CotangentPack<R, 1>;

/// Dual number with four tangents.
type Four<R> = Dual<R, 4>;

impl<S: System, R: Real> AnySystem<R> for S {
    fn state_dim(&self) -> usize {
        System::state_dim(self)
    }
    fn control_dim(&self) -> usize {
        System::control_dim(self)
    }
    fn step(&self, inputs: Inputs<'_, R>, next: &mut [R]) {
        System::step(self, inputs, next);
    }
    fn vjp(&self, inputs: Inputs<'_, R>, next_bar: &[One<R>], cotangents: Cotangents<'_, One<R>>) {
        System::vjp(self, inputs, next_bar, cotangents);
    }
    fn jvp(&self, inputs: Inputs<'_, R>, tangents: Tangents<'_, R>, next_tan: &mut [R]) {
        System::jvp(self, inputs, tangents, next_tan);
    }
    fn step_by_duals(&self, inputs: Inputs<'_, Four<R>>, next: &mut [Four<R>]) {
        System::step(self, inputs, next);
    }
}

/// [`System::step`] of any scalar, outlined.
#[inline(never)]
fn step<S: System, T: Scalar>(system: &S, inputs: Inputs<'_, T>, next: &mut [T]) {
    system.step(inputs, next);
}

/// [`System::vjp`] for one cotangent of the next state: the cotangents of state, control and
/// parameters.
fn vjp<R: Real>(system: &dyn AnySystem<R>, inputs: Inputs<'_, R>, next_bar: &[R]) -> [Vec<R>; 3] {
    let next_bar: Vec<One<R>> = next_bar.iter().map(|&bar| CotangentPack([bar])).collect();
    let [mut x, mut u, mut p] =
        [inputs.x, inputs.u, inputs.p].map(|inputs| vec![One::<R>::null(); inputs.len()]);
    let cotangents =
        Cotangents { x: Some(&mut x), u: Some(&mut u), p: (!p.is_empty()).then_some(&mut p) };
    system.vjp(inputs, &next_bar, cotangents);
    [x, u, p].map(|cotangents| cotangents.into_iter().map(|CotangentPack([bar])| bar).collect())
}

#[test]
fn the_page_on_hard_cases_lists_every_case_and_criterion() {
    // Joins the lines of paragraphs and of quotations.
    let page = include_str!("../../docs/stability.md");
    let text = page.replace("\n> ", " ").replace("\n\n", "\u{b6}").replace('\n', " ");
    for Case { name, about, criterion, .. } in cases() {
        let about = about[..1].to_uppercase() + &about[1..];
        let described = text.contains(&format!("\u{b6}## {name}\u{b6}{about}."));
        assert!(described, "docs/stability.md lacks this description of {name}: {about}");
        assert!(text.contains(criterion), "docs/stability.md lacks the criterion: {criterion}");
    }
    // Measured values depend on the processor.
}

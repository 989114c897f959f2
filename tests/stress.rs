//! All cases of [`physgrad::stress`] pass.

use physgrad::stress;

fn passes(name: &str) {
    let case = stress::cases().find(|case| case.name == name).unwrap_or_else(|| panic!("there is no case `{name}`"));
    let findings = case.run();
    findings.iter().for_each(|finding| println!("{finding}"));
    let failed: Vec<String> = findings.iter().filter(|finding| !finding.pass).map(ToString::to_string).collect();
    assert!(!findings.is_empty() && failed.is_empty(), "{name} requires: {}\n{}", case.criterion, failed.join("\n"));
}

/// Defines one test per case, with the name of the case, and a test that no case is missing.
macro_rules! cases {
    ($($name:ident),+ $(,)?) => {
        $(#[test]
        fn $name() {
            passes(stringify!($name));
        })+

        #[test]
        fn every_stress_case_has_a_test() {
            let tested = [$(stringify!($name)),+];
            for case in stress::cases() {
                assert!(tested.contains(&case.name), "no test runs `{}`", case.name);
            }
        }
    };
}

cases!(
    exploding_adjoint,
    lqr_optimum,
    lqr_unstable,
    double_pendulum,
    energy,
    cart_mass,
    guidance_distances,
    guidance_close_approach,
    quantum_long,
    quantum_plateau,
    dry_friction,
    contact,
    saturated_policy,
    random_states,
    injected_nan,
);

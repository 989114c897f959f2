//! Runs `physgrad fuzz` on damaged inputs.

use crate::running::physgrad;
use std::time::Duration;

#[test]
fn damaged_inputs_cause_no_panic_and_stay_within_limits_of_time_and_memory() {
    // The timeout also ends a command that hangs on an input. The hang then has no message.
    let mut command = physgrad(&["fuzz"]);
    let output = command.timeout(Duration::from_secs(900)).output().expect("the command runs");
    let [said, error] = [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    assert!(output.status.success() && said.contains("130000 inputs") && !said.contains("FAIL"), "{said}\n{error}");
    for kind in ["scenes", "assignments (--set)", "checkpoints", "run folders"] {
        assert!(said.contains(&format!("{kind}: without a panic")), "{kind}\n{said}");
    }
}

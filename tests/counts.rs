//! What [`Counted`] counts, and which derivatives a rollout asks for at all.

use physgrad::Counts;

#[test]
fn nothing_yet() {
    assert_eq!(Counts::default().to_string(), "nothing");
}

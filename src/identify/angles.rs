//! Angles without the full turns that an encoder removes.

use super::fit::Segment;
use std::f64::consts::TAU;

/// The segments, with full turns added to these components, so that consecutive measurements of an
/// angle differ by at most half a turn. Residuals modulo 2π would have false minima instead.
pub(super) fn continuous(segments: &[Segment], angles: &[usize]) -> Vec<Segment> {
    let mut segments = segments.to_vec();
    for segment in &mut segments {
        for &i in angles {
            let column = unwrapped(segment.x.iter().filter_map(|row| row.get(i)).copied());
            let measured = segment.x.iter_mut().filter_map(|row| row.get_mut(i));
            measured.zip(column).for_each(|(angle, continuous)| *angle = continuous);
        }
    }
    segments
}

/// Removes the full turns between consecutive finite angles.
pub(super) fn unwrapped(angles: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut before = None;
    let angles = angles.map(|angle| {
        if !angle.is_finite() {
            return angle;
        }
        let angle = angle + full_turns(before.map_or(0.0, |before: f64| before - angle));
        before = Some(angle);
        angle
    });
    angles.collect()
}

/// The full turns that are nearest to an angle, in rad. 0 up to half a turn.
fn full_turns(angle: f64) -> f64 {
    (angle / TAU).round() * TAU
}

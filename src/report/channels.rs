//! Animation of numbers over time, for tasks without a specific animation.

use super::animation::{Animation, Shape};

const AXIS: &str = "#9AA0A8";
const TEXT: &str = "#222222";
const CURSOR: &str = "#5B6470";

/// Largest number of frames. Longer rollouts are thinned.
const MAX_FRAMES: usize = 250;
/// Height of the picture, in pixels.
const HEIGHT: f64 = 480.0;
/// Font size, in pixels.
const FONT: f64 = 13.0;
/// Share of the picture width for names and ranges.
const LABELS: f64 = 0.24;

/// One number over time.
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Name, at the left of its band.
    pub name: String,
    /// Values, one per time step.
    pub values: Vec<f64>,
    /// CSS colour.
    pub color: &'static str,
}

/// Animates numbers over time, one band per channel, each with its own range. Values are `dt`
/// seconds apart. A cursor crosses the bands in real time, or in 1 s if the rollout is shorter. A
/// curve ends before the first non-finite value.
pub fn channels_over_time(title: &str, channels: &[Channel], dt: f64) -> Animation {
    let finite = |channel: &Channel| channel.values.iter().take_while(|value| value.is_finite()).count();
    let lengths: Vec<usize> = channels.iter().map(finite).collect();
    let steps = lengths.iter().copied().max().unwrap_or(0).saturating_sub(1);
    // The unit of length is the height of a band. The lowest half unit holds the time axis.
    let height = channels.len().max(1) as f64 + 0.5;
    let (width, font) = (1.5 * height, FONT * height / HEIGHT);
    let left = LABELS * width;
    let x = |step: usize| left + (0.97 * width - left) * step as f64 / steps.max(1) as f64;
    let text = |at: [f64; 2], text: String| Shape::Text { at, size: font, text, color: TEXT };

    let mut still = vec![text([(left + width) / 2.0, 0.15], format!("time, 0 to {} s", number(steps as f64 * dt)))];
    let mut curves = Vec::new();
    for (i, (channel, &length)) in channels.iter().zip(&lengths).enumerate() {
        let values = &channel.values[..length];
        let (low, high) = (values.iter().copied().fold(f64::MAX, f64::min), values.iter().copied().fold(f64::MIN, f64::max));
        let base = height - 1.0 - i as f64;
        let y = |value: f64| base + if high > low { 0.15 + 0.7 * (value - low) / (high - low) } else { 0.5 };
        let points: Vec<[f64; 2]> = values.iter().enumerate().map(|(step, &value)| [x(step), y(value)]).collect();
        still.push(Shape::Line { from: [left, base], to: [0.97 * width, base], width: 0.06 * font, color: AXIS });
        still.push(text([left / 2.0, base + 0.5], channel.name.clone()));
        if length > 0 {
            let range = if high > low { format!("{} to {}", number(low), number(high)) } else { number(low) };
            still.push(text([left / 2.0, base + 0.5 - 1.3 * font], range));
            still.push(Shape::Curve { points: points.clone(), width: 0.14 * font, color: channel.color });
            curves.push((points, channel.color));
        }
    }
    let every = (steps / MAX_FRAMES + 1).max(1);
    let frame = |step: usize| {
        let cursor = Shape::Line { from: [x(step), 0.5], to: [x(step), height], width: 0.1 * font, color: CURSOR };
        let at = |(points, color): &(Vec<[f64; 2]>, &'static str)| Shape::Circle {
            center: points[step.min(points.len() - 1)],
            radius: 0.35 * font,
            color,
        };
        std::iter::once(cursor).chain(curves.iter().map(at)).collect()
    };
    Animation {
        title: title.to_owned(),
        seconds: (steps as f64 * dt).max(1.0),
        view: ([0.0, 0.0], [width, height]),
        still,
        frames: (0..=steps).step_by(every).map(frame).collect(),
    }
}

/// Formats with about three significant digits.
fn number(value: f64) -> String {
    if value == 0.0 {
        return "0".into();
    }
    let digits = 2 - value.abs().log10().floor() as i32;
    match digits {
        0..=5 => format!("{value:.*}", digits as usize),
        -3..0 => format!("{value:.0}"),
        _ => format!("{value:.2e}"),
    }
}

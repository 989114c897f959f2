//! SVG elements of shapes, animated by SMIL.

use super::{HOLD, Shape};
use std::fmt::Write;

/// SVG element of a shape, in pixels.
struct Element {
    tag: &'static str,
    /// Attributes that may change between frames.
    numbers: Vec<(&'static str, String)>,
    /// Attributes that keep their values of the first frame.
    style: String,
    /// Text content.
    content: String,
}

impl Element {
    /// Places a shape in a picture whose upper left corner has the world coordinates (left, top).
    /// `scale` is the number of pixels per unit of length.
    fn new(shape: &Shape, left: f64, top: f64, scale: f64) -> Self {
        let (x, y) = (|x: f64| px((x - left) * scale), |y: f64| px((top - y) * scale));
        let length = |length: f64| px(length.max(0.0) * scale);
        let rectangle = |[cx, cy]: [f64; 2], [w, h]: [f64; 2]| {
            vec![
                ("x", x(cx - w / 2.0)),
                ("y", y(cy + h / 2.0)),
                ("width", length(w)),
                ("height", length(h)),
            ]
        };
        let (tag, numbers, style) = match shape {
            Shape::Line { from, to, width, color } => (
                "line",
                vec![
                    ("x1", x(from[0])),
                    ("y1", y(from[1])),
                    ("x2", x(to[0])),
                    ("y2", y(to[1])),
                    ("stroke-width", length(*width)),
                ],
                format!("stroke=\"{color}\" stroke-linecap=\"round\""),
            ),
            Shape::Circle { center, radius, color } => (
                "circle",
                vec![("cx", x(center[0])), ("cy", y(center[1])), ("r", length(*radius))],
                format!("fill=\"{color}\""),
            ),
            Shape::Rect { center, size, color } => {
                ("rect", rectangle(*center, *size), format!("rx=\"2\" fill=\"{color}\""))
            }
            Shape::Curve { points, width, color } => {
                let points: Vec<String> =
                    points.iter().map(|point| format!("{},{}", x(point[0]), y(point[1]))).collect();
                let style = format!(
                    "fill=\"none\" stroke=\"{color}\" stroke-linecap=\"round\" stroke-linejoin=\"round\""
                );
                (
                    "polyline",
                    vec![("points", points.join(" ")), ("stroke-width", length(*width))],
                    style,
                )
            }
            Shape::Image { center, size, raster } => {
                // Both rules keep cell edges sharp. Viewers that do not support `pixelated` use
                // `optimizeSpeed`.
                let style = "preserveAspectRatio=\"none\" style=\"image-rendering:optimizeSpeed;image-rendering:pixelated\"";
                (
                    "image",
                    rectangle(*center, *size),
                    format!("{style} href=\"{}\"", raster.data_uri()),
                )
            }
            Shape::Text { at, size, color, .. } => (
                "text",
                vec![("x", x(at[0])), ("y", y(at[1])), ("font-size", length(*size))],
                format!("fill=\"{color}\""),
            ),
        };
        let content =
            if let Shape::Text { text, .. } = shape { escaped(text) } else { String::new() };
        Self { tag, numbers, style, content }
    }
}

/// Writes static shapes, and the shapes of all frames, in a picture whose upper left corner has the
/// world coordinates `corner`.
///
/// # Panics
/// Panics if the frames differ in the kinds or order of their shapes.
pub fn write(
    svg: &mut String,
    still: &[Shape],
    frames: &[Vec<Shape>],
    corner: [f64; 2],
    scale: f64,
    seconds: f64,
) {
    let elements = |shapes: &[Shape]| -> Vec<Element> {
        shapes.iter().map(|shape| Element::new(shape, corner[0], corner[1], scale)).collect()
    };
    let frames: Vec<Vec<Element>> = frames.iter().map(|shapes| elements(shapes)).collect();
    let times = Times::new(frames.len(), seconds);
    for element in elements(still) {
        times.write_element(svg, &[&element]);
    }
    let Some(first) = frames.first() else { return };
    for frame in &frames {
        let kinds =
            |elements: &[Element]| elements.iter().map(|element| element.tag).collect::<Vec<_>>();
        assert!(
            kinds(frame) == kinds(first),
            "every frame of an animation needs the same shapes in the same order"
        );
    }
    for i in 0..first.len() {
        let history: Vec<&Element> = frames.iter().map(|frame| &frame[i]).collect();
        times.write_element(svg, &history);
    }
}

/// Timing of an animation, as SMIL attributes.
struct Times {
    key_times: String,
    duration: String,
}

impl Times {
    /// Spaces the frames evenly over `seconds`, then holds the last frame for [`HOLD`]. A duration
    /// that is below 0.1 s or non-finite becomes 0.1 s.
    fn new(frames: usize, seconds: f64) -> Self {
        let seconds = if seconds.is_finite() { seconds.max(0.1) } else { 0.1 };
        let share = seconds / (seconds + HOLD) / frames.saturating_sub(1).max(1) as f64;
        let mut key_times: Vec<String> =
            (0..frames).map(|i| trimmed(i as f64 * share, 4)).collect();
        key_times.push("1".into());
        Self { key_times: key_times.join(";"), duration: trimmed(seconds + HOLD, 2) }
    }

    /// Writes an element from its states in all frames.
    fn write_element(&self, svg: &mut String, history: &[&Element]) {
        let Element { tag, numbers, style, content } = history[0];
        let _ = write!(svg, "<{tag} {style}");
        let mut animations = String::new();
        for (i, (name, start)) in numbers.iter().enumerate() {
            let _ = write!(svg, " {name}=\"{start}\"");
            let mut values: Vec<&str> =
                history.iter().map(|element| element.numbers[i].1.as_str()).collect();
            if values.iter().any(|value| value != start) {
                values.push(values[values.len() - 1]);
                let _ = write!(
                    animations,
                    "<animate attributeName=\"{name}\" values=\"{}\" keyTimes=\"{}\" dur=\"{}s\" repeatCount=\"indefinite\"/>",
                    values.join(";"),
                    self.key_times,
                    self.duration
                );
            }
        }
        let _ = writeln!(svg, ">{content}{animations}</{tag}>");
    }
}

/// Formats a length in pixels with at most two decimals. Non-finite values become 0. Clamps other
/// values to ±1e5, because browsers reject an animation with an out-of-range number.
pub fn px(value: f64) -> String {
    trimmed(if value.is_finite() { value.clamp(-1e5, 1e5) } else { 0.0 }, 2)
}

/// Formats with at most `decimals` decimals, without trailing zeros.
fn trimmed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    let text =
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    if text == "-0" { "0".into() } else { text.into() }
}

/// Escapes `&`, `<` and `>` in XML text.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

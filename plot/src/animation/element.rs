//! SVG elements of shapes, animated by SMIL.

use super::{HOLD, Shape};
use std::collections::HashMap;
use std::fmt::Write;

const ROUND: &str = "stroke-linecap=\"round\" stroke-linejoin=\"round\"";
/// Both rules keep the edges of cells sharp. Viewers that do not support `pixelated` use
/// `optimizeSpeed`.
const SHARP: &str = "preserveAspectRatio=\"none\" style=\"image-rendering:optimizeSpeed;image-rendering:pixelated\"";

/// Largest error of a coordinate of a solid between the states that are written, in pixels.
const TOLERANCE: f64 = 0.15;

/// SVG element of a shape, in pixels.
struct Element {
    tag: &'static str,
    /// Which solid it shows, if it is one.
    solid: Option<usize>,
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
                (
                    "polyline",
                    vec![("points", points.join(" ")), ("stroke-width", length(*width))],
                    format!("fill=\"none\" stroke=\"{color}\" {ROUND}"),
                )
            }
            Shape::Solid { points, width, color, .. } => (
                "polyline",
                solid_numbers(points, *width, color, [left, top], scale),
                format!("fill=\"currentColor\" stroke=\"currentColor\" {ROUND}"),
            ),
            Shape::Image { center, size, raster } => (
                "image",
                rectangle(*center, *size),
                format!("{SHARP} href=\"{}\"", raster.data_uri()),
            ),
            Shape::Text { at, size, color, .. } => (
                "text",
                vec![("x", x(at[0])), ("y", y(at[1])), ("font-size", length(*size))],
                format!("fill=\"{color}\""),
            ),
        };
        let content =
            if let Shape::Text { text, .. } = shape { escaped(text) } else { String::new() };
        let solid = if let Shape::Solid { id, .. } = shape { Some(*id) } else { None };
        Self { tag, solid, numbers, style, content }
    }
}

/// Attributes of a solid, whose colour is one of them.
fn solid_numbers(
    points: &[[f64; 2]],
    width: f64,
    color: &str,
    [left, top]: [f64; 2],
    scale: f64,
) -> Vec<(&'static str, String)> {
    // A disc needs a second point to have round ends, and the edge of a polygon is closed.
    let last = points.first().filter(|_| points.len() != 2);
    let points: Vec<String> = points
        .iter()
        .chain(last)
        .map(|[x, y]| format!("{},{}", tenths((x - left) * scale), tenths((top - y) * scale)))
        .collect();
    vec![
        ("points", points.join(" ")),
        ("stroke-width", tenths(width.max(0.0) * scale)),
        ("color", color.to_owned()),
    ]
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
        times.write_element(svg, &[(0, &element)]);
    }
    let Some(first) = frames.first() else { return };
    for frame in &frames {
        let kinds = |elements: &[Element]| -> Vec<_> {
            elements.iter().map(|element| (element.tag, element.solid.is_some())).collect()
        };
        assert!(
            kinds(frame) == kinds(first),
            "every frame of an animation needs the same shapes in the same order"
        );
    }
    let solids: Vec<HashMap<usize, &Element>> = frames
        .iter()
        .map(|frame| frame.iter().filter_map(|e| Some((e.solid?, e))).collect())
        .collect();
    for i in 0..first.len() {
        times.write_element(svg, &history(&frames, &solids, i));
    }
}

/// States of the element at one place of the painting order, with the frames of their times.
///
/// Between two frames, it shows the solid of the first one on the way to the place that this has in
/// the second one. Then it jumps: it has two states at this time.
fn history<'a>(
    frames: &'a [Vec<Element>],
    solids: &[HashMap<usize, &'a Element>],
    place: usize,
) -> Vec<(usize, &'a Element)> {
    let mut history: Vec<(usize, &Element)> = Vec::with_capacity(frames.len());
    for (time, frame) in frames.iter().enumerate() {
        if let Some((_, before)) = history.last()
            && let Some(id) = before.solid.filter(|_| before.solid != frame[place].solid)
        {
            history.push((time, solids[time].get(&id).unwrap_or(before)));
        }
        history.push((time, &frame[place]));
    }
    history
}

/// Timing of an animation, as SMIL attributes.
struct Times {
    /// Times of the frames, and of the end, as shares of the duration.
    shares: Vec<String>,
    duration: String,
}

impl Times {
    /// Spaces the frames evenly over `seconds`, then holds the last frame for [`HOLD`]. A duration
    /// that is below 0.1 s or non-finite becomes 0.1 s.
    fn new(frames: usize, seconds: f64) -> Self {
        let seconds = if seconds.is_finite() { seconds.max(0.1) } else { 0.1 };
        let share = seconds / (seconds + HOLD) / frames.saturating_sub(1).max(1) as f64;
        let mut shares: Vec<String> = (0..frames).map(|i| trimmed(i as f64 * share, 4)).collect();
        shares.push("1".into());
        Self { shares, duration: trimmed(seconds + HOLD, 2) }
    }

    /// Writes an element from its states and their frames.
    fn write_element(&self, svg: &mut String, history: &[(usize, &Element)]) {
        let Element { tag, solid, numbers, style, content } = history[0].1;
        let _ = write!(svg, "<{tag} {style}");
        let mut animations = String::new();
        for (i, (name, start)) in numbers.iter().enumerate() {
            let _ = write!(svg, " {name}=\"{start}\"");
            let mut states: Vec<(usize, &str)> =
                history.iter().map(|(time, e)| (*time, e.numbers[i].1.as_str())).collect();
            if states.iter().any(|(_, value)| value != start) {
                if solid.is_some() {
                    states = thinned(&states);
                }
                states.push((self.shares.len() - 1, states[states.len() - 1].1));
                let (times, values): (Vec<_>, Vec<_>) = states
                    .iter()
                    .map(|(time, value)| (self.shares[*time].as_str(), *value))
                    .unzip();
                let _ = write!(
                    animations,
                    "<animate attributeName=\"{name}\" values=\"{}\" keyTimes=\"{}\" dur=\"{}s\" repeatCount=\"indefinite\"/>",
                    values.join(";"),
                    times.join(";"),
                    self.duration
                );
            }
        }
        let _ = writeln!(svg, ">{content}{animations}</{tag}>");
    }
}

/// States without those that interpolation of the others reproduces to [`TOLERANCE`].
fn thinned<'a>(states: &[(usize, &'a str)]) -> Vec<(usize, &'a str)> {
    let numbers: Vec<Vec<Option<f64>>> = states
        .iter()
        .map(|(_, text)| text.split([' ', ',']).map(|number| number.parse().ok()).collect())
        .collect();
    let reproduced = |[from, i, to]: [usize; 3]| {
        let [start, time, end] = [from, i, to].map(|state| states[state].0 as f64);
        let share = (time - start) / (end - start);
        let near = |k: usize| match [from, i, to].map(|state| numbers[state][k]) {
            [Some(a), Some(x), Some(b)] => (a + share * (b - a) - x).abs() <= TOLERANCE,
            _ => states[from].1 == states[i].1 && states[i].1 == states[to].1,
        };
        let [counts @ .., count] = [from, to, i].map(|state| numbers[state].len());
        counts == [count; 2] && (0..count).all(near)
    };
    let mut kept = vec![0];
    while let Some(&from) = kept.last().filter(|&&last| last + 1 < states.len()) {
        let far_enough = |&to: &usize| (from + 1..to).all(|i| reproduced([from, i, to]));
        kept.push((from + 2..states.len()).take_while(far_enough).last().unwrap_or(from + 1));
    }
    kept.into_iter().map(|i| states[i]).collect()
}

/// Formats a length in pixels with at most two decimals.
pub fn px(value: f64) -> String {
    trimmed(writable(value), 2)
}

/// As [`px`], with at most one decimal.
fn tenths(value: f64) -> String {
    trimmed(writable(value), 1)
}

/// Turns non-finite values into 0. Clamps other values to ±1e5, because browsers reject an animation
/// with an out-of-range number.
fn writable(value: f64) -> f64 {
    if value.is_finite() { value.clamp(-1e5, 1e5) } else { 0.0 }
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

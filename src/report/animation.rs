//! Animated SVG pictures by SMIL. They contain no scripts, so they also play inside an `<img>` tag.

use super::Raster;
use std::fmt::Write;

/// Duration of the last frame before the loop restarts, s.
const HOLD: f64 = 0.7;
/// Largest width and height of the view, in pixels.
const MAX_SIZE: [f64; 2] = [720.0, 480.0];
/// Height of the title strip above the view, in pixels.
const TITLE_HEIGHT: f64 = 40.0;

/// Shape in the coordinates of [`Animation::view`], with y upwards.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// Straight line with round ends.
    Line {
        /// Start point.
        from: [f64; 2],
        /// End point.
        to: [f64; 2],
        /// Thickness.
        width: f64,
        /// CSS colour.
        color: &'static str,
    },
    /// Filled circle.
    Circle {
        /// Center.
        center: [f64; 2],
        /// Radius.
        radius: f64,
        /// CSS colour.
        color: &'static str,
    },
    /// Filled axis-aligned rectangle with slightly rounded corners.
    Rect {
        /// Center.
        center: [f64; 2],
        /// Width and height.
        size: [f64; 2],
        /// CSS colour.
        color: &'static str,
    },
    /// Polyline with round joins and ends.
    Curve {
        /// Vertices; the same number in every frame.
        points: Vec<[f64; 2]>,
        /// Thickness.
        width: f64,
        /// CSS colour.
        color: &'static str,
    },
    /// Image in an axis-aligned rectangle. It may move, but its cells are constant.
    Image {
        /// Center.
        center: [f64; 2],
        /// Width and height.
        size: [f64; 2],
        /// Cells.
        raster: Raster,
    },
    /// Text that may move, with constant content.
    Text {
        /// Center of the baseline.
        at: [f64; 2],
        /// Font size.
        size: f64,
        /// Content.
        text: String,
        /// CSS colour.
        color: &'static str,
    },
}

/// Looping animation with evenly spaced frames and a short hold on the last one.
pub struct Animation {
    /// Title above the picture.
    pub title: String,
    /// Duration from the first frame to the last, s.
    pub seconds: f64,
    /// Visible rectangle of the world: lower left and upper right corner. Clips all shapes.
    pub view: ([f64; 2], [f64; 2]),
    /// Static background.
    pub still: Vec<Shape>,
    /// Shapes of each frame: the same kinds in the same order. Colours and texts keep their values
    /// of the first frame.
    pub frames: Vec<Vec<Shape>>,
}

impl Animation {
    /// Renders to SVG. Static shapes are written once; moving ones are interpolated linearly
    /// between frames.
    ///
    /// # Panics
    /// Panics if the frames differ in the kinds or order of their shapes.
    pub fn to_svg(&self) -> String {
        let (low, high) = self.view;
        let world = [high[0] - low[0], high[1] - low[1]].map(|size| if size.is_normal() && size > 0.0 { size } else { 1.0 });
        let scale = (MAX_SIZE[0] / world[0]).min(MAX_SIZE[1] / world[1]);
        let (width, height) = (world[0] * scale, world[1] * scale);
        // Reserves width for the title above a narrow view.
        let full_width = width.max(MAX_SIZE[0] / 2.0);
        let (w, h, full_w, full_h) = (px(width), px(height), px(full_width), px(height + TITLE_HEIGHT));
        let (left, middle, title) = (px((full_width - width) / 2.0), px(full_width / 2.0), escaped(&self.title));
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {full_w} {full_h}\" width=\"{full_w}\" \
             height=\"{full_h}\" font-family=\"DejaVu Sans, Verdana, Arial, sans-serif\" text-anchor=\"middle\">\n\
             <title>{title}</title>\n<rect width=\"{full_w}\" height=\"{full_h}\" rx=\"12\" fill=\"white\"/>\n\
             <text x=\"{middle}\" y=\"27\" font-size=\"16\" fill=\"#222\">{title}</text>\n\
             <svg x=\"{left}\" y=\"{TITLE_HEIGHT}\" width=\"{w}\" height=\"{h}\">\n"
        );
        let elements = |shapes: &[Shape]| -> Vec<Element> {
            shapes.iter().map(|shape| Element::new(shape, low[0], high[1], scale)).collect()
        };
        let frames: Vec<Vec<Element>> = self.frames.iter().map(|shapes| elements(shapes)).collect();
        let times = Times::new(frames.len(), self.seconds);
        for element in elements(&self.still) {
            times.write_element(&mut svg, &[&element]);
        }
        if let Some(first) = frames.first() {
            for frame in &frames {
                let kinds = |elements: &[Element]| elements.iter().map(|element| element.tag).collect::<Vec<_>>();
                assert!(kinds(frame) == kinds(first), "every frame of an animation needs the same shapes in the same order");
            }
            for i in 0..first.len() {
                let history: Vec<&Element> = frames.iter().map(|frame| &frame[i]).collect();
                times.write_element(&mut svg, &history);
            }
        }
        svg + "</svg>\n</svg>\n"
    }
}

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
    fn new(shape: &Shape, left: f64, top: f64, scale: f64) -> Self {
        let (x, y) = (|x: f64| px((x - left) * scale), |y: f64| px((top - y) * scale));
        let length = |length: f64| px(length.max(0.0) * scale);
        let rectangle = |[cx, cy]: [f64; 2], [w, h]: [f64; 2]| {
            vec![("x", x(cx - w / 2.0)), ("y", y(cy + h / 2.0)), ("width", length(w)), ("height", length(h))]
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
            Shape::Circle { center, radius, color } => {
                ("circle", vec![("cx", x(center[0])), ("cy", y(center[1])), ("r", length(*radius))], format!("fill=\"{color}\""))
            }
            Shape::Rect { center, size, color } => ("rect", rectangle(*center, *size), format!("rx=\"2\" fill=\"{color}\"")),
            Shape::Curve { points, width, color } => {
                let points: Vec<String> = points.iter().map(|point| format!("{},{}", x(point[0]), y(point[1]))).collect();
                let style = format!("fill=\"none\" stroke=\"{color}\" stroke-linecap=\"round\" stroke-linejoin=\"round\"");
                ("polyline", vec![("points", points.join(" ")), ("stroke-width", length(*width))], style)
            }
            Shape::Image { center, size, raster } => {
                // Both rules keep cell edges sharp. Viewers that do not support `pixelated` use
                // `optimizeSpeed`.
                let style = "preserveAspectRatio=\"none\" style=\"image-rendering:optimizeSpeed;image-rendering:pixelated\"";
                ("image", rectangle(*center, *size), format!("{style} href=\"{}\"", raster.data_uri()))
            }
            Shape::Text { at, size, color, .. } => {
                ("text", vec![("x", x(at[0])), ("y", y(at[1])), ("font-size", length(*size))], format!("fill=\"{color}\""))
            }
        };
        let content = if let Shape::Text { text, .. } = shape { escaped(text) } else { String::new() };
        Self { tag, numbers, style, content }
    }
}

/// Timing of an animation, as SMIL attributes.
struct Times {
    key_times: String,
    duration: String,
}

impl Times {
    /// Spaces the frames evenly over `seconds` and adds the hold.
    fn new(frames: usize, seconds: f64) -> Self {
        let seconds = if seconds.is_finite() { seconds.max(0.1) } else { 0.1 };
        let share = seconds / (seconds + HOLD) / frames.saturating_sub(1).max(1) as f64;
        let mut key_times: Vec<String> = (0..frames).map(|i| trimmed(i as f64 * share, 4)).collect();
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
            let mut values: Vec<&str> = history.iter().map(|element| element.numbers[i].1.as_str()).collect();
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

/// Formats a length in pixels to two decimals. Non-finite values become 0. Other values are
/// clamped, because browsers reject an animation with an out-of-range number.
fn px(value: f64) -> String {
    trimmed(if value.is_finite() { value.clamp(-1e5, 1e5) } else { 0.0 }, 2)
}

/// Formats with at most `decimals` decimals, without trailing zeros.
fn trimmed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    if text == "-0" { "0".into() } else { text.into() }
}

/// Escapes XML special characters.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moving_dot(xs: &[f64]) -> Animation {
        let dot = |&x: &f64| vec![Shape::Circle { center: [x, 0.5], radius: 0.1, color: "red" }];
        Animation {
            title: "a < b".into(),
            seconds: 2.0,
            view: ([0.0, 0.0], [2.0, 1.0]),
            still: Vec::new(),
            frames: xs.iter().map(dot).collect(),
        }
    }

    #[test]
    fn only_attributes_that_change_are_animated() {
        let svg = moving_dot(&[0.0, 1.0, f64::NAN]).to_svg();
        let document = roxmltree::Document::parse(&svg).expect("an SVG is XML");
        let animated: Vec<_> = document.descendants().filter(|node| node.has_tag_name("animate")).collect();
        assert_eq!(animated.len(), 1);
        assert_eq!(animated[0].attribute("attributeName"), Some("cx"));
        assert_eq!(animated[0].attribute("values"), Some("0;360;0;0"));
        assert_eq!(animated[0].attribute("keyTimes"), Some("0;0.3704;0.7407;1"));
        assert_eq!(animated[0].attribute("dur"), Some("2.7s"));
    }

    #[test]
    fn zero_or_one_frame_yields_no_animate_element() {
        for svg in [moving_dot(&[]).to_svg(), moving_dot(&[1.0]).to_svg()] {
            roxmltree::Document::parse(&svg).expect("an SVG is XML");
            assert!(!svg.contains("<animate"));
        }
    }

    #[test]
    fn static_shapes_are_written_once_without_an_animate_element() {
        let curve = |y: f64| Shape::Curve { points: vec![[0.0, y], [1.0, 0.5]], width: 0.1, color: "red" };
        let raster = Raster::new(&[vec![0.0, 1.0]]);
        let mut animation = moving_dot(&[0.0, 1.0]);
        animation.still = vec![Shape::Image { center: [1.0, 0.5], size: [1.0, 0.5], raster }, curve(0.0)];
        for (frame, y) in animation.frames.iter_mut().zip([0.0, 1.0]) {
            frame.push(curve(y));
        }
        let svg = animation.to_svg();
        let document = roxmltree::Document::parse(&svg).expect("an SVG is XML");
        let all = |tag| document.descendants().filter(move |node| node.has_tag_name(tag)).collect::<Vec<_>>();
        let (image, curves) = (all("image"), all("polyline"));
        assert!(image[0].attribute("href").is_some_and(|href| href.starts_with("data:image/png;base64,")));
        assert_eq!((image[0].attribute("x"), image[0].attribute("y")), (Some("180"), Some("90")));
        assert_eq!(curves.iter().map(|curve| curve.children().count()).collect::<Vec<_>>(), [0, 1]);
        let animated = curves[1].first_element_child().and_then(|node| node.attribute("values"));
        assert_eq!(animated, Some("0,360 360,180;0,0 360,180;0,0 360,180"));
    }

    #[test]
    #[should_panic(expected = "same shapes")]
    fn frames_with_different_shapes_panic() {
        let mut animation = moving_dot(&[0.0, 1.0]);
        animation.frames[1].clear();
        animation.to_svg();
    }
}

//! Animated SVG pictures by SMIL, and pixels of single frames. The SVG contains no scripts, so it
//! also plays inside an `<img>` tag.

mod below;
mod element;
mod picture;

pub use picture::Picture;

use super::drawing::valid;
use super::{Channel, Raster};
use element::{escaped, px};

/// Duration of the last frame before the loop restarts, s.
const HOLD: f64 = 0.7;
/// Largest width and height of the view, in pixels.
const MAX_SIZE: [f64; 2] = [720.0, 480.0];
/// Width of a picture with channels, and the largest width of its view, in pixels. Small enough to
/// keep labels legible on phones.
const CHANNELS_WIDTH: f64 = 540.0;
/// Height of the title strip above the view, in pixels.
const TITLE_HEIGHT: f64 = 40.0;
/// Height of the legend below the title, in pixels.
const LEGEND_HEIGHT: f64 = 22.0;

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
    /// Filled polyline with round joins and ends: a disc for one point, a capsule for two, a convex
    /// polygon for more. Solids of a frame are painted in their order, which may change: a solid
    /// has the same `id` in all frames.
    Solid {
        /// Which solid this is.
        id: usize,
        /// Vertices.
        points: Vec<[f64; 2]>,
        /// Thickness of the edge: the diameter of a disc or capsule.
        width: f64,
        /// CSS colour.
        color: String,
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

/// Rectangle of the world: lower left and upper right corner.
pub type View = ([f64; 2], [f64; 2]);

/// Looping animation with evenly spaced frames and a short hold on the last one.
///
/// From top to bottom: title, legend, view, scale of lengths, channels, and the time axis.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Animation {
    /// Title above the picture.
    pub title: String,
    /// Duration from the first frame to the last, s.
    pub seconds: f64,
    /// Visible rectangle of the world. Clips all shapes.
    pub view: View,
    /// View with what later states are likely to need, for pictures of an unfinished motion. `None`
    /// if that is the view.
    pub reach: Option<View>,
    /// Static background.
    pub still: Vec<Shape>,
    /// Shapes of each frame: the same kinds in the same order. Texts and, except those of solids,
    /// colours keep their values of the first frame.
    pub frames: Vec<Vec<Shape>>,
    /// Legend: names and CSS colours.
    pub legend: Vec<(String, &'static str)>,
    /// Unit of length of the view, for its scale. Empty for no scale.
    pub unit: &'static str,
    /// Numbers over time, one band each, below the view.
    pub channels: Vec<Channel>,
    /// Simulated time from the first frame to the last, s. 0 for no time axis.
    pub time: f64,
}

impl Animation {
    /// Gives animations of one system the same scale. The view is the union of their views. The
    /// range of a channel is the union of the ranges of all channels with this name.
    pub fn share_scale(animations: &mut [&mut Self]) {
        let Some(view) = animations.iter().map(|animation| animation.view).reduce(Self::union)
        else {
            return;
        };
        let ranges: Vec<(String, [f64; 2])> = animations
            .iter()
            .flat_map(|animation| &animation.channels)
            .map(|c| (c.name.clone(), c.range()))
            .collect();
        for animation in animations {
            animation.view = view;
            for channel in &mut animation.channels {
                let same = ranges
                    .iter()
                    .filter(|(name, _)| *name == channel.name)
                    .map(|(_, range)| *range);
                channel.range = same.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
            }
        }
    }

    /// Smallest rectangle that contains both.
    pub(super) fn union(a: View, b: View) -> View {
        let pick = |i: usize| (a.0[i].min(b.0[i]), a.1[i].max(b.1[i]));
        let (x, y) = (pick(0), pick(1));
        ([x.0, y.0], [x.1, y.1])
    }

    /// Width and height of the view, with 1 in place of a degenerate size.
    fn world(&self) -> [f64; 2] {
        let (low, high) = self.view;
        [high[0] - low[0], high[1] - low[1]]
            .map(|size| if size.is_normal() && size > 0.0 { size } else { 1.0 })
    }

    /// Largest width and height of the view, in pixels.
    fn largest(&self) -> [f64; 2] {
        if self.channels.is_empty() {
            MAX_SIZE
        } else {
            [CHANNELS_WIDTH, MAX_SIZE[1] - below::TAKEN]
        }
    }

    /// False for channels alone.
    fn has_view(&self) -> bool {
        !self.frames.is_empty() || !self.still.is_empty() || self.channels.is_empty()
    }

    /// Renders to SVG. Writes static shapes once. Viewers interpolate moving shapes linearly
    /// between frames.
    ///
    /// # Panics
    /// Panics if the frames differ in the kinds or order of their shapes.
    pub fn to_svg(&self) -> String {
        let (low, high) = self.view;
        let (world, largest, below) = (self.world(), self.largest(), below::Below::of(self));
        let scale = (largest[0] / world[0]).min(largest[1] / world[1]);
        let (width, height) =
            if self.has_view() { (world[0] * scale, world[1] * scale) } else { (0.0, 0.0) };
        // Reserves width for the title above a narrow view, and for channels below it.
        let full_width =
            width.max(if self.channels.is_empty() { MAX_SIZE[0] / 2.0 } else { CHANNELS_WIDTH });
        let top = TITLE_HEIGHT + if self.legend.is_empty() { 0.0 } else { LEGEND_HEIGHT };
        let total = top + height + below.height();
        let (w, h, full_w, full_h) = (px(width), px(height), px(full_width), px(total));
        let (left, middle, title) =
            (px((full_width - width) / 2.0), px(full_width / 2.0), escaped(&self.title));
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {full_w} {full_h}\" width=\"{full_w}\" \
             height=\"{full_h}\" font-family=\"DejaVu Sans, Verdana, Arial, sans-serif\" text-anchor=\"middle\">\n\
             <title>{title}</title>\n<rect width=\"{full_w}\" height=\"{full_h}\" rx=\"12\" fill=\"white\"/>\n\
             <text x=\"{middle}\" y=\"27\" font-size=\"16\" fill=\"#222\">{title}</text>\n\
             <svg x=\"{left}\" y=\"{}\" width=\"{w}\" height=\"{h}\">\n",
            px(top)
        );
        element::write(&mut svg, &self.still, &self.frames, [low[0], high[1]], scale, self.seconds);
        svg += "</svg>\n";
        // Shapes around the view, in pixels from the lower left corner of the picture.
        let mut still =
            below::legend(&self.legend, full_width, total - TITLE_HEIGHT - LEGEND_HEIGHT / 2.0);
        still.extend(below.still(full_width, scale));
        element::write(
            &mut svg,
            &still,
            &below.frames(full_width),
            [0.0, total],
            1.0,
            self.seconds,
        );
        valid(svg + "</svg>\n")
    }
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
            ..Animation::default()
        }
    }

    #[test]
    fn only_attributes_that_change_are_animated() {
        let svg = moving_dot(&[0.0, 1.0, f64::NAN]).to_svg();
        let document = roxmltree::Document::parse(&svg).expect("an SVG is XML");
        let animated: Vec<_> =
            document.descendants().filter(|node| node.has_tag_name("animate")).collect();
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
        let curve =
            |y: f64| Shape::Curve { points: vec![[0.0, y], [1.0, 0.5]], width: 0.1, color: "red" };
        let raster = Raster::new(&[vec![0.0, 1.0]]);
        let mut animation = moving_dot(&[0.0, 1.0]);
        animation.still =
            vec![Shape::Image { center: [1.0, 0.5], size: [1.0, 0.5], raster }, curve(0.0)];
        for (frame, y) in animation.frames.iter_mut().zip([0.0, 1.0]) {
            frame.push(curve(y));
        }
        let svg = animation.to_svg();
        let document = roxmltree::Document::parse(&svg).expect("an SVG is XML");
        let all = |tag| {
            document.descendants().filter(move |node| node.has_tag_name(tag)).collect::<Vec<_>>()
        };
        let (image, curves) = (all("image"), all("polyline"));
        assert!(
            image[0]
                .attribute("href")
                .is_some_and(|href| href.starts_with("data:image/png;base64,"))
        );
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

    #[test]
    fn solids_exchange_their_places_at_once() {
        // Two discs move to the right; the second one overtakes the first one in the third frame.
        let disc = |id: usize, x: f64| Shape::Solid {
            id,
            points: vec![[x, 0.5]],
            width: 0.1,
            color: ["red", "green"][id].into(),
        };
        let mut animation = moving_dot(&[]);
        animation.frames = vec![
            vec![disc(0, 0.0), disc(1, 0.5)],
            vec![disc(0, 0.5), disc(1, 1.0)],
            vec![disc(1, 1.5), disc(0, 1.0)],
        ];
        let svg = animation.to_svg();
        let document = roxmltree::Document::parse(&svg).expect("an SVG is XML");
        let animated = |name: &str, what: &str| -> Vec<String> {
            document
                .descendants()
                .filter(|n| n.attribute("attributeName") == Some(name))
                .filter_map(|n| Some(n.attribute(what)?.to_owned()))
                .collect()
        };
        // 360 pixels per unit. The first place shows the first disc until it is at 1, then the other.
        let at = |x: i32| format!("{x},180 {x},180");
        let path = |xs: [i32; 4]| xs.map(at).join(";");
        let paths = [path([0, 360, 540, 540]), path([180, 540, 360, 360])];
        assert_eq!(animated("points", "values"), paths, "states in the middle are not needed");
        assert_eq!(animated("color", "values"), ["red;red;green;green", "green;green;red;red"]);
        for what in ["points", "color"] {
            assert_eq!(animated(what, "keyTimes"), ["0;0.7407;0.7407;1"; 2]);
        }
        assert!(animated("stroke-width", "values").is_empty(), "widths are constant");
    }

    #[test]
    fn paths_of_solids_are_exact_to_a_fraction_of_a_pixel() {
        let mut animation = moving_dot(&[]);
        let height = |frame: usize| (0.03 * frame as f64).sin();
        let disc = |frame: usize| {
            let points = vec![[1.0, height(frame)]];
            vec![Shape::Solid { id: 0, points, width: 0.1, color: "red".into() }]
        };
        animation.view = ([0.0, -1.0], [2.0, 1.0]);
        animation.frames = (0..61).map(disc).collect();
        let svg = animation.to_svg();
        let document = roxmltree::Document::parse(&svg).expect("an SVG is XML");
        let path = document.descendants().find(|n| n.has_tag_name("animate")).expect("it moves");
        let list = |name: &str| path.attribute(name).unwrap_or("").split(';').collect::<Vec<_>>();
        let share = 2.0 / (2.0 + HOLD) / 60.0;
        let frames: Vec<f64> = list("keyTimes").iter().flat_map(|t| t.parse()).collect();
        let frames: Vec<f64> = frames.iter().map(|time| (time / share).round()).collect();
        let number = |text: &str| text.split([' ', ',']).nth(1).and_then(|y| y.parse().ok());
        let values: Vec<f64> = list("values").into_iter().flat_map(number).collect();
        assert!(values.len() < 40 && values.len() == frames.len(), "{} states", values.len());
        for frame in 0..61 {
            let to = frames.iter().position(|&f| f > frame as f64).expect("the end");
            let share = (frame as f64 - frames[to - 1]) / (frames[to] - frames[to - 1]);
            let y = values[to - 1] + share * (values[to] - values[to - 1]);
            let exact = 240.0 * (1.0 - height(frame));
            assert!((y - exact).abs() < 0.21, "frame {frame}: {y}, not {exact}");
        }
    }

    #[test]
    fn a_solid_may_be_replaced_by_a_new_one() {
        let line = |id: usize, x: f64| {
            let points = vec![[x, 0.0], [x, 1.0]];
            vec![Shape::Solid { id, points, width: 0.1, color: "red".into() }]
        };
        let mut animation = moving_dot(&[]);
        animation.frames = vec![line(0, 0.5), line(1, 1.0)];
        let svg = animation.to_svg();
        let values = "values=\"180,360 180,0;180,360 180,0;360,360 360,0;360,360 360,0\"";
        assert!(
            svg.contains(values),
            "the line keeps its place, then the other one appears: {svg}"
        );
    }

    #[test]
    fn animations_that_share_a_scale_have_equal_views_and_ranges() {
        let channel = |values: &[f64]| Channel {
            name: "u".into(),
            values: values.to_vec(),
            color: "red",
            range: None,
        };
        let mut both = [moving_dot(&[0.0, 1.0]), moving_dot(&[0.0, 2.0])];
        both[1].view = ([-1.0, 0.5], [1.0, 3.0]);
        (both[0].channels, both[1].channels) =
            (vec![channel(&[0.0, 1.0])], vec![channel(&[-3.0, 0.5])]);
        Animation::share_scale(&mut both.each_mut());
        assert_eq!(both[0].view, ([-1.0, 0.0], [2.0, 3.0]));
        assert_eq!(
            (both[0].view, both[0].channels[0].range),
            (both[1].view, both[1].channels[0].range)
        );
        assert_eq!(both[0].channels[0].range(), [-3.0, 1.0]);
    }

    #[test]
    fn a_picture_has_legend_scale_channels_and_time_axis() {
        let mut animation = moving_dot(&[0.0, 1.0, 2.0]);
        animation.legend = vec![("target".into(), "green")];
        animation.unit = "m";
        animation.time = 2.0;
        animation.channels = vec![Channel {
            name: "force".into(),
            values: vec![-4.0, 0.0, 6.0],
            color: "red",
            range: None,
        }];
        let svg = animation.to_svg();
        let document = roxmltree::Document::parse(&svg).expect("an SVG is XML");
        let texts: Vec<&str> = document
            .descendants()
            .filter(|n| n.has_tag_name("text"))
            .filter_map(|n| n.text())
            .collect();
        // A scale of 0.2 units is about a tenth of the view.
        for text in ["target", "0.2 m", "force", "−4", "6", "time (s)", "0", "1", "2"] {
            assert!(texts.contains(&text), "{text} in {texts:?}");
        }
        let cursors = document
            .descendants()
            .filter(|n| n.has_tag_name("line") && n.children().count() > 0)
            .count();
        assert_eq!(cursors, 1, "the cursor moves");
    }
}

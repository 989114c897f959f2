//! Bumpers and wind of the cart-pole animation.

use super::{DARK, RAIL, Stage, arrow};
use crate::animation::Shape;
use crate::axes::number;

/// Half-width of the drawn cart, in pole lengths.
pub(super) const HALF_CART: f64 = 0.28;
/// Heights of the rail and of the upper edge of the cart relative to the joints, in pole lengths.
const HEIGHTS: [f64; 2] = [-0.2, 0.1];
/// Width of the post behind a spring, in pole lengths.
const POST: f64 = 0.07;
/// Minimum rest length of a spring, in pole lengths.
const SPRING: f64 = 0.2;
/// Length of the arrow for the strongest wind, in pole lengths.
const WIND: f64 = 0.5;

/// Surroundings of the cart in [`cart_pole_on`](super::cart_pole_on).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rail {
    /// Distance `|x|` at which the cart touches a bumper, m. The rail ends behind the bumpers.
    /// `None` and negative or non-finite distances stand for no bumpers.
    pub bumpers: Option<f64>,
    /// Wind speed along the rail at every state, m/s, positive towards positive x. Empty for no
    /// arrow. Non-finite speeds count as 0. States after the end of the list have the last speed.
    pub wind: Vec<f64>,
    /// The strongest force, N, if the motion is unfinished. Its pictures do not depend on later
    /// states: the view has a constant size, and the camera moves when the cart comes near an edge.
    /// The arrow of the force is relative to this one.
    pub unfinished: Option<f64>,
}

/// Two bumpers sized for a trajectory.
#[derive(Clone, Copy)]
pub(super) struct Bumpers {
    /// Distance `|x|` at contact, m.
    half_travel: f64,
    /// Rest length of a spring, m.
    spring: f64,
    /// Length of a pole, m.
    unit: f64,
}

impl Bumpers {
    /// Makes the springs longer than the deepest compression. Returns `None` if `half_travel` is
    /// negative or non-finite.
    pub fn new(half_travel: f64, states: &[&Vec<f64>], unit: f64) -> Option<Self> {
        let deepest = states.iter().map(|state| state[0].abs() - half_travel).fold(0.0, f64::max);
        let spring = (1.25 * deepest).max(SPRING * unit);
        (half_travel.is_finite() && half_travel >= 0.0).then_some(Self {
            half_travel,
            spring,
            unit,
        })
    }

    /// Distance of the end of the rail from the origin, m.
    pub fn end(&self) -> f64 {
        self.half_travel + self.spring + (HALF_CART + POST) * self.unit
    }

    /// Shapes of both bumpers for a cart at `x`, in coordinates relative to `camera`. Beyond the
    /// point of contact, the cart pushes a pad outward.
    pub fn shapes(&self, x: f64, camera: f64) -> Vec<Shape> {
        [-1.0, 1.0]
            .into_iter()
            .flat_map(|side| self.one(side, self.half_travel.max(side * x), camera))
            .collect()
    }

    fn one(&self, side: f64, pressed: f64, camera: f64) -> [Shape; 3] {
        let unit = self.unit;
        let (low, high) = (HEIGHTS[0] * unit, HEIGHTS[1] * unit);
        let at = |x: f64| side * x - camera;
        let plate = |x: f64, width: f64, color| Shape::Rect {
            center: [at(x), (low + high) / 2.0],
            size: [width, high - low],
            color,
        };
        let (pad, post) = (pressed + HALF_CART * unit, self.end() - POST * unit);
        let width = 0.03 * unit;
        let coil = post - pad - width;
        let tooth = |i: u8| {
            [
                at(pad + width + coil * f64::from(i) / 8.0),
                [0.0, 0.07, 0.0, -0.07][usize::from(i % 4)] * unit,
            ]
        };
        [
            Shape::Curve { points: (0..=8).map(tooth).collect(), width: 0.02 * unit, color: RAIL },
            plate(pad + width / 2.0, width, RAIL),
            plate(post + POST * unit / 2.0, POST * unit, DARK),
        ]
    }
}

/// Wind during an animation.
pub(super) struct Wind {
    /// Speed at every state, m/s, with 0 in place of non-finite values.
    speeds: Vec<f64>,
    strongest: f64,
    /// True if the wind ever blows towards negative x.
    back: bool,
}

impl Wind {
    pub fn new(speeds: &[f64]) -> Option<Self> {
        let speeds: Vec<f64> =
            speeds.iter().map(|speed| if speed.is_finite() { *speed } else { 0.0 }).collect();
        let strongest = speeds.iter().map(|speed| speed.abs()).fold(0.0, f64::max);
        let back = speeds.iter().any(|speed| *speed < 0.0);
        (!speeds.is_empty()).then_some(Self { speeds, strongest, back })
    }

    /// Labelled arrow in the upper left corner. The length is proportional to the wind speed at a
    /// step. The label states the largest magnitude of the speeds, or the absence of wind.
    pub fn shapes(&self, stage: &Stage, step: usize) -> Vec<Shape> {
        let (unit, size) = (stage.length, 0.12 * stage.length);
        let longest = WIND * unit;
        let from = [
            stage.low[0] + 0.15 * unit + if self.back { longest } else { 0.0 },
            stage.high[1] - 0.12 * unit,
        ];
        let speed = self.speeds.get(step).or(self.speeds.last()).copied().unwrap_or(0.0);
        let length = if self.strongest > 0.0 { longest * speed / self.strongest } else { 0.0 };
        let steady = self.speeds.iter().all(|speed| *speed == self.speeds[0]);
        let text = match (self.strongest > 0.0, steady) {
            (false, _) => "no wind".into(),
            (true, true) => format!("wind, {} m/s", number(self.strongest)),
            (true, false) => format!("wind, up to {} m/s", number(self.strongest)),
        };
        // Texts are centered; letters are about 0.6 of the font size wide.
        let middle = from[0] + longest + 0.1 * unit + 0.3 * size * text.chars().count() as f64;
        let mut shapes = vec![Shape::Line {
            from: [from[0], from[1] - 0.05 * unit],
            to: [from[0], from[1] + 0.05 * unit],
            width: 0.015 * unit,
            color: RAIL,
        }];
        shapes.extend(arrow(from, length, 0.02 * unit, RAIL));
        shapes.push(Shape::Text { at: [middle, from[1] - 0.042 * unit], size, text, color: RAIL });
        shapes
    }
}

#[cfg(test)]
mod tests {
    use super::super::{CART, cart_pole, cart_pole_on};
    use super::*;
    use crate::Animation;

    fn animation(rail: &Rail, xs: &[f64]) -> Animation {
        let states: Vec<Vec<f64>> = xs.iter().map(|x| vec![*x, 0.0, 0.1, 0.0]).collect();
        cart_pole_on(rail, &states, &[1.0], 0.5, 0.02)
    }

    /// Left and right edges of the rectangles of a colour and height.
    fn plates(animation: &Animation, frame: usize, of: &str, height: f64) -> Vec<[f64; 2]> {
        let edges = |shape: &Shape| match shape {
            Shape::Rect { center, size, color }
                if *color == of && (size[1] - height).abs() < 1e-9 =>
            {
                Some([center[0] - size[0] / 2.0, center[0] + size[0] / 2.0])
            }
            _ => None,
        };
        animation.frames[frame].iter().filter_map(edges).collect()
    }

    fn same(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-9
    }

    #[test]
    fn an_empty_rail_does_not_change_the_animation() {
        let states: Vec<Vec<f64>> =
            (0..50).map(f64::from).map(|t| vec![t * 0.1, 5.0, t, 1.0, -t, 1.0]).collect();
        let forces: Vec<f64> = (0..50).map(|t| f64::from(t).sin()).collect();
        let bare = cart_pole(&states, &forces, 0.5, 0.02).to_svg();
        assert!(cart_pole_on(&Rail::default(), &states, &forces, 0.5, 0.02).to_svg() == bare);
    }

    #[test]
    fn a_cart_at_or_beyond_a_bumper_touches_its_pad() {
        let animation =
            animation(&Rail { bumpers: Some(2.0), ..Rail::default() }, &[1.0, 2.0, 2.3]);
        let right = |frame: usize| {
            (plates(&animation, frame, CART, 0.2)[0][1], plates(&animation, frame, RAIL, 0.3)[1][0])
        };
        assert!(right(0).0 < right(0).1);
        assert!(same(right(1).0, right(1).1) && same(right(2).0, right(2).1), "{:?}", right(2));
        let post = plates(&animation, 2, DARK, 0.3)[1];
        assert!(right(2).1 + 0.03 < post[0], "a compressed spring keeps a positive length");
        assert!(
            animation.view.1[0] > post[1] && animation.view.0[0] < -post[1],
            "the view contains both posts"
        );
    }

    #[test]
    fn the_arrow_length_is_proportional_to_the_wind_speed() {
        let rail = Rail { wind: vec![4.0, -2.0, f64::NAN], ..Rail::default() };
        let windy = animation(&rail, &[0.0; 3]);
        let lengths: Vec<f64> = windy
            .frames
            .iter()
            .filter_map(|shapes| {
                shapes.iter().find_map(|shape| match shape {
                    Shape::Line { from, to, color, .. }
                        if *color == RAIL && from[1] > 1.0 && from[1] == to[1] =>
                    {
                        Some(to[0] - from[0])
                    }
                    _ => None,
                })
            })
            .collect();
        assert!(
            same(lengths[0], 0.5) && same(lengths[1], -0.25) && same(lengths[2], 0.0),
            "{lengths:?}"
        );
        let svg = windy.to_svg();
        assert!(svg.contains("wind, up to 4 m/s") && !svg.contains("NaN"));
        let words = |speed: f64| {
            animation(&Rail { wind: vec![speed; 3], ..Rail::default() }, &[0.0; 3]).to_svg()
        };
        assert!(words(-3.0).contains("wind, 3 m/s") && words(0.0).contains("no wind"));
    }

    #[test]
    fn extreme_and_non_finite_numbers_give_a_picture() {
        for bumpers in [f64::NAN, f64::INFINITY, -1.0, 0.0, 1e-3, 1e9] {
            for wind in [vec![], vec![0.0], vec![f64::INFINITY]] {
                let rail = Rail { bumpers: Some(bumpers), wind, ..Rail::default() };
                for xs in [&[][..], &[0.3, 1.0], &[0.0, 20.0, -500.0]] {
                    let svg = animation(&rail, xs).to_svg();
                    roxmltree::Document::parse(&svg).expect("an SVG is XML");
                    assert!(!svg.contains("NaN") && !svg.contains("inf"));
                }
            }
        }
    }
}

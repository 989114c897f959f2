//! Potential and absorbing edges of the quantum animation.

use super::{Layout, MAX_ROWS, averaged};
use crate::animation::Shape;
use crate::axes::{Axes, text, ticks};

const POTENTIAL: &str = "#9AA0A8";
const BELOW: &str = "#ECEEF1";
/// Colour of the absorbing edges: translucent, because they also cover the density map.
const ABSORBING: &str = "rgba(86,180,233,0.3)";

/// Potential and absorbing edges that [`quantum_in`](super::quantum_in) draws.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Landscape {
    /// Static potential at the grid points. Empty for none.
    pub potential: Vec<f64>,
    /// Width of the absorbing edge at each of the two walls, in units of length. `None` for no
    /// edges.
    pub absorbing: Option<f64>,
    /// Number of steps of the whole motion, if it is unfinished: the axes of time show them all. 0
    /// for a finished motion.
    pub steps: usize,
}

impl Landscape {
    /// Drawable part for a box of the given length: averaged potential and clamped edges. Omits a
    /// potential that contains a non-finite value, and edges of negative or NaN width.
    pub(super) fn drawn(&self, length: f64) -> Self {
        let finite = self.potential.iter().all(|v| v.is_finite());
        let potential = if finite { averaged(&self.potential, MAX_ROWS) } else { Vec::new() };
        let absorbing =
            self.absorbing.filter(|width| *width >= 0.0).map(|width| width.min(length / 2.0));
        Self { potential, absorbing, steps: self.steps }
    }

    /// True if there is a potential.
    pub(super) fn tilted(&self) -> bool {
        !self.potential.is_empty()
    }

    /// Potential in the density panel, with a separate scale along the upper edge.
    pub(super) fn floor(&self, profile: &Axes) -> Vec<Shape> {
        if !self.tilted() {
            return Vec::new();
        }
        let (low, high) = self
            .potential
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &v| (l.min(v), h.max(v)));
        let room = if (high - low).is_normal() { 0.04 * (high - low) } else { 1.0 };
        let Axes { left, right, bottom, top, y, .. } = *profile;
        let panel = Axes { left, right, bottom, top, x: [low - room, high + room], y };
        let row = y[1] / (self.potential.len() + 1) as f64;
        let position = |i: usize| row * (i + 1) as f64;
        let bar = |(i, &v): (usize, &f64)| {
            let (center, size) =
                panel.area([panel.x[0], position(i) - 0.5 * row], [v, position(i) + 0.5 * row]);
            // Overlaps the next bar, so that no gap shows.
            Shape::Rect { center, size: [size[0], size[1] + 0.6], color: BELOW }
        };
        let mut shapes: Vec<Shape> = self.potential.iter().enumerate().map(bar).collect();
        shapes.push(panel.curve(
            self.potential.iter().enumerate().map(|(i, &v)| [v, position(i)]),
            2.0,
            POTENTIAL,
        ));
        shapes.extend(panel.ticks_above(&ticks(panel.x[0], panel.x[1], 3.0)));
        shapes
    }

    /// Shaded absorbing edges in the given panels.
    pub(super) fn edges(&self, panels: &[&Axes]) -> Vec<Shape> {
        let strip = |panel: &Axes, width: f64, side: bool| {
            let (from, to) = if side { (panel.y[1] - width, panel.y[1]) } else { (0.0, width) };
            let (center, size) = panel.area([panel.x[0], from], [panel.x[1], to]);
            Shape::Rect { center, size, color: ABSORBING }
        };
        let both = |width: f64| {
            panels.iter().flat_map(move |panel| [false, true].map(|side| strip(panel, width, side)))
        };
        self.absorbing.into_iter().flat_map(both).collect()
    }

    /// Legend of potential and edges. With edges, the legend states the probability that remains at
    /// the end.
    pub(super) fn legend(&self, layout: &Layout) -> Vec<Shape> {
        let x = layout.profile.left + 14.0;
        // Texts are centered; letters are about 0.55 of the font size wide.
        let name =
            |y: f64, words: &str| text([x + 20.0 + 3.3 * words.chars().count() as f64, y], words);
        let mut shapes = Vec::new();
        if self.tilted() {
            shapes.push(Shape::Line {
                from: [x - 13.0, 124.0],
                to: [x + 13.0, 124.0],
                width: 2.0,
                color: POTENTIAL,
            });
            shapes.push(name(120.0, "V, scale above"));
        }
        if self.absorbing.is_some() {
            shapes.push(Shape::Rect { center: [x, 106.0], size: [28.0, 10.0], color: ABSORBING });
            shapes.push(name(102.0, "absorbing edge"));
            let middle = (layout.profile.left + layout.profile.right) / 2.0;
            shapes.push(text([middle, 48.0], format!("{:.3} not absorbed", layout.norm)));
        }
        shapes
    }
}

#[cfg(test)]
mod tests {
    use super::super::{quantum, quantum_in};
    use super::*;

    fn states() -> Vec<Vec<f64>> {
        (0..20)
            .map(f64::from)
            .map(|t| (0..14).map(|i| (0.1 * t + f64::from(i)).sin() / 3.0).collect())
            .collect()
    }

    #[test]
    fn an_unfinished_motion_has_the_axes_of_the_whole() {
        let whole = quantum(&states(), &[1.0; 19], &[0.3; 7], 2.0, 0.1);
        let landscape = Landscape { steps: 19, ..Landscape::default() };
        let part = quantum_in(&landscape, &states()[..8], &[1.0; 7], &[0.3; 7], 2.0, 0.1);
        // The cursor, which has the place of its time.
        let cursor = |shape: &Shape| match shape {
            Shape::Line { from, to, .. } if from[0] == to[0] => Some(from[0]),
            _ => None,
        };
        for (whole, part) in whole.frames.iter().zip(&part.frames) {
            let places = [whole, part].map(|frame| frame.iter().find_map(cursor));
            assert_eq!(places[0], places[1]);
            assert!(places[0].is_some());
        }
        let width = |animation: &crate::Animation| {
            let mut images = animation.still.iter().filter_map(|shape| match shape {
                Shape::Image { size, .. } => Some(size[0]),
                _ => None,
            });
            images.next_back().expect("the map of the density")
        };
        assert!((width(&part) / width(&whole) - 8.0 / 20.0).abs() < 1e-9);
    }

    #[test]
    fn an_empty_landscape_does_not_change_the_animation() {
        let bare = quantum(&states(), &[1.0; 19], &[0.3; 7], 2.0, 0.1).to_svg();
        assert!(
            quantum_in(&Landscape::default(), &states(), &[1.0; 19], &[0.3; 7], 2.0, 0.1).to_svg()
                == bare
        );
    }

    #[test]
    fn the_curve_is_at_the_values_of_the_potential() {
        let landscape = Landscape { potential: vec![50.0, 0.0, 25.0], ..Landscape::default() };
        let animation = quantum_in(&landscape, &[vec![0.5; 6]], &[], &[0.5; 3], 2.0, 0.1);
        let curve = animation.still.iter().find_map(|shape| match shape {
            Shape::Curve { points, color, .. } if *color == POTENTIAL => Some(points.clone()),
            _ => None,
        });
        let curve = curve.expect("a curve");
        let share = |i: usize| (curve[i][0] - 548.0) / 156.0;
        assert!(
            (share(0) - 52.0 / 54.0).abs() < 1e-9 && (share(1) - 2.0 / 54.0).abs() < 1e-9,
            "{curve:?}"
        );
        assert!((share(2) - 0.5).abs() < 1e-9 && (curve[1][1] - 344.0).abs() < 1e-9, "{curve:?}");
        assert!(animation.title.contains("of the empty box"));
    }

    #[test]
    fn absorbing_edges_are_drawn_and_the_remaining_probability_is_labelled() {
        let landscape = Landscape { absorbing: Some(0.5), ..Landscape::default() };
        let animation = quantum_in(
            &landscape,
            &[vec![0.0, 1.0, 0.0, 0.0], vec![0.5, 0.0, 0.0, 0.5]],
            &[1.0],
            &[1.0, 0.0],
            2.0,
            0.1,
        );
        let strips: Vec<_> = animation
            .still
            .iter()
            .filter_map(|shape| match shape {
                Shape::Rect { size, color, .. } if *color == ABSORBING && size[0] > 30.0 => {
                    Some(*size)
                }
                _ => None,
            })
            .collect();
        assert_eq!(strips, [[430.0, 54.0], [430.0, 54.0], [156.0, 54.0], [156.0, 54.0]]);
        assert!(animation.to_svg().contains("0.500 not absorbed"));
    }

    #[test]
    fn extreme_and_non_finite_numbers_give_a_picture() {
        for wild in [f64::NAN, f64::INFINITY, -1e300, -1.0, 0.0, 1e300] {
            for potential in [vec![wild], vec![wild; 7], vec![1e300, wild, 2.0]] {
                let landscape =
                    Landscape { potential, absorbing: Some(wild), ..Landscape::default() };
                for states in [vec![], states()] {
                    let svg = quantum_in(&landscape, &states, &[], &[0.3; 7], 2.0, 0.1).to_svg();
                    roxmltree::Document::parse(&svg).expect("an SVG is XML");
                    assert!(
                        !svg.contains("NaN") && !svg.contains("inf<") && !svg.contains("inf\"")
                    );
                }
            }
        }
    }
}

//! Obstacles and walls of the guidance animation.

use super::Layout;
use crate::animation::Shape;

const OBSTACLE: &str = "#C9CED6";
const WALL: &str = "#9AA0A8";

/// Surroundings of the agents in [`guidance_in`](super::guidance_in).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Field {
    /// Center and radius of every round obstacle, m.
    pub obstacles: Vec<([f64; 2], f64)>,
    /// Half-width and half-height of a walled rectangle centered at the origin, m.
    pub walls: Option<[f64; 2]>,
}

impl Field {
    /// Copy that omits obstacles and walls with non-finite numbers, and walls of non-positive size.
    pub(super) fn finite(&self) -> Self {
        let is_finite = |(center, radius): &&([f64; 2], f64)| {
            center.iter().all(|c| c.is_finite()) && radius.is_finite()
        };
        let walls =
            self.walls.filter(|walls| walls.iter().all(|half| half.is_finite() && *half > 0.0));
        Self { obstacles: self.obstacles.iter().filter(is_finite).copied().collect(), walls }
    }

    /// Lower left and upper right corners of the bounding boxes of obstacles and walls. Omits a box
    /// if the magnitude of a corner coordinate exceeds `limit`.
    pub(super) fn corners(&self, limit: f64) -> Vec<[f64; 2]> {
        let ends = |([x, y], [w, h]): ([f64; 2], [f64; 2])| [[x - w, y - h], [x + w, y + h]];
        let obstacles = self.obstacles.iter().map(|&(center, radius)| (center, [radius; 2]));
        let walls = self.walls.map(|halves| ([0.0; 2], halves));
        let near = |corners: &[[f64; 2]; 2]| corners.iter().flatten().all(|c| c.abs() <= limit);
        obstacles.chain(walls).map(ends).filter(near).flatten().collect()
    }

    /// Shapes of walls and obstacles.
    pub(super) fn shapes(&self, layout: &Layout) -> Vec<Shape> {
        let thin = 0.006 * layout.unit();
        let disc = |&(center, radius): &([f64; 2], f64)| {
            [(radius, WALL), (radius - thin, OBSTACLE)].map(|(radius, color)| Shape::Circle {
                center,
                radius,
                color,
            })
        };
        let fence = |[w, h]: [f64; 2]| Shape::Curve {
            points: vec![[-w, -h], [w, -h], [w, h], [-w, h], [-w, -h]],
            width: thin,
            color: WALL,
        };
        self.walls.map(fence).into_iter().chain(self.obstacles.iter().flat_map(disc)).collect()
    }

    /// Labels and colours for the legend.
    pub(super) fn legend(&self) -> Vec<(&'static str, &'static str)> {
        let obstacles = (!self.obstacles.is_empty()).then_some(("obstacles", OBSTACLE));
        obstacles.into_iter().chain(self.walls.map(|_| ("walls", WALL))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{guidance, guidance_in};
    use super::*;

    fn trajectory() -> Vec<Vec<f64>> {
        (0..30)
            .map(f64::from)
            .map(|t| vec![3.0 - t * 0.1, 1.0, -1.0, 0.0, 0.1 * t, 0.5, 1.0, 0.0])
            .collect()
    }

    #[test]
    fn an_empty_field_does_not_change_the_animation() {
        let bare = guidance(&trajectory(), 1, 0.1).to_svg();
        assert!(guidance_in(&Field::default(), &trajectory(), 1, 0.1).to_svg() == bare);
    }

    #[test]
    fn obstacles_and_walls_are_drawn_at_their_positions() {
        let field = Field { obstacles: vec![([1.0, -3.0], 0.4)], walls: Some([5.0, 4.5]) };
        let animation = guidance_in(&field, &trajectory(), 1, 0.1);
        let is = |shape: &Shape| matches!(shape, Shape::Circle { center: [1.0, -3.0], radius, .. } if *radius == 0.4);
        assert!(animation.still.iter().any(is));
        let fence =
            |shape: &Shape| matches!(shape, Shape::Curve { points, .. } if points[2] == [5.0, 4.5]);
        assert!(animation.still.iter().any(fence));
        let (low, high) = animation.view;
        assert!(low[0] < -5.0 && low[1] < -4.5 && high[0] > 5.0 && high[1] > 4.5);
        let svg = animation.to_svg();
        assert!(svg.contains(">obstacles<") && svg.contains(">walls<"));
    }

    #[test]
    fn walls_at_1_km_do_not_widen_the_view() {
        let animation = guidance_in(
            &Field { obstacles: vec![], walls: Some([1e3, 1e3]) },
            &trajectory(),
            1,
            0.1,
        );
        assert!(animation.view.1[0] < 20.0);
    }

    #[test]
    fn extreme_and_non_finite_numbers_give_a_picture() {
        for wild in [f64::NAN, f64::INFINITY, -1.0, 0.0, 1e300] {
            let field = Field {
                obstacles: vec![([wild, 0.0], 0.4), ([0.0; 2], wild)],
                walls: Some([wild, 1.0]),
            };
            for states in [vec![], vec![vec![0.0; 4]], trajectory()] {
                let svg = guidance_in(&field, &states, 1, 0.1).to_svg();
                roxmltree::Document::parse(&svg).expect("an SVG is XML");
                assert!(!svg.contains("NaN") && !svg.contains("inf"));
            }
        }
    }
}

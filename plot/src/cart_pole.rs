//! Animation of a cart with one or more poles on a rail.

mod rail;

pub use rail::Rail;

use super::animation::{Animation, Shape};
use super::axes::round_up;
use rail::{Bumpers, HALF_CART, Wind};

/// Colours of the poles in turn, from a colour-blind safe palette.
const POLES: [&str; 5] = ["#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9"];
const FORCE: &str = "#D55E00";
const CART: &str = "#C9CED6";
const DARK: &str = "#4A4F57";
const RAIL: &str = "#9AA0A8";

/// Largest number of frames. Longer trajectories are thinned; motion between frames is linear.
const MAX_FRAMES: usize = 250;
/// Distance of the cart from the origin at which a trajectory counts as diverged, m.
const FAR: f64 = 1e6;

/// Width of an unlimited rail beyond each side of the view, in widths of the view.
const RAIL_BEYOND: f64 = 20.0;
/// Longest rail that is shown whole, in pole lengths.
const WHOLE: f64 = 10.0;
/// Half-width of the view of an unfinished motion, in pole lengths.
const UNFINISHED: f64 = 3.0;
/// Least distance of the cart from the edge of this view, in pole lengths. A lying pole fits.
const EDGE: f64 = 1.15;

/// Animates a trajectory on a bare rail.
///
/// A state is `[x, ẋ, θ, θ̇, …]` with angle and angular velocity of every pole; angle 0 is upright.
/// States are `dt` seconds apart. `controls` holds the force of each step. `half_length` is half
/// the length of a pole, in m. The arrow on the cart shows the force, relative to the largest force
/// of the trajectory.
///
/// Trajectories shorter than 2 s play at one third of real time. The camera follows a cart whose
/// positions span more than 6 pole lengths. The animation ends before the first state that is
/// non-finite or at least 1e6 m from the origin. It also ends before the first state with another
/// number of components than the initial state.
pub fn cart_pole(states: &[Vec<f64>], controls: &[f64], half_length: f64, dt: f64) -> Animation {
    cart_pole_on(&Rail::default(), states, controls, half_length, dt)
}

/// Animates a trajectory as [`cart_pole`] does, with bumpers and wind.
///
/// Bumpers are springs at the ends of the rail. The view shows the whole rail, unless it is longer
/// than 10 pole lengths. An arrow in the upper left corner shows the wind.
pub fn cart_pole_on(
    rail: &Rail,
    states: &[Vec<f64>],
    controls: &[f64],
    half_length: f64,
    dt: f64,
) -> Animation {
    let length = if half_length.is_normal() && half_length > 0.0 { 2.0 * half_length } else { 1.0 };
    let width = states.first().map_or(0, Vec::len).max(2);
    let valid =
        |s: &&Vec<f64>| s.len() == width && s[0].abs() < FAR && s.iter().all(|v| v.is_finite());
    let states: Vec<&Vec<f64>> = states.iter().take_while(valid).collect();
    let time = states.len().saturating_sub(1) as f64 * dt;
    let slowness = if time < 2.0 { 3.0 } else { 1.0 };
    let speed = if time < 2.0 { "at ⅓ speed" } else { "in real time" };
    let poles = (width - 2) / 2;
    let title = match poles {
        1 => format!("Cart with 1 pole: {time:.1} s {speed}"),
        _ => format!("Cart with {poles} poles: {time:.1} s {speed}"),
    };
    let bumpers = rail.bumpers.and_then(|half_travel| Bumpers::new(half_travel, &states, length));
    let wind = Wind::new(&rail.wind);
    let unfinished = rail.unfinished.is_some();
    let stage = Stage::covering(&states, length, bumpers, wind.is_some(), unfinished);
    let shown = states.len().min(MAX_FRAMES);
    let largest = rail.unfinished.unwrap_or_else(|| largest(controls));
    let frames = (0..shown).map(|frame| {
        let step = frame * (states.len() - 1) / (shown - 1).max(1);
        let force = relative_force(controls, largest, step);
        let mut shapes = stage.frame(states[step], stage.cameras[step], force);
        shapes.extend(wind.iter().flat_map(|wind| wind.shapes(&stage, step)));
        shapes
    });
    let (seconds, view) = (time * slowness, (stage.low, stage.high));
    let legend = vec![("force".to_owned(), FORCE)];
    Animation {
        title,
        seconds,
        view,
        frames: frames.collect(),
        legend,
        time,
        ..Animation::default()
    }
}

/// Largest absolute value of the finite forces.
fn largest(forces: &[f64]) -> f64 {
    forces.iter().map(|force| force.abs()).filter(|force| force.is_finite()).fold(0.0, f64::max)
}

/// Force at a step, relative to the largest force. The last state has the force of the last step.
fn relative_force(controls: &[f64], largest: f64, step: usize) -> f64 {
    match controls.get(step.min(controls.len().saturating_sub(1))) {
        Some(force) if force.is_finite() && largest > 0.0 => (force / largest).clamp(-1.0, 1.0),
        _ => 0.0,
    }
}

/// Motion of the camera.
enum Camera {
    /// Rests at the origin.
    Fixed,
    /// Is at the cart.
    Follows,
    /// Moves as little as the cart allows, which keeps its distance from the edge.
    Pans,
}

impl Camera {
    /// Position at every state, m. It depends on this state and those before.
    fn positions(&self, states: &[&Vec<f64>], length: f64) -> Vec<f64> {
        let (mut pan, slack) = (0.0_f64, (UNFINISHED - EDGE) * length);
        let position = |state: &&Vec<f64>| match self {
            Self::Fixed => 0.0,
            Self::Follows => state[0],
            Self::Pans => {
                pan = pan.clamp(state[0] - slack, state[0] + slack);
                pan
            }
        };
        states.iter().map(position).collect()
    }
}

/// Data shared by all frames: view, rail marks and bumpers.
struct Stage {
    /// Length of a pole, m.
    length: f64,
    /// Lower left corner of the view, m.
    low: [f64; 2],
    /// Upper right corner of the view, m.
    high: [f64; 2],
    /// Position of the camera at every state, m.
    cameras: Vec<f64>,
    /// Positions of the rail marks, m.
    marks: Vec<f64>,
    bumpers: Option<Bumpers>,
}

impl Stage {
    /// Creates a stage that shows the whole trajectory, or a stage whose camera follows the cart.
    fn covering(
        states: &[&Vec<f64>],
        length: f64,
        bumpers: Option<Bumpers>,
        windy: bool,
        unfinished: bool,
    ) -> Self {
        let (mut left, mut right) = (f64::INFINITY, f64::NEG_INFINITY);
        for state in states {
            (left, right) = (left.min(state[0]), right.max(state[0]));
        }
        if states.is_empty() {
            (left, right) = (0.0, 0.0);
        }
        let end = bumpers.map_or(f64::INFINITY, |bumpers| bumpers.end());
        let whole = 2.0 * end <= WHOLE * length;
        if whole {
            // Bounds for which the view ends at least 0.3 pole lengths beyond the rail.
            let cart = end - 0.85 * length;
            (left, right) = (left.min(-cart), right.max(cart));
        }
        let camera = match (whole, unfinished) {
            (false, true) => Camera::Pans,
            (false, false) if right - left > 6.0 * length => Camera::Follows,
            _ => Camera::Fixed,
        };
        let cameras = camera.positions(states, length);
        if let (Camera::Pans, Some(&last)) = (&camera, cameras.last()) {
            (left, right) = (last, last);
        }
        let (middle, half_width) = match camera {
            Camera::Fixed => {
                let half = (right - left) / 2.0 + EDGE * length;
                ((left + right) / 2.0, half.max(2.2 * length))
            }
            Camera::Follows => (0.0, 2.5 * length),
            Camera::Pans => (0.0, UNFINISHED * length),
        };
        let lowest = states
            .iter()
            .flat_map(|state| state[2..].iter().step_by(2))
            .map(|angle| angle.cos())
            .fold(if unfinished { -1.0 } else { 0.0 }, f64::min);
        // Space below the rail for its marks, and for poles that hang down.
        let bottom = length * (lowest * 1.1).min(-0.45) - 0.2 * length;
        // Marks over the range of the camera, at round distances of at least one pole length and at
        // most 21 in number. A fixed camera omits marks whose labels would be clipped.
        let extent = match camera {
            Camera::Follows => (right - left) / 2.0 + half_width,
            _ => half_width - 0.3 * length,
        };
        let (from, to) = ((left + right) / 2.0 - extent, (left + right) / 2.0 + extent);
        let step = round_up(length.max((to - from) / 20.0));
        let marks =
            ((from / step).ceil() as i64..=(to / step).floor() as i64).map(|i| i as f64 * step);
        let marks = marks.filter(|mark| mark.abs() <= end).collect();
        let top = if windy { 1.35 } else { 1.2 } * length;
        Self {
            length,
            low: [middle - half_width, bottom],
            high: [middle + half_width, top],
            cameras,
            marks,
            bumpers,
        }
    }

    fn frame(&self, state: &[f64], camera: f64, force: f64) -> Vec<Shape> {
        let unit = self.length;
        let x = state[0] - camera;
        let mut shapes = self.rail(camera);
        shapes.extend(self.bumpers.iter().flat_map(|bumpers| bumpers.shapes(state[0], camera)));
        for side in [-1.0, 1.0] {
            shapes.push(Shape::Circle {
                center: [x + side * 0.16 * unit, -0.12 * unit],
                radius: 0.06 * unit,
                color: DARK,
            });
        }
        shapes.push(Shape::Rect {
            center: [x, 0.0],
            size: [2.0 * HALF_CART * unit, 0.2 * unit],
            color: CART,
        });
        shapes.extend(arrow([x, 0.0], force * unit, 0.03 * unit, FORCE));
        for (angle, color) in state[2..].iter().step_by(2).zip(POLES.iter().cycle()) {
            let tip = [x + unit * angle.sin(), unit * angle.cos()];
            shapes.push(Shape::Line { from: [x, 0.0], to: tip, width: 0.045 * unit, color });
            shapes.push(Shape::Circle { center: tip, radius: 0.05 * unit, color });
        }
        shapes.push(Shape::Circle { center: [x, 0.0], radius: 0.04 * unit, color: DARK });
        shapes
    }

    /// Rail and marks, shifted by the camera position.
    fn rail(&self, camera: f64) -> Vec<Shape> {
        let (unit, y) = (self.length, -0.2 * self.length);
        let end = self.bumpers.map_or(f64::INFINITY, |bumpers| bumpers.end());
        // Extends beyond the view, which `Animation::share_scale` may enlarge.
        let beyond = RAIL_BEYOND * (self.high[0] - self.low[0]);
        let (left, right) =
            ((self.low[0] - beyond).max(-end - camera), (self.high[0] + beyond).min(end - camera));
        let mut shapes =
            vec![Shape::Line { from: [left, y], to: [right, y], width: 0.02 * unit, color: RAIL }];
        for &mark in &self.marks {
            let x = mark - camera;
            shapes.push(Shape::Rect {
                center: [x, y - 0.04 * unit],
                size: [0.015 * unit, 0.08 * unit],
                color: RAIL,
            });
            let text = format!("{} m", (mark * 1e6).round() / 1e6).replace('-', "−");
            shapes.push(Shape::Text {
                at: [x, y - 0.2 * unit],
                size: 0.1 * unit,
                text,
                color: RAIL,
            });
        }
        shapes
    }
}

/// Horizontal arrow. The head shrinks with `length`, so the arrow is continuous at 0.
fn arrow(from: [f64; 2], length: f64, width: f64, color: &'static str) -> [Shape; 3] {
    let tip = [from[0] + length, from[1]];
    let head = length.signum() * length.abs().min(4.0 * width);
    let line = |from, to| Shape::Line { from, to, width, color };
    [
        line(from, tip),
        line([tip[0] - head, tip[1] + 0.6 * head], tip),
        line([tip[0] - head, tip[1] - 0.6 * head], tip),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trajectory(speed: f64) -> Vec<Vec<f64>> {
        (0..100)
            .map(|i| f64::from(i) * 0.01)
            .map(|t| vec![speed * t, speed, 3.0 * t, 3.0, -t, -1.0])
            .collect()
    }

    #[test]
    fn pole_points_up_at_angle_zero() {
        let animation = cart_pole(&[vec![0.3, 0.0, 0.0, 0.0]], &[], 0.5, 0.02);
        let tip = animation.frames[0].iter().find_map(|shape| match shape {
            Shape::Line { to, color, .. } if *color == POLES[0] => Some(*to),
            _ => None,
        });
        assert_eq!(tip, Some([0.3, 1.0]));
    }

    #[test]
    fn animation_ends_before_a_non_finite_state() {
        let mut states = trajectory(1.0);
        states[40][2] = f64::NAN;
        let animation = cart_pole(&states, &vec![1.0; 100], 0.5, 0.01);
        assert_eq!(animation.frames.len(), 40);
        assert!((animation.seconds - 3.0 * 0.39).abs() < 1e-9 && animation.title.contains("⅓"));
        let svg = animation.to_svg();
        roxmltree::Document::parse(&svg).expect("an SVG is XML");
        assert!(!svg.contains("NaN") && !svg.contains("inf\""));
    }

    #[test]
    fn camera_follows_a_cart_that_travels_30_m() {
        let animation = cart_pole(&trajectory(30.0), &[2.0, -2.0], 0.5, 0.01);
        assert!(animation.view.1[0] - animation.view.0[0] < 6.0);
        let svg = animation.to_svg();
        assert!(svg.len() < 200_000, "{} bytes", svg.len());
    }

    #[test]
    fn pictures_of_an_unfinished_motion_do_not_depend_on_later_states() {
        let rail = Rail { unfinished: Some(2.0), ..Rail::default() };
        let (states, forces) = (trajectory(30.0), vec![1.0; 99]);
        let mut before: Option<[f64; 2]> = None;
        for count in 1..=states.len() {
            let part = cart_pole_on(&rail, &states[..count], &forces[..count - 1], 0.5, 0.01);
            assert_eq!(part.view, ([-3.0, -1.3], [3.0, 1.2]));
            let cart = |shape: &Shape| match shape {
                Shape::Rect { center, color, .. } if *color == CART => Some(*center),
                _ => None,
            };
            let places: Vec<[f64; 2]> =
                part.frames.iter().filter_map(|frame| frame.iter().find_map(cart)).collect();
            // The frame of a state stays the same, and the cart moves 0.3 m at most.
            assert!(
                before.is_none() || places[count - 2..count - 1] == [before.unwrap_or_default()]
            );
            let last = places[count - 1];
            assert!(before.is_none_or(|before| (last[0] - before[0]).abs() < 0.3 + 1e-9));
            assert!(last[0].abs() <= 1.85 + 1e-9);
            before = Some(last);
        }
    }

    #[test]
    fn empty_and_invalid_inputs_give_a_picture() {
        for states in [vec![], vec![vec![]], vec![vec![f64::NAN; 4]], vec![vec![0.0]]] {
            roxmltree::Document::parse(&cart_pole(&states, &[], 0.5, 0.02).to_svg())
                .expect("an SVG is XML");
        }
    }
}

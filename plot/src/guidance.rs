//! Animation of drivers that herd evaders to a target.

mod field;

pub use field::Field;

use super::animation::{Animation, Shape};

const DRIVER: &str = "#D55E00";
const DRIVER_TRAIL: &str = "#F2C6A5";
const EVADER: &str = "#0072B2";
const EVADER_TRAIL: &str = "#A9CDE6";
const TARGET: &str = "#009E73";
const TARGET_AREA: &str = "#DDF1EA";

/// Largest number of frames. Longer trajectories are thinned; motion between frames is linear.
const MAX_FRAMES: usize = 120;
/// Largest number of trail segments of all agents together, but every agent has at least one.
const ALL_PIECES: usize = 120;
/// Largest number of trail segments per agent.
const MAX_PIECES: usize = 8;
/// Duration of a trail, as a share of the animation.
const TRAIL: f64 = 0.25;
/// Absolute value of a coordinate from which an agent counts as diverged, m.
const FAR: f64 = 1e6;
/// Limit of the positions that the view includes, relative to the largest initial coordinate. This
/// coordinate counts as at least 0.5 m.
const REACH: f64 = 2.0;
/// Aspect ratio of the picture, width over height.
const ASPECT: f64 = 1.5;

/// Animates a trajectory in an open field.
///
/// A state holds `[x, y, ẋ, ẏ]` of each driver, then of each evader, in m and m/s. States are `dt`
/// seconds apart. Each agent has a trail of past positions; the target is the origin.
///
/// Trajectories shorter than 2 s play at one third of real time. The view contains the whole
/// trajectory, except positions beyond twice the largest initial coordinate or, if larger, 1 m.
///
/// The animation ends before the first state that is non-finite, beyond 1e6 m, or of a different
/// length.
pub fn guidance(states: &[Vec<f64>], drivers: usize, dt: f64) -> Animation {
    guidance_in(&Field::default(), states, drivers, dt)
}

/// Animates a trajectory as [`guidance`] does, with obstacles and walls. The view includes an
/// obstacle or the walls unless they extend beyond the limit for positions in [`guidance`].
pub fn guidance_in(field: &Field, states: &[Vec<f64>], drivers: usize, dt: f64) -> Animation {
    let width = states.first().map_or(0, Vec::len);
    let valid = |s: &&Vec<f64>| {
        let near = s.chunks_exact(4).all(|agent| agent[0].abs() < FAR && agent[1].abs() < FAR);
        s.len() == width && near && s.iter().all(|v| v.is_finite())
    };
    let states: Vec<&Vec<f64>> = states.iter().take_while(valid).collect();
    let time = states.len().saturating_sub(1) as f64 * dt;
    let (slowness, speed) = if time < 2.0 { (3.0, "at ⅓ speed") } else { (1.0, "in real time") };
    let drivers = drivers.min(width / 4);
    let number =
        |n: usize, what: &str| if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") };
    let title = format!(
        "{}, {}: {time:.1} s {speed}",
        number(drivers, "driver"),
        number(width / 4 - drivers, "evader")
    );

    let shown = states.len().min(MAX_FRAMES);
    let step = |frame: usize| frame * (states.len() - 1) / (shown - 1).max(1);
    let layout = Layout::new(
        (0..shown).map(|frame| positions(states[step(frame)])).collect(),
        drivers,
        field.finite(),
    );
    let agents = [("drivers", DRIVER), ("evaders", EVADER), ("target", TARGET)];
    Animation {
        title,
        seconds: time * slowness,
        still: layout.field.shapes(&layout),
        frames: (0..shown).map(|frame| layout.frame(frame)).collect(),
        view: (layout.low, layout.high),
        legend: agents
            .into_iter()
            .chain(layout.field.legend())
            .map(|(name, color)| (name.into(), color))
            .collect(),
        unit: "m",
        time,
        ..Animation::default()
    }
}

/// Positions of the agents.
fn positions(state: &[f64]) -> Vec<[f64; 2]> {
    state.chunks_exact(4).map(|agent| [agent[0], agent[1]]).collect()
}

/// Data shared by all frames.
struct Layout {
    /// Position of every agent, by frame.
    path: Vec<Vec<[f64; 2]>>,
    drivers: usize,
    field: Field,
    low: [f64; 2],
    high: [f64; 2],
}

impl Layout {
    fn new(path: Vec<Vec<[f64; 2]>>, drivers: usize, field: Field) -> Self {
        let largest =
            |frame: &Vec<[f64; 2]>| frame.iter().flatten().fold(0.0, |m: f64, v| m.max(v.abs()));
        let limit = REACH * path.first().map_or(0.0, largest).max(0.5);
        let (mut low, mut high) = ([-0.5f64; 2], [0.5f64; 2]);
        for position in path.iter().flatten().chain(&field.corners(limit)) {
            for axis in 0..2 {
                low[axis] = low[axis].min(position[axis].max(-limit));
                high[axis] = high[axis].max(position[axis].min(limit));
            }
        }
        let size = [high[0] - low[0], high[1] - low[1]].map(|size| 1.15 * size);
        let height = 1.1 * size[1].max(size[0] / ASPECT);
        let half = [ASPECT * height / 2.0, height / 2.0];
        let middle = [(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0];
        let corner = |sign: f64| [middle[0] + sign * half[0], middle[1] + sign * half[1]];
        Self { path, drivers, field, low: corner(-1.0), high: corner(1.0) }
    }

    /// Height of the view, m. The sizes of agents, trails, target and outlines are relative to it.
    fn unit(&self) -> f64 {
        self.high[1] - self.low[1]
    }

    fn frame(&self, frame: usize) -> Vec<Shape> {
        let radius = 0.014 * self.unit();
        let mut shapes = self.target();
        let agents = self.path[frame].len();
        for agent in 0..agents {
            shapes.extend(self.trail(frame, agent, radius));
        }
        // Drivers are drawn in front of evaders.
        for agent in (0..agents).rev() {
            let color = if agent < self.drivers { DRIVER } else { EVADER };
            shapes.push(Shape::Circle { center: self.path[frame][agent], radius, color });
        }
        shapes
    }

    /// Trail of past positions, thinner with age. Before the start, agents rest at their initial
    /// positions.
    fn trail(&self, frame: usize, agent: usize, radius: f64) -> Vec<Shape> {
        let pieces = (ALL_PIECES / self.path[frame].len()).clamp(1, MAX_PIECES);
        let length = (TRAIL * (self.path.len() - 1) as f64).ceil() as usize;
        let at = |piece: usize| self.path[frame.saturating_sub(length * piece / pieces)][agent];
        let color = if agent < self.drivers { DRIVER_TRAIL } else { EVADER_TRAIL };
        let width = |piece: usize| 1.3 * radius * (1.0 - 0.85 * piece as f64 / pieces as f64);
        (0..pieces)
            .rev()
            .map(|p| Shape::Line { from: at(p + 1), to: at(p), width: width(p), color })
            .collect()
    }

    /// Cross in a disc at the origin.
    fn target(&self) -> Vec<Shape> {
        let arm = 0.028 * self.unit();
        let line = |x: f64, y: f64| Shape::Line {
            from: [-x, -y],
            to: [x, y],
            width: 0.005 * self.unit(),
            color: TARGET,
        };
        let disc = Shape::Circle { center: [0.0; 2], radius: 1.7 * arm, color: TARGET_AREA };
        vec![disc, line(arm, 0.0), line(0.0, arm)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two agents that pass each other; the first is a driver.
    fn trajectory(speed: f64) -> Vec<Vec<f64>> {
        (0..61)
            .map(|i| f64::from(i) / 15.0)
            .map(|t| vec![3.0 - t, 1.0, -1.0, 0.0, speed * t, 0.5, speed, 0.0])
            .collect()
    }

    fn dots(animation: &Animation, frame: usize, of: &str) -> Vec<[f64; 2]> {
        let dot = |shape: &Shape| match shape {
            Shape::Circle { center, color, .. } if *color == of => Some(*center),
            _ => None,
        };
        animation.frames[frame].iter().filter_map(dot).collect()
    }

    #[test]
    fn all_agents_are_in_view() {
        let animation = guidance(&trajectory(1.0), 1, 1.0 / 15.0);
        assert_eq!(animation.title, "1 driver, 1 evader: 4.0 s in real time");
        assert_eq!(dots(&animation, 60, DRIVER)[0], [-1.0, 1.0]);
        assert_eq!(dots(&animation, 60, EVADER)[0], [4.0, 0.5]);
        let (low, high) = animation.view;
        assert!(low[0] < -1.0 && high[0] > 4.0 && low[1] < 0.0 && high[1] > 1.0);
        roxmltree::Document::parse(&animation.to_svg()).expect("an SVG is XML");
    }

    #[test]
    fn animation_ends_before_a_non_finite_state() {
        let mut states = trajectory(1.0);
        states[20][6] = f64::INFINITY;
        let animation = guidance(&states, 1, 1.0 / 15.0);
        assert_eq!(animation.frames.len(), 20);
        assert!(
            (animation.seconds - 3.0 * 19.0 / 15.0).abs() < 1e-9 && animation.title.contains("⅓")
        );
    }

    #[test]
    fn an_agent_at_10_km_per_s_does_not_widen_the_view() {
        let animation = guidance(&trajectory(1e4), 1, 1.0 / 15.0);
        assert!(animation.view.1[0] - animation.view.0[0] < 50.0);
        let svg = animation.to_svg();
        assert!(!svg.contains("NaN") && !svg.contains("inf\""));
    }

    #[test]
    fn an_animation_of_100_agents_is_below_1_500_000_bytes() {
        let states: Vec<Vec<f64>> = (0..2000)
            .map(|t| {
                (0..400).map(|i| f64::from(i).sin() + (f64::from(t * i) * 1e-3).cos()).collect()
            })
            .collect();
        let svg = guidance(&states, 20, 0.01).to_svg();
        assert!(svg.len() < 1_500_000, "{} bytes", svg.len());
    }

    #[test]
    fn empty_and_invalid_inputs_give_a_picture() {
        for states in [
            vec![],
            vec![vec![]],
            vec![vec![]; 3],
            vec![vec![f64::NAN; 4]],
            vec![vec![0.0; 3]],
            vec![vec![0.0; 4]],
        ] {
            roxmltree::Document::parse(&guidance(&states, 2, 0.02).to_svg())
                .expect("an SVG is XML");
        }
    }
}

//! The animation of drivers who herd evaders to a target.

mod field;

pub use field::Field;

use super::animation::{Animation, Shape};

const DRIVER: &str = "#D55E00";
const DRIVER_TRAIL: &str = "#F2C6A5";
const EVADER: &str = "#0072B2";
const EVADER_TRAIL: &str = "#A9CDE6";
const TARGET: &str = "#009E73";
const TARGET_AREA: &str = "#DDF1EA";
const DARK: &str = "#4A4F57";
const TRACK: &str = "#ECEEF1";

/// More frames than this are thinned; agents move in straight lines from one to the next.
const MAX_FRAMES: usize = 120;
/// Pieces that the trails of all agents have together at most; each agent's has at most [`MAX_PIECES`].
const ALL_PIECES: usize = 120;
const MAX_PIECES: usize = 8;
/// The part of the film that a trail goes back.
const TRAIL: f64 = 0.25;
/// An agent farther than this many metres from the target is taken for a simulation that blew up.
const FAR: f64 = 1e6;
/// The view reaches at most this many times as far as the start states do.
const REACH: f64 = 2.0;
/// Width over height of the picture.
const ASPECT: f64 = 1.5;

/// Films a trajectory in an open field. Each state is x, y and the velocity of every driver and then of every evader, in metres and
/// seconds, and `dt` seconds pass between two states. Behind every agent is a trail of where it was; the target is the
/// origin.
///
/// A trajectory under 2 s is shown three times slower. The view holds all of the trajectory, unless someone runs far
/// away. The film ends before the first state that is not finite or has another length than the first state.
pub fn guidance(states: &[Vec<f64>], drivers: usize, dt: f64) -> Animation {
    guidance_in(&Field::default(), states, drivers, dt)
}

/// [`guidance`] with what is in the field. The view also holds the obstacles and the walls, unless they are far from
/// everyone.
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
    let number = |n: usize, what: &str| if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") };
    let title = format!("{}, {}: {time:.1} s {speed}", number(drivers, "driver"), number(width / 4 - drivers, "evader"));

    let shown = states.len().min(MAX_FRAMES);
    let step = |frame: usize| frame * (states.len() - 1) / (shown - 1).max(1);
    let film = Film::new((0..shown).map(|frame| positions(states[step(frame)])).collect(), drivers, field.finite());
    Animation {
        title,
        seconds: time * slowness,
        still: film.field.shapes(&film),
        frames: (0..shown).map(|frame| film.frame(frame)).collect(),
        view: (film.low, film.high),
    }
}

/// Where the agents are.
fn positions(state: &[f64]) -> Vec<[f64; 2]> {
    state.chunks_exact(4).map(|agent| [agent[0], agent[1]]).collect()
}

/// What all frames share.
struct Film {
    /// Position of every agent, by frame.
    path: Vec<Vec<[f64; 2]>>,
    drivers: usize,
    field: Field,
    low: [f64; 2],
    high: [f64; 2],
}

impl Film {
    fn new(path: Vec<Vec<[f64; 2]>>, drivers: usize, field: Field) -> Self {
        let largest = |frame: &Vec<[f64; 2]>| frame.iter().flatten().fold(0.0, |m: f64, v| m.max(v.abs()));
        let limit = REACH * path.first().map_or(0.0, largest).max(0.5);
        let (mut low, mut high) = ([-0.5f64; 2], [0.5f64; 2]);
        for position in path.iter().flatten().chain(&field.corners(limit)) {
            for axis in 0..2 {
                low[axis] = low[axis].min(position[axis].max(-limit));
                high[axis] = high[axis].max(position[axis].min(limit));
            }
        }
        let size = [high[0] - low[0], high[1] - low[1]].map(|size| 1.15 * size);
        // Room above for the legend and below for the bar.
        let height = 1.1 * size[1].max(size[0] / ASPECT);
        let half = [ASPECT * height / 2.0, height / 2.0];
        let middle = [(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0];
        let corner = |sign: f64| [middle[0] + sign * half[0], middle[1] + sign * half[1]];
        Self { path, drivers, field, low: corner(-1.0), high: corner(1.0) }
    }

    /// Everything is sized as a part of the picture's height.
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
        // Drivers are in front.
        for agent in (0..agents).rev() {
            let color = if agent < self.drivers { DRIVER } else { EVADER };
            shapes.push(Shape::Circle { center: self.path[frame][agent], radius, color });
        }
        shapes.extend(self.legend(radius));
        shapes.extend(self.progress_bar(frame as f64 / (self.path.len() - 1).max(1) as f64));
        shapes
    }

    /// Where an agent was, thinner the longer ago. Before the start it was where it started.
    fn trail(&self, frame: usize, agent: usize, radius: f64) -> Vec<Shape> {
        let pieces = (ALL_PIECES / self.path[frame].len()).clamp(1, MAX_PIECES);
        let length = (TRAIL * (self.path.len() - 1) as f64).ceil() as usize;
        let at = |piece: usize| self.path[frame.saturating_sub(length * piece / pieces)][agent];
        let color = if agent < self.drivers { DRIVER_TRAIL } else { EVADER_TRAIL };
        let width = |piece: usize| 1.3 * radius * (1.0 - 0.85 * piece as f64 / pieces as f64);
        (0..pieces).rev().map(|p| Shape::Line { from: at(p + 1), to: at(p), width: width(p), color }).collect()
    }

    /// A cross in a disc at the origin.
    fn target(&self) -> Vec<Shape> {
        let arm = 0.028 * self.unit();
        let line = |x: f64, y: f64| Shape::Line { from: [-x, -y], to: [x, y], width: 0.005 * self.unit(), color: TARGET };
        let disc = Shape::Circle { center: [0.0; 2], radius: 1.7 * arm, color: TARGET_AREA };
        vec![disc, line(arm, 0.0), line(0.0, arm)]
    }

    /// Who is who, in the upper left corner.
    fn legend(&self, radius: f64) -> Vec<Shape> {
        let (unit, size) = (self.unit(), 0.03 * self.unit());
        let (mut x, y) = (self.low[0] + 0.04 * unit, self.high[1] - 0.04 * unit);
        let mut shapes = Vec::new();
        let agents = [("drivers", DRIVER), ("evaders", EVADER), ("target", TARGET)];
        for (text, color) in agents.into_iter().chain(self.field.legend()) {
            // Letters are about 0.6 of their size wide, and texts are placed by their middle.
            let width = 0.6 * size * text.len() as f64;
            let at = [x + 0.6 * size + width / 2.0, y - 0.3 * size];
            shapes.push(Shape::Circle { center: [x, y], radius: 0.8 * radius, color });
            shapes.push(Shape::Text { at, size, text: text.into(), color: DARK });
            x += width + 2.2 * size;
        }
        shapes
    }

    /// A thin bar along the lower edge that fills as time passes.
    fn progress_bar(&self, progress: f64) -> [Shape; 2] {
        let unit = self.unit();
        let (left, full) = (self.low[0] + 0.04 * unit, self.high[0] - self.low[0] - 0.08 * unit);
        let bar = |width: f64, color| Shape::Rect {
            center: [left + width / 2.0, self.low[1] + 0.03 * unit],
            size: [width, 0.008 * unit],
            color,
        };
        [bar(full, TRACK), bar(full * progress, DARK)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two agents, the first a driver, who run away from each other.
    fn trajectory(speed: f64) -> Vec<Vec<f64>> {
        (0..61).map(|i| f64::from(i) / 15.0).map(|t| vec![3.0 - t, 1.0, -1.0, 0.0, speed * t, 0.5, speed, 0.0]).collect()
    }

    fn dots(film: &Animation, frame: usize, of: &str) -> Vec<[f64; 2]> {
        let dot = |shape: &Shape| match shape {
            Shape::Circle { center, color, .. } if *color == of => Some(*center),
            _ => None,
        };
        film.frames[frame].iter().filter_map(dot).collect()
    }

    #[test]
    fn everyone_is_in_the_picture() {
        let film = guidance(&trajectory(1.0), 1, 1.0 / 15.0);
        assert_eq!(film.title, "1 driver, 1 evader: 4.0 s in real time");
        // The first is the agent, the second its entry in the legend.
        assert_eq!(dots(&film, 60, DRIVER)[0], [-1.0, 1.0]);
        assert_eq!(dots(&film, 60, EVADER)[0], [4.0, 0.5]);
        let (low, high) = film.view;
        assert!(low[0] < -1.0 && high[0] > 4.0 && low[1] < 0.0 && high[1] > 1.0);
        roxmltree::Document::parse(&film.to_svg()).expect("an SVG is XML");
    }

    #[test]
    fn film_ends_before_a_state_that_is_not_finite() {
        let mut states = trajectory(1.0);
        states[20][6] = f64::INFINITY;
        let film = guidance(&states, 1, 1.0 / 15.0);
        assert_eq!(film.frames.len(), 20);
        assert!((film.seconds - 3.0 * 19.0 / 15.0).abs() < 1e-9 && film.title.contains("⅓"));
    }

    #[test]
    fn one_who_runs_away_leaves_the_view() {
        let film = guidance(&trajectory(1e4), 1, 1.0 / 15.0);
        assert!(film.view.1[0] - film.view.0[0] < 50.0);
        let svg = film.to_svg();
        assert!(!svg.contains("NaN") && !svg.contains("inf\""));
    }

    #[test]
    fn many_agents_do_not_make_a_large_file() {
        let states: Vec<Vec<f64>> =
            (0..2000).map(|t| (0..400).map(|i| f64::from(i).sin() + (f64::from(t * i) * 1e-3).cos()).collect()).collect();
        let svg = guidance(&states, 20, 0.01).to_svg();
        assert!(svg.len() < 1_500_000, "{} bytes", svg.len());
    }

    #[test]
    fn empty_inputs_give_a_picture() {
        for states in [vec![], vec![vec![]], vec![vec![]; 3], vec![vec![f64::NAN; 4]], vec![vec![0.0; 3]], vec![vec![0.0; 4]]] {
            roxmltree::Document::parse(&guidance(&states, 2, 0.02).to_svg()).expect("an SVG is XML");
        }
    }
}

//! Animation of rods and boxes, for small planar mechanical systems.

use super::animation::{Animation, Shape, View};

const ROD: &str = "#0072B2";
const JOINT: &str = "#4A4F57";
/// Colours of the boxes in turn.
pub const BOXES: [&str; 3] = ["#E69F00", "#009E73", "#CC79A7"];
const GROUND: &str = "#9AA0A8";
const MARK: &str = "#D55E00";

/// Largest number of frames. Longer motions are thinned.
const MAX_FRAMES: usize = 250;
/// Absolute value of a coordinate from which a posture counts as diverged, m.
const FAR: f64 = 1e6;
/// Width of the floor beyond each side of the view, in widths of the view.
const FLOOR: f64 = 20.0;

/// Positions at one time, m.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Posture {
    /// Joints of a chain of rods, in order; the same number at every time. Empty for no chain.
    pub chain: Vec<[f64; 2]>,
    /// Centers of the boxes; the same number at every time.
    pub boxes: Vec<[f64; 2]>,
}

/// Static parts and settings of the animation.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    /// Title of the animation.
    pub title: String,
    /// Width of a box, m. Joints, rods, the floor line and the target mark scale with it.
    pub size: f64,
    /// Height of a floor or rail, m. `None` for neither.
    pub floor: Option<f64>,
    /// Target position, m.
    pub mark: Option<[f64; 2]>,
}

/// Animates a motion, with postures `dt` seconds apart.
///
/// Motions shorter than 2 s play at one third of real time. The animation ends before the first
/// posture that is non-finite or beyond 1e6 m.
pub fn mechanics(stage: &Stage, postures: &[Posture], dt: f64) -> Animation {
    let points = |posture: &Posture| [&posture.chain[..], &posture.boxes[..]].concat();
    let near = |posture: &&Posture| points(posture).iter().flatten().all(|x| x.abs() < FAR);
    let shown: Vec<&Posture> = postures.iter().take_while(near).collect();
    let time = shown.len().saturating_sub(1) as f64 * dt;
    let (slowness, speed) = if time < 2.0 { (3.0, "at ⅓ speed") } else { (1.0, "in real time") };

    let still_points = stage.floor.map(|height| [0.0, height]).into_iter().chain(stage.mark);
    let all: Vec<[f64; 2]> =
        shown.iter().flat_map(|posture| points(posture)).chain(still_points).collect();
    let end = |i: usize, pick: fn(f64, f64) -> f64| {
        all.iter().map(|point| point[i]).reduce(pick).unwrap_or(0.0)
    };
    let margin = 1.5 * stage.size;
    let mut low = [end(0, f64::min) - margin, end(1, f64::min) - margin];
    let mut high = [end(0, f64::max) + margin, end(1, f64::max) + margin];
    // Widens a narrow view, for instance of a motion along a line, until the shorter side is at
    // least 1/3 of the longer side.
    for (i, other) in [(0, 1), (1, 0)] {
        let missing = (high[other] - low[other]) / 3.0 - (high[i] - low[i]);
        if missing > 0.0 {
            (low[i], high[i]) = (low[i] - missing / 2.0, high[i] + missing / 2.0);
        }
    }

    let thin = 0.12 * stage.size;
    let ground = stage.floor.map(|height| {
        // Extends beyond the view, which `Animation::share_scale` may enlarge.
        let width = FLOOR * (high[0] - low[0]);
        let (from, to) =
            ([low[0] - width, height - 0.5 * thin], [high[0] + width, height - 0.5 * thin]);
        Shape::Line { from, to, width: thin, color: GROUND }
    });
    let mark =
        stage.mark.map(|center| Shape::Circle { center, radius: 0.25 * stage.size, color: MARK });
    let count = shown.len().min(MAX_FRAMES);
    let frames = (0..count)
        .map(|frame| shapes(shown[frame * (shown.len() - 1) / (count - 1).max(1)], stage.size));
    Animation {
        title: format!("{}: {time:.1} s {speed}", stage.title),
        seconds: time * slowness,
        view: (low, high),
        reach: shown
            .first()
            .and_then(|posture| disc(posture, margin))
            .map(|disc| Animation::union(disc, (low, high))),
        still: ground.into_iter().chain(mark).collect(),
        frames: frames.collect(),
        legend: stage.mark.map(|_| ("target".to_owned(), MARK)).into_iter().collect(),
        unit: "m",
        time,
        ..Animation::default()
    }
}

/// The square around all places of a chain that turns about its first joint.
fn disc(posture: &Posture, margin: f64) -> Option<View> {
    let rods = posture.chain.windows(2);
    let lengths = rods.map(|rod| (rod[1][0] - rod[0][0]).hypot(rod[1][1] - rod[0][1]));
    let (radius, first) = (lengths.sum::<f64>() + margin, posture.chain.first()?);
    Some((first.map(|x| x - radius), first.map(|x| x + radius)))
}

fn shapes(posture: &Posture, size: f64) -> Vec<Shape> {
    let boxes = posture.boxes.iter().enumerate().map(|(i, &center)| Shape::Rect {
        center,
        size: [size; 2],
        color: BOXES[i % BOXES.len()],
    });
    let rods = (posture.chain.len() > 1).then(|| Shape::Curve {
        points: posture.chain.clone(),
        width: 0.3 * size,
        color: ROD,
    });
    let joints = posture.chain.iter().map(|&center| Shape::Circle {
        center,
        radius: 0.22 * size,
        color: JOINT,
    });
    boxes.chain(rods).chain(joints).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_animation_shows_all_bodies_and_ends_before_a_nan() {
        let stage =
            Stage { title: "A test".into(), size: 0.2, floor: Some(0.0), mark: Some([3.0, 0.0]) };
        let posture = |x: f64| Posture { chain: vec![[x, 0.0], [x, 1.0]], boxes: vec![[x, 0.1]] };
        let animation =
            mechanics(&stage, &[posture(0.0), posture(1.0), posture(f64::NAN), posture(2.0)], 0.5);
        assert_eq!(
            (animation.frames.len(), animation.still.len(), animation.frames[0].len()),
            (2, 2, 4)
        );
        let (low, high) = animation.view;
        assert!(low[0] < 0.0 && high[0] > 3.0 && high[1] > 1.0, "{low:?} {high:?}");
        let picture = animation.to_svg();
        roxmltree::Document::parse(&picture).expect("an SVG is XML");
        assert!(picture.contains("A test: 0.5 s at ⅓ speed"));
        mechanics(&stage, &[], 0.5).to_svg();
        // The chain of length 1 turns about (0, 0), and the margin is 1.5 times 0.2 m.
        let reach = animation.reach.expect("a chain");
        assert!((reach.0[0] + 1.3).abs() < 1e-12 && (reach.0[1] + 1.3).abs() < 1e-12);
        assert!(reach.1[0] == high[0] && reach.1[1] == high[1], "{reach:?} contains the view");
    }
}

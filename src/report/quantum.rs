//! The animation of a particle in a box whose floor is tilted.

use super::animation::{Animation, Shape};

const DENSITY: &str = "#0072B2";
const TILT: &str = "#D55E00";
const DARK: &str = "#4A4F57";
const RAIL: &str = "#9AA0A8";
const TRACK: &str = "#ECEEF1";

/// More frames than this are thinned.
const MAX_FRAMES: usize = 250;
/// More grid points than this share bars.
const MAX_BARS: usize = 64;
/// Width of the box in the picture, and heights of the density above its floor and of the potential around its own.
const BOX: f64 = 2.0;
const HEIGHT: f64 = 0.75;
const REACH: f64 = 0.17;
/// Where the potential is zero, and where the bar of progress is.
const LEVEL: f64 = -0.34;
const PROGRESS: f64 = -0.62;
/// Room around the box.
const MARGIN: f64 = 0.12;

/// Films a trajectory. Each state is the real and imaginary part of ψ at every grid point between the walls, and `dt`
/// units of time pass between two states. Bars show |ψ|², scaled to the largest of the trajectory; the line below is
/// the potential `c x` of the control c, scaled to the steepest.
///
/// The film ends before the first state that is not finite or has another length than the first state.
pub fn quantum(states: &[Vec<f64>], controls: &[f64], dt: f64) -> Animation {
    let width = states.first().map_or(0, Vec::len);
    let valid = |s: &&Vec<f64>| s.len() == width && s.iter().all(|v| v.is_finite());
    let densities: Vec<Vec<f64>> = states.iter().take_while(valid).map(|state| density(state)).collect();
    let finite_or_one = |value: f64| if value.is_finite() && value > 0.0 { value } else { 1.0 };
    let highest = finite_or_one(densities.iter().flatten().copied().fold(0.0, f64::max));
    let steepest = controls.iter().map(|c| c.abs()).filter(|c| c.is_finite()).fold(0.0, f64::max);
    let time = densities.len().saturating_sub(1) as f64 * dt;
    let shown = densities.len().min(MAX_FRAMES);
    let frames = (0..shown).map(|frame| {
        let step = frame * (densities.len() - 1) / (shown - 1).max(1);
        // The last state has no control of its own and keeps the one before.
        let control = controls.get(step.min(controls.len().saturating_sub(1))).copied().unwrap_or(0.0);
        let tilt = if control.is_finite() { control / finite_or_one(steepest) } else { 0.0 };
        shapes(&densities[step], highest, tilt, frame as f64 / (shown - 1).max(1) as f64)
    });
    Animation {
        title: format!("Particle in a box: {time:.1} units of time, slopes up to ±{steepest:.2}"),
        seconds: time.clamp(4.0, 12.0),
        view: ([-MARGIN, PROGRESS - 0.08], [BOX + MARGIN, HEIGHT + 0.1]),
        frames: frames.collect(),
    }
}

/// |ψ|² at every grid point, or its mean over neighbours if there are many.
fn density(state: &[f64]) -> Vec<f64> {
    let points: Vec<f64> = state.chunks_exact(2).map(|psi| psi[0] * psi[0] + psi[1] * psi[1]).collect();
    let bars = points.len().min(MAX_BARS);
    let group = |bar: usize| &points[bar * points.len() / bars..(bar + 1) * points.len() / bars];
    (0..bars).map(|bar| group(bar).iter().sum::<f64>() / group(bar).len() as f64).collect()
}

/// One frame; tilt is between -1 and 1, progress between 0 and 1.
fn shapes(density: &[f64], highest: f64, tilt: f64, progress: f64) -> Vec<Shape> {
    // The walls are half a grid point beyond the outermost bars.
    let spacing = BOX / (density.len() + 1) as f64;
    let mut shapes: Vec<Shape> = density
        .iter()
        .enumerate()
        .map(|(j, density)| {
            let height = HEIGHT * density / highest;
            let center = [(j + 1) as f64 * spacing, height / 2.0];
            Shape::Rect { center, size: [0.8 * spacing, height], color: DENSITY }
        })
        .collect();
    let line = |from, to, width, color| Shape::Line { from, to, width, color };
    shapes.push(line([0.0, 0.0], [BOX, 0.0], 0.012, DARK));
    for x in [0.0, BOX] {
        shapes.push(line([x, 0.0], [x, HEIGHT + 0.05], 0.025, DARK));
    }
    let label = |x: f64, y: f64, text: &str| Shape::Text { at: [x, y], size: 0.055, text: text.into(), color: DARK };
    shapes.push(label(BOX / 2.0, -0.08, "probability |ψ|²"));
    shapes.push(line([0.0, LEVEL], [BOX, LEVEL], 0.006, RAIL));
    shapes.push(line([0.0, LEVEL], [BOX, LEVEL + REACH * tilt], 0.02, TILT));
    shapes.push(label(BOX / 2.0, LEVEL - REACH - 0.05, "potential c x"));
    let bar = |width: f64, color| Shape::Rect { center: [width / 2.0, PROGRESS], size: [width, 0.02], color };
    shapes.extend([bar(BOX, TRACK), bar(BOX * progress, DARK)]);
    shapes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trajectory(grid: usize) -> Vec<Vec<f64>> {
        (0..50).map(|t| (0..2 * grid).map(|i| (f64::from(t) * 0.1 + i as f64).sin()).collect()).collect()
    }

    #[test]
    fn bars_are_as_high_as_the_density() {
        let film = quantum(&[vec![0.6, 0.0, 0.0, 0.3]], &[], 0.1);
        let heights: Vec<f64> = film.frames[0]
            .iter()
            .filter_map(|shape| match shape {
                Shape::Rect { size, color, .. } if *color == DENSITY => Some(size[1]),
                _ => None,
            })
            .collect();
        assert!(heights.len() == 2 && (heights[0] - HEIGHT).abs() < 1e-12 && (heights[1] - HEIGHT / 4.0).abs() < 1e-12);
    }

    #[test]
    fn film_ends_before_a_state_that_is_not_finite() {
        let mut states = trajectory(200);
        states[30][7] = f64::NAN;
        let film = quantum(&states, &[1.0, f64::INFINITY, -2.0], 0.1);
        assert_eq!(film.frames.len(), 30);
        let svg = film.to_svg();
        roxmltree::Document::parse(&svg).expect("an SVG is XML");
        assert!(!svg.contains("NaN") && !svg.contains("inf\"") && svg.len() < 200_000, "{} bytes", svg.len());
    }

    #[test]
    fn empty_inputs_give_a_picture() {
        for states in [vec![], vec![vec![]], vec![vec![f64::NAN; 4]], vec![vec![0.0]], vec![vec![0.0; 6]; 2]] {
            roxmltree::Document::parse(&quantum(&states, &[], 0.0625).to_svg()).expect("an SVG is XML");
        }
    }
}

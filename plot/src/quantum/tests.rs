//! Tests of the quantum animation.

use super::*;

fn trajectory(grid: usize, states: usize) -> Vec<Vec<f64>> {
    let part = |t: usize, i: usize| (t as f64 * 0.1 + i as f64).sin() / (grid as f64).sqrt();
    (0..states).map(|t| (0..2 * grid).map(|i| part(t, i)).collect()).collect()
}

fn bars(animation: &Animation, frame: usize) -> Vec<f64> {
    let bar = |shape: &Shape| match shape {
        Shape::Rect { size, color, .. } if *color == DENSITY => Some(size[0]),
        _ => None,
    };
    animation.frames[frame].iter().filter_map(bar).collect()
}

fn curve(shapes: &[Shape], of: &str) -> Vec<[f64; 2]> {
    let points = |shape: &Shape| match shape {
        Shape::Curve { points, color, .. } if *color == of => Some(points.clone()),
        _ => None,
    };
    shapes.iter().find_map(points).unwrap_or_default()
}

#[test]
fn bar_lengths_are_proportional_to_the_density() {
    let animation = quantum(&[vec![0.6, 0.0, 0.0, 0.3]], &[], &[0.1, 0.2], 2.0, 0.1);
    let lengths = bars(&animation, 0);
    assert!(
        lengths.len() == 2 && (lengths[0] - 150.0).abs() < 1e-9 && (lengths[1] - 37.5).abs() < 1e-9,
        "{lengths:?}"
    );
}

#[test]
fn the_dot_is_at_the_height_of_the_fidelity() {
    let states = [vec![0.6, 0.0, 0.0, 0.8], vec![0.0, 1.0, 0.0, 0.0]];
    let animation = quantum(&states, &[2.0], &[1.0, 0.0], 2.0, 0.5);
    let expected = [0.36, 1.0].map(|f| 44.0 + (120.0 - 44.0) * (f + 0.05) / 1.1);
    for (frame, expected) in expected.into_iter().enumerate() {
        let Some(Shape::Circle { center, .. }) = animation.frames[frame].last() else {
            panic!("the dot is in front")
        };
        assert!((center[1] - expected).abs() < 1e-9);
    }
    // The two columns of the map are centered at 1/4 and 3/4 of its width.
    let cursor: Vec<f64> = curve(&animation.still, FIDELITY).iter().map(|point| point[0]).collect();
    assert_eq!(cursor, [100.0 + 430.0 / 4.0, 100.0 + 430.0 * 3.0 / 4.0]);
    assert_eq!(curve(&animation.still, CONTROL).iter().map(|p| p[0]).collect::<Vec<_>>(), cursor);
}

#[test]
fn the_map_has_a_cell_per_state_and_position_up_to_256_by_64() {
    for (grid, states, size) in
        [(7, 5, "5 × 7"), (32, 129, "129 × 32"), (100_000, 2, "2 × 64"), (9, 2000, "256 × 9")]
    {
        let animation =
            quantum(&trajectory(grid, states), &vec![1.0; states - 1], &vec![0.1; grid], 2.0, 0.1);
        let images = animation
            .still
            .iter()
            .filter(|shape| format!("{shape:?}").contains(&format!("Raster({size})")));
        assert_eq!(images.count(), 1, "{size}");
    }
}

#[test]
fn an_animation_of_3000_states_is_below_300_kilobytes() {
    let mut states = trajectory(200, 3000);
    states
        .iter_mut()
        .zip(0..)
        .for_each(|(s, t)| s.iter_mut().for_each(|v| *v *= 1.0 + 0.5 * f64::sin(f64::from(t))));
    let controls: Vec<f64> = (0..3000).map(|t| f64::from(t).sin()).collect();
    let svg = quantum(&states, &controls, &[0.07; 200], 2.0, 0.0625).to_svg();
    assert!(svg.len() < 300_000, "{} bytes", svg.len());
}

#[test]
fn animation_ends_before_a_non_finite_state() {
    let mut states = trajectory(200, 50);
    states[30][7] = f64::NAN;
    let animation = quantum(&states, &[1.0, f64::INFINITY, -2.0], &[0.07; 200], 2.0, 0.1);
    assert_eq!(animation.frames.len(), 30);
    let svg = animation.to_svg();
    roxmltree::Document::parse(&svg).expect("an SVG is XML");
    assert!(!svg.contains("NaN") && !svg.contains("inf"));
}

#[test]
fn empty_and_invalid_inputs_give_a_picture() {
    for states in [
        vec![],
        vec![vec![]],
        vec![vec![f64::NAN; 4]],
        vec![vec![0.0]],
        vec![vec![0.0; 6]; 2],
        vec![vec![1e200; 6]],
    ] {
        for (target, length, dt) in [(vec![], 2.0, 0.0625), (vec![0.5; 3], f64::NAN, 0.0)] {
            let svg = quantum(&states, &[], &target, length, dt).to_svg();
            roxmltree::Document::parse(&svg).expect("an SVG is XML");
            assert!(!svg.contains("NaN") && !svg.contains("inf<"));
        }
    }
}

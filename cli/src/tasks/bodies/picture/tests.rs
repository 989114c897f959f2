//! Tests of films.

use super::space::{AXES, add, reference};
use super::*;
use physgrad_bodies::{ContactForce, mjcf};

fn model(bodies: &str) -> Model {
    let floor = "<geom type='plane' size='1 1 1'/>";
    let text = format!("<mujoco><worldbody>{floor}{bodies}</worldbody></mujoco>");
    mjcf::parse(&text, "test.xml").expect("a model")
}

/// A film without contacts.
fn still_film(model: &Model, poses: &[Vec<Pose>], dt: f64, title: &str) -> Animation {
    film(model, poses, &vec![Vec::new(); poses.len()], dt, title)
}

/// A ball of radius 0.1 m with these attributes and joints.
fn ball(attributes: &str, joints: &str) -> String {
    format!("<body {attributes}>{joints}<geom size='0.1'/></body>")
}

const SIDE: &str = "<joint type='slide' axis='1 0 0'/><joint axis='0 1 0'/>";
const ABOVE: &str = "<joint type='slide' axis='1 0 0'/><joint axis='0 0 1'/>";
const FREE: &str = "<freejoint/>";

/// The reference pose, in which all moving bodies are displaced.
fn moved(model: &Model, by: Vec3) -> Vec<Pose> {
    let mut poses = reference(model);
    poses.iter_mut().skip(1).for_each(|pose| pose.0 = add(pose.0, by));
    poses
}

/// Identifiers and first points of the solids of a frame.
fn points(frame: &[Shape]) -> Vec<(usize, [f64; 2])> {
    let solid = |shape: &Shape| match shape {
        Shape::Solid { id, points, .. } => Some((*id, points[0])),
        _ => None,
    };
    frame.iter().filter_map(solid).collect()
}

fn near(a: [f64; 2], b: [f64; 2]) -> bool {
    (0..2).all(|i| (a[i] - b[i]).abs() < 1e-9)
}

#[test]
fn planar_models_are_seen_along_the_axis_of_their_hinges() {
    let pendulum = |axis: &str| {
        let arm = ball("pos='0.3 0.2 0.1'", "");
        model(&format!("<body pos='0 0 1'><joint axis='{axis}'/><geom size='0.1'/>{arm}</body>"))
    };
    for (axis, at) in [
        ("0 1 0", [0.3, 0.1]),
        ("0 -1 0", [0.3, 0.1]),
        ("0 0 1", [0.3, 0.2]),
        ("1 0 0", [0.2, 0.1]),
    ] {
        let model = pendulum(axis);
        let film = still_film(&model, &[reference(&model)], 0.1, "");
        assert_eq!(film.unit, "m");
        let seen = points(&film.frames[0]);
        let last = seen.iter().find(|(id, _)| *id == 3).expect("the second ball");
        assert!(near(last.1, at), "{axis}: {last:?}");
    }
    let across = model(&ball("", "<joint type='slide' axis='0 1 0'/><joint axis='0 1 0'/>"));
    for model in [pendulum("0 1 1"), across, model(&ball("", FREE))] {
        assert_eq!(still_film(&model, &[reference(&model)], 0.1, "").unit, "", "in perspective");
    }
}

#[test]
fn the_camera_follows_bodies_without_limits_and_the_floor_stays() {
    for joints in [SIDE, ABOVE, FREE] {
        let model = model(&ball("pos='0 0 1'", joints));
        let film =
            still_film(&model, &[[0.0; 3], [0.02, 0.0, 0.0]].map(|by| moved(&model, by)), 1.0, "");
        let [before, after] = [0, 1].map(|frame| points(&film.frames[frame]));
        assert!(near(before[before.len() - 1].1, after[after.len() - 1].1), "{joints}: the ball");
        let mut marks = 0;
        for ((id, from), (same, to)) in before.iter().zip(&after).filter(|(a, _)| a.0 > 100) {
            assert_eq!(id, same, "no mark left the picture");
            marks += usize::from(from[0] > to[0] + 1e-3);
            let planar = near([from[0] - 0.02, from[1]], *to) || near(*from, *to);
            assert!(joints == FREE || planar, "{joints}: {from:?} to {to:?}");
        }
        assert!(marks >= 15, "{joints}: {marks} marks move backwards");
    }
    let bounded = model(&ball("", "<joint type='slide' axis='1 0 0' range='-1 1'/>"));
    let film =
        still_film(&bounded, &[[0.0; 3], [0.5, 0.0, 0.0]].map(|by| moved(&bounded, by)), 1.0, "");
    let ball = |frame: usize| points(&film.frames[frame]).last().map(|(_, point)| point[0]);
    assert_eq!((ball(0), ball(1)), (Some(0.0), Some(0.5)), "the camera stands");
    assert!(film.view.0[0] < -0.1 && film.view.1[0] > 0.6, "{:?}", film.view);
}

#[test]
fn marks_return_on_the_other_side() {
    let model = model(&ball("pos='0 0 1'", SIDE));
    let count = |film: &Animation| {
        let ids = film.frames.iter().flat_map(|frame| points(frame));
        let ids: std::collections::HashSet<usize> = ids.map(|(id, _)| id).collect();
        ids.len()
    };
    let run: Vec<Vec<Pose>> =
        (0..200).map(|i| moved(&model, [0.01 * f64::from(i), 0.0, 0.0])).collect();
    let film = still_film(&model, &run, 0.1, "");
    // The reach is 0.1 m: marks every 5 cm, over 1.99 m. The ball has an edge.
    assert_eq!(count(&film), 2 + 17 + 40);
    for pair in film.frames.windows(2) {
        let [before, after] = [&pair[0], &pair[1]].map(|frame| points(frame));
        let new = before.iter().zip(&after).filter(|(a, b)| a.0 != b.0).count();
        assert!(new <= 1, "the others keep their places in the order");
    }
    for frame in &film.frames {
        let mut places: Vec<f64> =
            points(frame).iter().filter(|(id, _)| *id > 100).map(|(_, point)| point[0]).collect();
        places.sort_by(f64::total_cmp);
        assert!(places.windows(2).all(|pair| (pair[1] - pair[0] - 0.05).abs() < 1e-9));
        assert!(places[0] < -0.37 && places[16] > 0.37, "{places:?}");
    }
}

#[test]
fn nearer_solids_are_larger_and_painted_later() {
    let model = model(&(ball("pos='0 0 1'", FREE) + &ball("pos='0 0 1'", FREE)));
    let [mut far, mut close] = [0, 1].map(|_| reference(&model));
    (far[2].0, close[2].0) = ([0.0, 1.0, 1.0], [0.0, -1.0, 1.0]);
    let film = still_film(&model, &[far, close], 0.1, "");
    let bodies = |frame: usize| -> Vec<(usize, f64)> {
        let widths = film.frames[frame].iter().filter_map(|shape| match shape {
            Shape::Solid { id, width, .. } if *id < 4 && id % 2 == 1 => Some((*id, *width)),
            _ => None,
        });
        widths.collect()
    };
    let [(1, near_first), (3, near_second)] = bodies(1)[..] else { panic!("{:?}", bodies(1)) };
    let [(3, far_second), (1, far_first)] = bodies(0)[..] else { panic!("{:?}", bodies(0)) };
    assert_eq!(far_first, near_first, "the camera follows the first ball");
    assert!(far_second < far_first && near_second > near_first);
}

#[test]
fn lines_end_in_front_of_the_eye() {
    let model = model(&ball("", FREE));
    let camera = Camera::of(&model);
    let along = |distance: f64| space::times(distance * camera.reach, camera.forward);
    // Lines that pass the eye at a distance.
    let aside =
        |distance: f64| [0.85, -0.35, 0.0].map(|x| 0.1 * camera.reach * x * (distance + 5.0));
    let at = |distance: f64| add(along(distance), aside(distance));
    // The eye is 4 reaches away, so the nearest visible point is 1 reach in front of it.
    let exact = camera.see([0.0; 3], at(-3.0)).at;
    for ends in [[at(-30.0), at(2.0)], [at(-3.0), at(2.0)]] {
        let [end, other] = camera.see_segment([0.0; 3], ends);
        assert!(near(end, exact) && near(other, camera.see([0.0; 3], at(2.0)).at), "{end:?}");
    }
}

#[test]
fn outlines_enclose_their_forms() {
    let sizes = [("box", "0.3 0.2 0.1"), ("ellipsoid", "0.3 0.2 0.1"), ("cylinder", "0.3 0.1")];
    for (form, size) in sizes {
        let text = format!("<body>{ABOVE}<geom type='{form}' size='{size}'/></body>");
        let model = model(&text);
        let film = still_film(&model, &[reference(&model)], 0.1, "");
        let outline = film.frames[0].iter().rev().find_map(|shape| match shape {
            Shape::Solid { points, .. } => Some(points.clone()),
            _ => None,
        });
        let outline = outline.expect("a solid");
        let most = |i: usize| outline.iter().map(|p| p[i].abs()).fold(0.0, f64::max);
        let height = if form == "cylinder" { 0.3 } else { 0.2 };
        assert!((most(0) - 0.3).abs() < 0.015 && (most(1) - height).abs() < 0.015, "{form}");
        let area: f64 = (0..outline.len())
            .map(|i| (outline[i], outline[(i + 1) % outline.len()]))
            .map(|(a, b)| 0.5 * (a[0] * b[1] - a[1] * b[0]))
            .sum();
        let exact = if form == "box" { 0.24 } else { std::f64::consts::PI * 0.3 * height };
        assert!(area > 0.93 * exact && area < exact * (1.0 + 1e-9), "{form}: {area} of {exact}");
    }
}

#[test]
fn colours_are_those_of_the_file_or_of_the_palette() {
    let shape = |color: &str| format!("<geom size='0.1' {color}/>");
    let [red, half, hidden] = ["rgba='1 0 0 1'", "rgba='1 0 0 0.5'", "rgba='1 0 0 0'"].map(shape);
    let child = format!("<body><joint axis='0 1 0'/>{}</body>", shape(""));
    let text = format!("<body>{SIDE}{red}{half}{hidden}{}{child}</body>", shape(""));
    let model = model(&text);
    let solids = solid::of(&model);
    let colours: Vec<&str> = solids.iter().map(|solid| solid.colour.as_str()).collect();
    let [first, second, ..] = physgrad_plot::PALETTE;
    assert_eq!(colours, ["#FF0000", "#FF8080", first, second]);
    assert_eq!(solids[0].edge, "#990000");
}

#[test]
fn a_film_ends_before_a_nan_and_may_be_empty() {
    for joints in [SIDE, ABOVE, FREE] {
        let model = model(&ball("pos='0 0 1'", joints));
        let run = [0.0, 0.1, f64::NAN, 0.2].map(|x| moved(&model, [x, 0.0, 0.0]));
        let film = still_film(&model, &run, 0.5, "A <ball>");
        assert_eq!((film.frames.len(), film.time), (2, 0.5));
        assert_eq!(film.title, "A <ball>: 0.5 s at ⅓ speed");
        let frames = [&film.frames[0][..], &film.frames[1]].concat();
        assert!(points(&frames).iter().flat_map(|(_, point)| point).all(|x| x.is_finite()));
        for animation in [film, still_film(&model, &[], 0.5, "")] {
            roxmltree::Document::parse(&animation.to_svg()).expect("an SVG is XML");
            animation.picture(animation.frames.last().map_or(&[], Vec::as_slice), 0.0);
        }
    }
    let nothing = model("");
    still_film(&nothing, &[vec![([0.0; 3], AXES)]], 0.1, "").to_svg();
}

#[test]
fn contact_forces_are_arrows_from_the_point_of_contact() {
    let model = model(&ball("pos='0 0 0.1'", SIDE));
    let weight = model.bodies.iter().map(|body| body.mass).sum::<f64>() * 9.81;
    let touching = |force: Vec3| vec![ContactForce { contact: 0, body: 1, point: [0.0; 3], force }];
    let poses = vec![reference(&model); 4];
    let up = |weights: f64| touching([0.0, 0.0, weights * weight]);
    let forces = [up(1.0), up(0.5), vec![], up(100.0)];
    let film = film(&model, &poses, &forces, 0.1, "");
    assert_eq!(film.legend.len(), 1);
    film.to_svg();
    // The picture has its origin at the centre of the ball. Identifiers 3 and 4 are those of the arrow.
    let arrow = |frame: usize| {
        let part = |wanted: usize| {
            film.frames[frame].iter().find_map(|shape| match shape {
                Shape::Solid { id, points, width, .. } if *id == wanted => {
                    Some((points.clone(), *width))
                }
                _ => None,
            })
        };
        let ((shaft, width), (head, _)) = (part(3).expect("a shaft"), part(4).expect("a head"));
        assert!(near(shaft[0], [0.0, -0.1]), "{frame}: {shaft:?}");
        (head[0][1] + 0.1, width)
    };
    let ((whole, _), (half, _), (none, width), (most, _)) =
        (arrow(0), arrow(1), arrow(2), arrow(3));
    assert!(whole > 0.01 && (half - 0.5 * whole).abs() < 1e-9, "{whole} and {half}");
    assert!(none.abs() < 1e-9 && width == 0.0, "no force: {none}");
    assert!(most > whole && most < 5.0 * whole, "the largest force: {most}");
    assert!(still_film(&model, &poses, 0.1, "").legend.is_empty());
}

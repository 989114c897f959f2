//! [`Solid`]: a shape as it is drawn, and [`Outline`]: its picture.

use super::camera::Seen;
use super::colour;
use super::space::{Pose, Vec3, placed, transform};
use physgrad_bodies::model::{Form, Model, Shape};
use std::f64::consts::TAU;

/// Number of corners of the outline of a form that is neither a sphere nor a capsule.
const CORNERS: usize = 16;
/// Number of points on a circle.
const CIRCLE: usize = 32;

/// A visible shape that is not a plane.
pub struct Solid<'a> {
    shape: &'a Shape,
    /// CSS colour.
    pub colour: String,
    /// CSS colour of the edge.
    pub edge: String,
}

/// A polygon, or a point or line with a width.
pub struct Outline {
    pub points: Vec<[f64; 2]>,
    /// Diameter of a sphere or capsule; 0 for polygons.
    pub width: f64,
    /// Distance of the centre behind the target.
    pub depth: f64,
}

/// The visible shapes of a model.
pub fn of(model: &Model) -> Vec<Solid<'_>> {
    let shapes = model.shapes.iter().filter(|shape| shape.form != Form::Plane);
    shapes
        .filter_map(|shape| {
            let [colour, edge] = colour::of(model, shape)?;
            Some(Solid { shape, colour, edge })
        })
        .collect()
}

impl Solid<'_> {
    /// The outline where a camera sees the points of space.
    pub fn outline(&self, poses: &[Pose], see: impl Fn(Vec3) -> Seen) -> Outline {
        let place = placed(poses, self.shape);
        let centre = see(place.0);
        let seen = |point: Vec3| see(transform(&place, point)).at;
        let (points, radius) = match self.shape.form {
            Form::Plane => (Vec::new(), 0.0),
            Form::Sphere(radius) => (vec![centre.at], radius),
            Form::Capsule(radius, half) => {
                ([-half, half].map(|z| seen([0.0, 0.0, z])).to_vec(), radius)
            }
            Form::Cylinder(radius, half) => {
                let ends = [-half, half].into_iter();
                let points = ends.flat_map(|z| circle(radius).map(move |[x, y]| [x, y, z]));
                (hull(&points.map(seen).collect::<Vec<_>>()), 0.0)
            }
            Form::Ellipsoid(axes) => {
                let scaled = |p: Vec3| [0, 1, 2].map(|i| axes[i] * p[i]);
                (hull(&ball().map(|point| seen(scaled(point))).collect::<Vec<_>>()), 0.0)
            }
            Form::Box(half) => {
                let sign = |corner: usize, i: usize| if corner >> i & 1 == 0 { -1.0 } else { 1.0 };
                let corner = |c: usize| [0, 1, 2].map(|i| sign(c, i) * half[i]);
                (hull(&(0..8).map(|c| seen(corner(c))).collect::<Vec<_>>()), 0.0)
            }
        };
        Outline { points, width: 2.0 * radius * centre.scale, depth: centre.depth }
    }
}

fn circle(radius: f64) -> impl Iterator<Item = [f64; 2]> {
    let angle = |i: usize| TAU * i as f64 / CIRCLE as f64;
    (0..CIRCLE).map(move |i| [radius * angle(i).cos(), radius * angle(i).sin()])
}

/// Points of the unit sphere.
fn ball() -> impl Iterator<Item = Vec3> {
    let level = |i: usize| (TAU / 4.0) * (2.0 * i as f64 / (CIRCLE / 2) as f64 - 1.0);
    (0..=CIRCLE / 2)
        .map(level)
        .flat_map(|latitude| circle(latitude.cos()).map(move |[x, y]| [x, y, latitude.sin()]))
}

/// The points that are farthest in evenly spaced directions. Their number does not depend on the
/// points, so that pictures can be interpolated.
fn hull(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let farthest = |i: usize| {
        // Directions between the axes, in which the edges of boxes do not compete.
        let (sin, cos) = (TAU * (i as f64 + 0.5) / CORNERS as f64).sin_cos();
        let along = |p: &[f64; 2]| cos * p[0] + sin * p[1];
        points.iter().copied().max_by(|a, b| along(a).total_cmp(&along(b)))
    };
    (0..CORNERS).filter_map(farthest).collect()
}

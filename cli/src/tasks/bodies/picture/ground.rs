//! Planes, as a line from the side or as a grid. Their marks are fixed in space, so that the motion
//! of a following camera shows.

use super::camera::Camera;
use super::colour::{FLOOR, GRID};
use super::space::{AXES, Pose, Vec3, add, cross, dot, minus, times, unit};
use physgrad_plot::Shape;

/// Number of marks on each side of the target.
const SIDE: i64 = 8;
/// Length of the line of a plane on each side of the target, in reaches. Beyond every view.
const LINE: f64 = 100.0;
/// Width of lines, in reaches: from the side, and of a grid.
const THIN: [f64; 2] = [0.01, 0.005];
/// Height of marks below a line, in reaches.
const MARK: f64 = 0.06;

/// Lines of planes.
pub fn of(planes: &[Pose], camera: &Camera, target: Vec3) -> Vec<Shape> {
    let drawn = planes.iter().enumerate().flat_map(|(i, plane)| {
        let facing = -dot(normal(plane), camera.forward);
        let marks = Marks { plane, camera, target, first: first_id(i) };
        match facing {
            _ if camera.is_planar() && facing.abs() < 1e-9 => marks.line(),
            _ if camera.is_planar() && facing > 1.0 - 1e-9 || is_floor(plane) => marks.grid(),
            _ => Vec::new(),
        }
    });
    drawn.collect()
}

/// Whether bodies can stand on a plane.
pub fn is_floor(plane: &Pose) -> bool {
    normal(plane)[2] > 0.7
}

/// The nearest point of a plane.
pub fn below(plane: &Pose, point: Vec3) -> Vec3 {
    let normal = normal(plane);
    minus(point, times(dot(minus(point, plane.0), normal), normal))
}

/// Outward unit normal of a plane.
fn normal((_, rotation): &Pose) -> Vec3 {
    rotation.map(|row| row[2])
}

/// Identifiers of marks begin beyond those of shapes.
fn first_id(plane: usize) -> usize {
    (usize::MAX / 2) + (plane << 24)
}

/// Marks at multiples of a length along a plane.
struct Marks<'a> {
    plane: &'a Pose,
    camera: &'a Camera,
    target: Vec3,
    /// First identifier.
    first: usize,
}

impl Marks<'_> {
    /// The plane from the side, with marks below it.
    fn line(&self) -> Vec<Shape> {
        let (reach, normal) = (self.camera.reach, normal(self.plane));
        let along = cross(normal, self.camera.forward);
        let at = |point: Vec3| self.camera.see(self.target, point).at;
        let (middle, thin) = (below(self.plane, self.target), THIN[0] * reach);
        // The upper edge of the line is the plane.
        let middle = minus(middle, times(0.5 * thin, normal));
        let end = |sign: f64| at(add(middle, times(sign * LINE * reach, along)));
        let line = Shape::Line { from: end(-1.0), to: end(1.0), width: thin, color: FLOOR };
        let marks = self.places(along).map(|(id, place)| {
            let top = add(middle, times(place, along));
            let bottom = minus(top, times(MARK * reach, normal));
            let points = vec![at(top), at(bottom)];
            Shape::Solid { id: self.first + id, points, width: thin, color: FLOOR.into() }
        });
        marks.chain([line]).collect()
    }

    /// The plane from above, as two families of lines.
    fn grid(&self) -> Vec<Shape> {
        let normal = normal(self.plane);
        let side = if normal[0].abs() < 0.9 { AXES[0] } else { AXES[1] };
        let x = unit(minus(side, times(dot(side, normal), normal)));
        let y = cross(normal, x);
        let (middle, half) = (below(self.plane, self.target), SIDE as f64 * self.spacing());
        let thin = THIN[1] * self.camera.reach;
        let family = |along: Vec3, across: Vec3, first: usize| {
            self.places(along).map(move |(id, place)| {
                let point = add(middle, times(place, along));
                let ends = [-half, half].map(|s| add(point, times(s, across)));
                let points = self.camera.see_segment(self.target, ends).to_vec();
                Shape::Solid { id: first + id, points, width: thin, color: GRID.into() }
            })
        };
        family(x, y, self.first).chain(family(y, x, self.first + (1 << 23))).collect()
    }

    /// A round number of about half of the reach, m.
    fn spacing(&self) -> f64 {
        let rough = 0.6 * self.camera.reach;
        let power = 10_f64.powf(rough.log10().floor());
        [5.0, 2.0, 1.0].into_iter().find(|x| x * power <= rough).unwrap_or(1.0) * power
    }

    /// Identifiers of the marks around the target, and their places along an axis, relative to the
    /// target. A mark keeps its place in the order while it is drawn.
    fn places(&self, along: Vec3) -> impl Iterator<Item = (usize, f64)> {
        let (spacing, count) = (self.spacing(), 2 * SIDE + 1);
        let target = dot(minus(self.target, self.plane.0), along);
        let first = (target / spacing).round() as i64 - SIDE;
        (0..count).map(move |i| {
            let mark = first + (i - first).rem_euclid(count);
            let id = mark.rem_euclid(1 << 23) as usize;
            (id, mark as f64 * spacing - target)
        })
    }
}

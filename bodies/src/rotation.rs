//! Rotation matrices from the notations of model files, and poses.

use crate::model::{Mat3, Vec3};

pub(crate) const IDENTITY: Mat3 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Lengths up to this have no direction, as in MuJoCo 4.0.
const SHORT: f64 = 1e-7;

pub(crate) fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// The vector divided by its length, if it has one.
pub(crate) fn unit<const N: usize>(v: [f64; N]) -> Option<[f64; N]> {
    let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    (length > SHORT).then(|| v.map(|x| x / length))
}

pub(crate) fn apply(m: &Mat3, v: Vec3) -> Vec3 {
    m.map(|row| dot(row, v))
}

pub(crate) fn transposed(m: &Mat3) -> Mat3 {
    [0, 1, 2].map(|i| [m[0][i], m[1][i], m[2][i]])
}

pub(crate) fn product(a: &Mat3, b: &Mat3) -> Mat3 {
    let columns = transposed(b);
    a.map(|row| columns.map(|column| dot(row, column)))
}

/// The matrix of a unit quaternion with the real part first.
pub(crate) fn from_quaternion([w, x, y, z]: [f64; 4]) -> Mat3 {
    [
        [w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
}

/// The unit quaternion of a rotation with the real part first, which is not negative.
pub(crate) fn to_quaternion(m: &Mat3) -> [f64; 4] {
    // Four times the squares of the parts. The largest part is not small, so that the division is
    // safe.
    let [[a, _, _], [_, b, _], [_, _, c]] = *m;
    let squares = [1.0 + a + b + c, 1.0 + a - b - c, 1.0 - a + b - c, 1.0 - a - b + c];
    let largest = (0..4).fold(0, |best, i| if squares[i] > squares[best] { i } else { best });
    let (x, y, z) = (m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]);
    let (xy, xz, yz) = (m[0][1] + m[1][0], m[0][2] + m[2][0], m[1][2] + m[2][1]);
    let s = squares[largest];
    let quaternion = match largest {
        0 => [s, x, y, z],
        1 => [x, s, xy, xz],
        2 => [y, xy, s, yz],
        _ => [z, xz, yz, s],
    };
    let sign = if quaternion[0] < 0.0 { -1.0 } else { 1.0 };
    unit(quaternion).map_or([1.0, 0.0, 0.0, 0.0], |q| q.map(|p| sign * p))
}

/// Rotation about a unit vector by an angle in rad.
pub(crate) fn about(axis: Vec3, angle: f64) -> Mat3 {
    let (s, c) = (0.5 * angle).sin_cos();
    from_quaternion([c, axis[0] * s, axis[1] * s, axis[2] * s])
}

/// Smallest rotation that turns z to a vector; about x if the vector is opposite to z.
pub(crate) fn from_z(v: Vec3) -> Option<Mat3> {
    let v = unit(v)?;
    let axis = cross([0.0, 0.0, 1.0], v);
    let sine = dot(axis, axis).sqrt();
    let (axis, sine) = match unit(axis) {
        Some(axis) => (axis, sine),
        None => ([1.0, 0.0, 0.0], 0.0),
    };
    Some(about(axis, sine.atan2(v[2])))
}

/// Rotation whose x axis is the first vector and whose y axis is the rest of the second vector,
/// made orthogonal to x.
pub(crate) fn from_xy(x: Vec3, y: Vec3) -> Option<Mat3> {
    let x = unit(x)?;
    let along = dot(x, y);
    let y = unit([0, 1, 2].map(|i| y[i] - along * x[i]))?;
    Some(transposed(&[x, y, cross(x, y)]))
}

/// Rotations about three axes in sequence: small letters are axes that turn along, capital letters
/// are fixed axes.
pub(crate) fn from_euler(angles: Vec3, sequence: [u8; 3]) -> Mat3 {
    let mut result = IDENTITY;
    for (angle, letter) in angles.into_iter().zip(sequence) {
        let axis = match letter.to_ascii_lowercase() {
            b'x' => [1.0, 0.0, 0.0],
            b'y' => [0.0, 1.0, 0.0],
            _ => [0.0, 0.0, 1.0],
        };
        let turn = about(axis, angle);
        result = if letter.is_ascii_lowercase() {
            product(&result, &turn)
        } else {
            product(&turn, &result)
        };
    }
    result
}

/// Position and orientation of a frame in another.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pose {
    pub position: Vec3,
    pub rotation: Mat3,
}

impl Pose {
    pub const IDENTITY: Self = Self { position: [0.0; 3], rotation: IDENTITY };

    /// The point in the outer frame.
    pub fn point(&self, p: Vec3) -> Vec3 {
        let turned = apply(&self.rotation, p);
        [0, 1, 2].map(|i| self.position[i] + turned[i])
    }

    /// The pose of something inside, in the outer frame.
    pub fn then(&self, inner: &Pose) -> Pose {
        Pose {
            position: self.point(inner.position),
            rotation: product(&self.rotation, &inner.rotation),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: &Mat3, b: &Mat3) -> bool {
        a.iter().flatten().zip(b.iter().flatten()).all(|(x, y)| (x - y).abs() < 1e-14)
    }

    #[test]
    fn quaternions_return() {
        for q in [[0.1, 0.2, -0.3, 0.9], [0.0, 1.0, 0.0, 0.0], [0.0, 0.3, -1.0, 0.2], [1.0; 4]] {
            let m = from_quaternion(unit(q).unwrap());
            assert!(close(&from_quaternion(to_quaternion(&m)), &m));
            assert!(close(&product(&m, &transposed(&m)), &IDENTITY));
        }
    }

    #[test]
    fn z_turns_to_any_vector() {
        for v in [[1.0, 2.0, 3.0], [0.0, 0.0, 1.0], [0.0, 0.0, -2.0], [-1.0, 0.0, 0.0]] {
            let turned = apply(&from_z(v).unwrap(), [0.0, 0.0, 1.0]);
            let wanted = unit(v).unwrap();
            assert!(turned.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-14));
        }
        assert!(from_z([0.0; 3]).is_none());
    }

    #[test]
    fn fixed_axes_are_turning_axes_in_reverse() {
        let [a, b, c] = [0.3, -0.7, 1.1];
        let fixed = from_euler([a, b, c], *b"XYZ");
        assert!(close(&fixed, &from_euler([c, b, a], *b"zyx")));
        assert!(!close(&fixed, &from_euler([a, b, c], *b"xyz")));
    }
}

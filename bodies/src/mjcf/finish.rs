//! Checks and corrections of masses, once the tree is complete.

use super::joint::spring_damper;
use super::settings::Compiler;
use super::tree::Tree;
use crate::files::FileError;
use crate::mass::{Part, principal, together, turned};
use crate::model::{Body, JointKind, Mat3};
use crate::rotation::{Pose, apply, dot, product, transposed};

/// MuJoCo's smallest mass and moment of inertia of a body that moves.
const LEAST: f64 = 1e-15;

/// Corrects the masses as the compiler asks, refuses those that cannot move, and sets the springs
/// that a time constant describes.
pub(crate) fn finish(tree: &mut Tree) -> Result<(), FileError> {
    let compiler = tree.compiler;
    for (body, element) in tree.bodies.iter_mut().zip(&tree.elements).skip(1) {
        correct(body, compiler).map_err(|what| element.error(what))?;
    }
    if let Some(wanted) = compiler.total_mass {
        let total: f64 = tree.bodies.iter().map(|b| b.mass).sum();
        let factor = wanted / total.max(LEAST);
        for body in &mut tree.bodies {
            body.mass *= factor;
            body.inertia = body.inertia.map(|i| factor * i);
        }
    }
    moving(tree)?;
    springs(tree);
    Ok(())
}

fn matrix([xx, yy, zz, xy, xz, yz]: [f64; 6]) -> Mat3 {
    [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
}

/// Lower bounds of mass and principal moments, and the triangle inequality of moments.
fn correct(body: &mut Body, compiler: &Compiler) -> Result<(), String> {
    body.mass = body.mass.max(compiler.least_mass);
    let (moments, axes) = principal(&matrix(body.inertia));
    let sum: f64 = moments.iter().sum();
    let largest = moments.into_iter().fold(0.0, f64::max);
    if moments.iter().any(|m| *m < -1e-12 * largest) {
        return Err("a principal moment of inertia is negative; correct the inertia".into());
    }
    let mut corrected = moments.map(|m| m.max(compiler.least_inertia));
    let largest = corrected.into_iter().fold(0.0, f64::max);
    let sum = if corrected == moments { sum } else { corrected.iter().sum() };
    if 2.0 * largest > sum * (1.0 + 1e-9) {
        if !compiler.balance {
            return Err(
                "a principal moment of inertia exceeds the sum of the other two, which no \
                        body has; correct the inertia or set `balanceinertia`"
                    .into(),
            );
        }
        corrected = [sum / 3.0; 3];
    }
    // Keeps all digits of matrices that need no correction.
    if corrected != moments {
        let i = turned(corrected, &axes);
        body.inertia = [i[0][0], i[1][1], i[2][2], i[0][1], i[0][2], i[1][2]];
    }
    Ok(())
}

/// Refuses moving bodies without mass or inertia. Bodies that are fixed to them count as well.
fn moving(tree: &Tree) -> Result<(), FileError> {
    let count = tree.bodies.len();
    let mut has_joint = vec![false; count];
    tree.joints.iter().for_each(|j| has_joint[j.body] = true);
    let mut heavy: Vec<bool> = tree
        .bodies
        .iter()
        .map(|b| {
            let (moments, _) = principal(&matrix(b.inertia));
            b.mass >= LEAST && moments.iter().all(|m| *m >= LEAST)
        })
        .collect();
    // Children follow their parents.
    for body in (1..count).rev() {
        if has_joint[body] && !heavy[body] {
            return Err(tree.elements[body].error(
                "the body moves and has no mass or no inertia; add a geom with mass or `inertial`",
            ));
        }
        if !has_joint[body] && heavy[body] {
            heavy[tree.bodies[body].parent] = true;
        }
    }
    Ok(())
}

/// Sets stiffness and damping of joints with `springdamper`.
fn springs(tree: &mut Tree) {
    for index in 0..tree.joints.len() {
        let Some((values, _)) = tree.springs[index] else { continue };
        let inertia = inertia(tree, index);
        let joint = &mut tree.joints[index];
        (joint.stiffness, joint.damping) = spring_damper(inertia, values);
    }
}

/// Inertia of a hinge or slide in the reference pose: of all bodies beyond the joint, and of the
/// rotor.
fn inertia(tree: &Tree, index: usize) -> f64 {
    let joint = &tree.joints[index];
    // Poses in the frame of the body; bodies before it are not beyond the joint.
    let mut poses: Vec<Option<Pose>> = vec![None; tree.bodies.len()];
    poses[joint.body] = Some(Pose::IDENTITY);
    let mut parts = Vec::new();
    for (i, body) in tree.bodies.iter().enumerate().skip(joint.body) {
        if i > joint.body {
            let own = Pose { position: body.position, rotation: body.rotation };
            poses[i] = poses[body.parent].map(|p| p.then(&own));
        }
        let Some(pose) = poses[i] else { continue };
        let turned = product(&pose.rotation, &matrix(body.inertia));
        parts.push(Part {
            mass: body.mass,
            centre: pose.point(body.centre),
            inertia: product(&turned, &transposed(&pose.rotation)),
        });
    }
    let all = together(&parts);
    let beyond = match joint.kind {
        JointKind::Hinge => {
            let arm = [0, 1, 2].map(|k| all.centre[k] - joint.point[k]);
            let along = dot(arm, joint.axis);
            dot(joint.axis, apply(&all.inertia, joint.axis))
                + all.mass * (dot(arm, arm) - along * along)
        }
        _ => all.mass,
    };
    beyond + joint.armature
}

//! Checks and corrections of masses, once the tree is complete.

use super::settings::Compiler;
use super::tree::Tree;
use crate::files::FileError;
use crate::mass::{flat, immovable, matrix, negative, principal, turned, unbalanced};
use crate::model::Body;

/// Corrects the masses as the compiler asks, and refuses those that cannot move.
pub(crate) fn finish(tree: &mut Tree) -> Result<(), FileError> {
    let compiler = tree.compiler;
    for (body, element) in tree.bodies.iter_mut().zip(&tree.elements).skip(1) {
        correct(body, compiler).map_err(|what| element.error(what))?;
    }
    if let Some(wanted) = compiler.total_mass {
        let total: f64 = tree.bodies.iter().map(|b| b.mass).sum();
        let factor = wanted / total.max(1e-15);
        for body in &mut tree.bodies {
            body.mass *= factor;
            body.inertia = body.inertia.map(|i| factor * i);
        }
    }
    match immovable(&tree.bodies, &tree.joints) {
        None => Ok(()),
        Some((body, what)) => Err(tree.elements[body].error(what)),
    }
}

/// Lower bounds of mass and principal moments, and the triangle inequality of moments.
fn correct(body: &mut Body, compiler: &Compiler) -> Result<(), &'static str> {
    if body.mass == 0.0 && compiler.least_mass > 0.0 {
        // MuJoCo would put the mass at the position of the body in its parent.
        return Err(
            "`boundmass` cannot give mass to a body without a centre of mass; add a geom or \
                    `inertial`",
        );
    }
    body.mass = body.mass.max(compiler.least_mass);
    let (moments, axes) = principal(&matrix(body.inertia));
    if negative(moments) {
        return Err("a principal moment of inertia is negative; correct the inertia");
    }
    let mut corrected = moments.map(|m| m.max(compiler.least_inertia));
    if unbalanced(corrected) {
        if !compiler.balance {
            return Err(
                "a principal moment of inertia exceeds the sum of the other two, which no \
                        body has; correct the inertia or set `balanceinertia`",
            );
        }
        corrected = [corrected.iter().sum::<f64>() / 3.0; 3];
    }
    // Keeps all digits of matrices that need no correction.
    if corrected != moments {
        body.inertia = flat(&turned(corrected, &axes));
    }
    Ok(())
}

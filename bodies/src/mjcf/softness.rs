//! Softness of constraints: `solref` and `solimp`.

use super::view::View;
use crate::files::FileError;
use crate::model::Softness;

/// Reads the softness from these two attributes.
pub(crate) fn softness(view: &View, solref: &str, solimp: &str) -> Result<Softness, FileError> {
    let default = Softness::default();
    let reference: [f64; 2] = view.fill(solref, default.reference)?;
    let impedance: [f64; 5] = view.fill(solimp, default.impedance)?;
    if (reference[0] > 0.0) != (reference[1] > 0.0) {
        return Err(view.error_at(
            solref,
            format!("`{solref}` must have two positive numbers, or two negative numbers"),
        ));
    }
    let [low, high, width, middle, power] = impedance;
    let unit = 0.0..=1.0;
    if !unit.contains(&low) || !unit.contains(&high) || !unit.contains(&middle) || width < 0.0 {
        return Err(view.error_at(
            solimp,
            format!(
                "`{solimp}`: impedances and midpoint must be in 0 to 1, and the width positive"
            ),
        ));
    }
    if power < 1.0 {
        return Err(view.error_at(solimp, format!("`{solimp}`: the power must be at least 1")));
    }
    Ok(Softness { reference, impedance })
}

//! Names of what has none in a file.

use crate::model::Model;
use std::collections::HashSet;

/// Gives the kind and the index as name to what has no name, or a name that came before.
pub(crate) fn fill(model: &mut Model) {
    kind("body", model.bodies.iter_mut().map(|b| &mut b.name));
    kind("joint", model.joints.iter_mut().map(|j| &mut j.name));
    kind("geom", model.shapes.iter_mut().map(|s| &mut s.name));
    kind("site", model.sites.iter_mut().map(|s| &mut s.name));
    kind("actuator", model.actuators.iter_mut().map(|a| &mut a.name));
}

fn kind<'m>(kind: &str, names: impl Iterator<Item = &'m mut String>) {
    let mut names: Vec<&mut String> = names.collect();
    let mut used = HashSet::new();
    let free: Vec<usize> = (0..names.len())
        .filter(|i| names[*i].is_empty() || !used.insert(names[*i].to_string()))
        .collect();
    for index in free {
        let mut name = format!("{kind}{index}");
        while used.contains(&name) {
            name.push('_');
        }
        *names[index] = name;
    }
}

//! Accelerations and steps against stored numbers of MuJoCo. `references/make.py` writes them.

use physgrad::{Inputs, System};
use physgrad_bodies::model::{Cone, Model};
use physgrad_bodies::{Bodies, files, models};
use serde::Deserialize;
use std::path::Path;

#[derive(Deserialize)]
struct File {
    references: Vec<Reference>,
}

#[derive(Deserialize)]
struct Reference {
    model: String,
    cone: String,
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    x: Vec<f64>,
    u: Vec<f64>,
    acceleration: Vec<f64>,
    next: Vec<f64>,
    contacts: usize,
}

fn references() -> Vec<(Model, Reference)> {
    let file: File = serde_json::from_str(include_str!("references/mujoco.json")).unwrap();
    let with_model = |reference: Reference| {
        let mut model = match models::text(&reference.model) {
            Some(text) => files::parse(text, "model").unwrap(),
            None => {
                let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/references/small");
                files::read(&folder.join(format!("{}.xml", reference.model))).unwrap()
            }
        };
        if reference.cone == "elliptic" {
            (model.options.cone, model.options.impedance_ratio) = (Cone::Elliptic, 2.0);
        }
        (model, reference)
    };
    file.references.into_iter().map(with_model).collect()
}

/// Largest error, relative to the largest number.
fn error(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let largest = expected.iter().fold(1e-9_f64, |most, x| most.max(x.abs()));
    let worst = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    worst / largest
}

#[test]
fn accelerations_and_steps_are_those_of_mujoco() {
    let mut contacts = 0;
    for (model, Reference { model: name, cone, cases }) in references() {
        // Edges of a pyramid with the least friction, 1e-5, have weights of 1 / (2 mu²) = 5e9, which
        // magnify rounding by as much, in both programs.
        let allowed = if name == "ice" && cone == "pyramidal" { 1e-5 } else { 1e-8 };
        let bodies = Bodies::new(model).unwrap();
        for (i, case) in cases.iter().enumerate() {
            let inputs = Inputs::new(&case.x, &case.u);
            let (acceleration, _) = bodies.accelerations(inputs);
            let found = error(&acceleration, &case.acceleration);
            assert!(found <= allowed, "{name}, {cone}, case {i}: acceleration, error {found:e}");
            let mut next = vec![0.0; bodies.state_dim()];
            bodies.step(inputs, &mut next);
            let found = error(&next, &case.next);
            assert!(found <= allowed, "{name}, {cone}, case {i}: step, error {found:e}");
            contacts += case.contacts;
        }
    }
    assert!(contacts > 50, "only {contacts} contacts");
}

#[test]
fn contact_forces_are_those_of_newtons_law() {
    let ball = |x: f64, z: f64, mass: f64| {
        format!(
            "<body pos='{x} 0 {z}'><freejoint/><geom size='0.1' mass='{mass}' condim='3'/></body>"
        )
    };
    let text = format!(
        "<mujoco><worldbody><geom type='plane' size='1 1 1' condim='3'/>{}{}</worldbody></mujoco>",
        ball(0.0, 0.0995, 2.0),
        ball(0.15, 0.2314, 0.5)
    );
    let bodies = Bodies::new(files::parse(&text, "balls").unwrap()).unwrap();
    let mut x = bodies.reference().to_vec();
    x.extend([0.1, 0.0, -0.2, 0.0, 0.0, 0.0, -0.2, 0.3, -0.1, 0.5, 0.0, 0.0]);
    let inputs = Inputs::new(&x, &[]);
    let (a, _) = bodies.accelerations(inputs);
    let forces = bodies.contact_forces(inputs);
    assert_eq!(forces.iter().map(|force| force.body).collect::<Vec<_>>(), [1, 2], "{forces:?}");
    let [floor, upper] = [forces[0].force, forces[1].force];
    for (i, gravity) in [0.0, 0.0, 9.81].into_iter().enumerate() {
        // The lower ball pushes the upper one, and is pushed as much.
        let on_lower = 2.0 * (a[i] + gravity);
        let on_upper = 0.5 * (a[6 + i] + gravity);
        assert!((on_lower - floor[i] + upper[i]).abs() < 1e-9, "{i}: {on_lower}, {forces:?}");
        assert!((on_upper - upper[i]).abs() < 1e-9, "{i}: {on_upper}, {forces:?}");
    }
    assert!(floor[2] > 1.0 && upper[2] > 0.1 && upper[1] < 0.0, "friction brakes: {forces:?}");
    let between = forces[1].point;
    let expected = [0.075, 0.0, 0.5 * (0.0995 + 0.2314)];
    assert!(between.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{between:?}");
}

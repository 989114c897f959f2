//! Evaluates a model at states from standard input, for comparisons with other engines.
//!
//! Usage: `evaluate MODEL.xml accelerations|step|vjp [SETTING ...]`. Settings: `smooth` (no
//! constraints), `euler`, `implicitfast`, `rk4`. Numbers are doubles in binary. Input per case:
//! positions, velocities, controls, and for `vjp` the cotangent of the next state. Output per case:
//! accelerations and the iterations of the solver; the next state; the cotangents of state and
//! controls.

use physgrad::{Cotangents, Inputs, System};
use physgrad_bodies::model::{Integrator, Model};
use physgrad_bodies::{Bodies, files};
use std::io::{Read, Write};
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, path, what, settings @ ..] = &arguments[..] else {
        return Err("usage: evaluate MODEL.xml WHAT [SETTING ...]".into());
    };
    let mut model = files::read(Path::new(path))?;
    for setting in settings {
        set(&mut model, setting)?;
    }
    let bodies = Bodies::new(model)?;
    let length = bodies.state_dim() * if what == "vjp" { 2 } else { 1 } + bodies.control_dim();
    if length == 0 {
        return Err("the model has no joints".into());
    }
    let mut bytes = Vec::new();
    std::io::stdin().read_to_end(&mut bytes)?;
    let numbers: Vec<f64> =
        bytes.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect();
    let results: Vec<f64> =
        numbers.chunks_exact(length).flat_map(|case| evaluate(&bodies, what, case)).collect();
    let bytes: Vec<u8> = results.iter().flat_map(|x| x.to_le_bytes()).collect();
    Ok(std::io::stdout().write_all(&bytes)?)
}

fn set(model: &mut Model, setting: &str) -> Result<(), String> {
    match setting {
        "smooth" => {
            (model.options.contacts, model.options.limits) = (false, false);
            model.joints.iter_mut().for_each(|joint| joint.friction_loss = 0.0);
        }
        "euler" => model.options.integrator = Integrator::Euler,
        "implicitfast" => model.options.integrator = Integrator::ImplicitFast,
        "rk4" => model.options.integrator = Integrator::Rk4,
        _ => return Err(format!("`{setting}` is not a setting")),
    }
    Ok(())
}

fn evaluate(bodies: &Bodies, what: &str, case: &[f64]) -> Vec<f64> {
    let (n, m) = (bodies.state_dim(), bodies.control_dim());
    let (x, rest) = case.split_at(n);
    let (u, bar) = rest.split_at(m);
    let inputs = Inputs::new(x, u);
    match what {
        "accelerations" => {
            let (mut a, iterations) = bodies.accelerations(inputs);
            a.push(iterations as f64);
            a
        }
        "step" => {
            let mut next = vec![0.0; n];
            bodies.step(inputs, &mut next);
            next
        }
        _ => {
            let mut bars = vec![0.0; n + m];
            let (x_bar, u_bar) = bars.split_at_mut(n);
            bodies.vjp(inputs, bar, Cotangents::of(x_bar, u_bar));
            bars
        }
    }
}

//! Evaluates a model at states from standard input, for comparisons with other engines.
//!
//! Usage: `evaluate MODEL.xml accelerations|step|vjp`. Numbers are doubles in binary. Input per case:
//! positions, velocities, controls, and for `vjp` the cotangent of the next state. Output per case:
//! accelerations and the iterations of the solver; the next state; the cotangents of state and
//! controls.

use physgrad::{Cotangents, Inputs, System};
use physgrad_bodies::{Bodies, files};
use std::io::{Read, Write};
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, path, what] = &arguments[..] else { return Err("usage: evaluate MODEL.xml WHAT".into()) };
    let bodies = Bodies::new(files::read(Path::new(path))?)?;
    let (n, m) = (bodies.state_dim(), bodies.control_dim());
    let length = n + m + if what == "vjp" { n } else { 0 };
    let mut bytes = Vec::new();
    std::io::stdin().read_to_end(&mut bytes)?;
    let numbers: Vec<f64> =
        bytes.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect();
    let mut out = Vec::new();
    for case in numbers.chunks_exact(length) {
        let (x, rest) = case.split_at(n);
        let (u, bar) = rest.split_at(m);
        let inputs = Inputs::new(x, u);
        match what.as_str() {
            "accelerations" => {
                let (a, iterations) = bodies.accelerations(inputs);
                out.extend(a);
                out.push(iterations as f64);
            }
            "step" => {
                let mut next = vec![0.0; n];
                bodies.step(inputs, &mut next);
                out.extend(next);
            }
            _ => {
                let (mut x_bar, mut u_bar) = (vec![0.0; n], vec![0.0; m]);
                bodies.vjp(inputs, bar, Cotangents::of(&mut x_bar, &mut u_bar));
                out.extend(x_bar);
                out.extend(u_bar);
            }
        }
    }
    let bytes: Vec<u8> = out.iter().flat_map(|x| x.to_le_bytes()).collect();
    Ok(std::io::stdout().write_all(&bytes)?)
}

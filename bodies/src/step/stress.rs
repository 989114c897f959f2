//! Finite results and iterations of the solver at random states, also wild ones.
//!
//! The variable `MODELS` names further files, and `STATES` the number of states of each:
//! `MODELS="a.xml b.xml" STATES=1000000 cargo test --release stress -- --nocapture`.

use super::{Bar, Buffers};
use crate::model::{Cone, Integrator, Model};
use crate::tree::{Coefficient, Kind, Tree};
use crate::{files, mjcf, solver};
use physgrad::scalar::Lanes;
use physgrad::{Cotangent, Cotangents, Float, Inputs, Real, Scalar};
use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};
use std::path::Path;

/// Iterations of the solver for eight lanes at once.
#[derive(Default)]
struct Count {
    most: usize,
    sum: usize,
    /// How often the solver ended by its limit.
    limited: usize,
}

/// A state that is typical, fast, deep in the ground, or both.
fn state(tree: &Tree, rng: &mut SmallRng) -> Vec<f64> {
    let kind = rng.random_range(0..4);
    let (speed, depth) = ([3.0, 300.0][kind % 2], [0.0, 1.0][kind / 2]);
    let mut normal =
        |scale: f64| (0..6).map(|_| rng.random_range(-1.0..1.0)).sum::<f64>() * 0.7 * scale;
    let mut x: Vec<f64> = tree.reference.iter().map(|q| q + normal(0.7)).collect();
    let up = tree.dofs.iter().find(|dof| dof.kind == Kind::Slide && dof.axis[2] > 0.9);
    if let Some(dof) = up {
        x[dof.q] -= depth;
    }
    x.extend((0..tree.nv()).map(|_| normal(speed)));
    x
}

/// Steps and reverse derivatives at random states.
fn run<F: Float>(tree: &Tree, packs: usize) -> Count
where
    Lanes<F, 8>: Real<Real = F>,
{
    let mut rng = SmallRng::seed_from_u64(0);
    let (n, m) = (tree.nq + tree.nv(), tree.motors.len());
    let (mut buffers, mut bars) = (Buffers::<Lanes<F, 8>>::default(), Bar::default());
    let mut random = vec![Lanes::<F, 8>::zero(); 2 * n + m];
    let (mut next, mut count) = (vec![Lanes::zero(); n], Count::default());
    for _ in 0..packs {
        for lane in 0..8 {
            let mut one = state(tree, &mut rng);
            one.extend((0..m + n).map(|_| rng.random_range(-2.0..2.0)));
            random.iter_mut().zip(one).for_each(|(x, one)| x.set_lane(lane, F::from_f64(one)));
        }
        let (x, rest) = random.split_at(n);
        let (u, bar) = rest.split_at(m);
        let (mut x_bar, mut u_bar) = (vec![Lanes::null(); n], vec![Lanes::null(); m]);
        buffers.step(tree, Inputs::new(x, u), &mut next);
        let inputs = Inputs::new(x, u);
        bars.vjp(&mut buffers, tree, inputs, bar, Cotangents::of(&mut x_bar, &mut u_bar));
        for (what, list) in
            [("step", &next), ("vjp by states", &x_bar), ("vjp by controls", &u_bar)]
        {
            assert!(list.iter().all(Real::is_finite), "{what} {list:?} at {x:?}, {u:?}");
        }
        let iterations = buffers.stages[0].work.iterations;
        count.most = count.most.max(iterations);
        count.sum += iterations;
        count.limited += usize::from(iterations == solver::ITERATIONS);
    }
    count
}

#[test]
fn random_states_have_finite_results() {
    let packs = std::env::var("STATES").map_or(4000, |n| n.parse::<usize>().unwrap()) / 8;
    let files = std::env::var("MODELS").unwrap_or_default();
    let robot = mjcf::parse(include_str!("../../tests/robot.xml"), "robot.xml").unwrap();
    let elliptic = |mut model: Model| {
        model.options.cone = Cone::Elliptic;
        model
    };
    let mut models = vec![robot.clone(), elliptic(robot)];
    for file in files.split_whitespace() {
        let mut model = files::read(Path::new(file)).unwrap();
        model.options.integrator = Integrator::Euler;
        models.push(model.clone());
        models.push(elliptic(model));
    }
    for model in models {
        let name = format!("{}, {:?}", model.name, model.options.cone);
        let tree = Tree::new(&model, &|_, value| Coefficient { value, entry: None }).unwrap();
        for (precision, count) in
            [("f32", run::<f32>(&tree, packs)), ("f64", run::<f64>(&tree, packs))]
        {
            let mean = count.sum as f64 / packs as f64;
            println!(
                "{name}, {precision}: {packs} packs of 8, iterations {mean:.2}, most {}, at the limit {}",
                count.most, count.limited
            );
            assert!(
                count.limited * 1000 <= packs,
                "{name}, {precision}: {} of {packs} packs",
                count.limited
            );
        }
    }
}

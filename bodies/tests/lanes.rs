//! Lanes against single numbers, and memory.

use allocation_counter::measure;
use physgrad::scalar::{Lanes, Single};
use physgrad::{Cotangent, Cotangents, Float, Inputs, Real, Scalar, System};
use physgrad_bodies::model::{Cone, Integrator, Model};
use physgrad_bodies::{Bodies, mjcf};
use rand::{RngExt, SeedableRng, rngs::SmallRng};

fn robot() -> Model {
    mjcf::parse(include_str!("robot.xml"), "robot.xml").unwrap()
}

/// A random state around the reference pose with the root at a random height: about half of the
/// states have contacts.
fn state(bodies: &Bodies, rng: &mut SmallRng) -> Vec<f64> {
    let mut x: Vec<f64> =
        bodies.reference().iter().map(|q| q + rng.random_range(-0.5..0.5)).collect();
    x[2] = rng.random_range(0.1..1.2);
    x.extend((0..bodies.velocities()).map(|_| rng.random_range(-3.0..3.0)));
    x
}

/// The next state, and the cotangents of state and controls for the cotangent 1, 2, 3, ...
fn results<R: Real>(bodies: &Bodies, x: &[R], u: &[R]) -> Vec<R> {
    let mut next = vec![R::zero(); x.len()];
    bodies.step(Inputs::new(x, u), &mut next);
    let bar: Vec<R> = (0..x.len()).map(|i| R::from(i as f64 + 1.0)).collect();
    let (mut x_bar, mut u_bar) = (vec![R::null(); x.len()], vec![R::null(); u.len()]);
    bodies.vjp(Inputs::new(x, u), &bar, Cotangents::of(&mut x_bar, &mut u_bar));
    next.extend(x_bar.into_iter().chain(u_bar));
    next
}

/// Compares eight lanes with each of them alone; returns whether some but not all have contacts.
fn compare<F: Float, S: Real<Real = F>>(bodies: &Bodies, free: &Bodies, rng: &mut SmallRng) -> bool
where
    Lanes<F, 8>: Real<Real = F>,
{
    let (n, m) = (bodies.state_dim(), bodies.control_dim());
    let (mut x, mut u) = (vec![Lanes::<F, 8>::zero(); n], vec![Lanes::<F, 8>::zero(); m]);
    for lane in 0..8 {
        let one = state(bodies, rng);
        x.iter_mut().zip(&one).for_each(|(x, &one)| x.set_lane(lane, F::from_f64(one)));
        u.iter_mut().for_each(|u| u.set_lane(lane, F::from_f64(rng.random_range(-1.5..1.5))));
    }
    let all = results(bodies, &x, &u);
    let mut touching = 0;
    for lane in 0..8 {
        let single =
            |all: &[Lanes<F, 8>]| all.iter().map(|x| S::splat(x.lane(lane))).collect::<Vec<S>>();
        let (x, u) = (single(&x), single(&u));
        let alone = results(bodies, &x, &u);
        for (i, (a, b)) in all.iter().zip(&alone).enumerate() {
            let (a, b) = (a.lane(lane).to_f64(), b.lane(0).to_f64());
            assert_eq!(a.to_bits(), b.to_bits(), "entry {i} of lane {lane}: {a} and {b}");
        }
        let without = results(free, &x, &u);
        touching +=
            usize::from(alone[..n].iter().zip(&without).any(|(a, b)| a.lane(0) != b.lane(0)));
    }
    (1..8).contains(&touching)
}

#[test]
fn lanes_have_the_bits_of_single_numbers() {
    for (cone, integrator) in [
        (Cone::Pyramidal, Integrator::Euler),
        (Cone::Elliptic, Integrator::Rk4),
        (Cone::Elliptic, Integrator::ImplicitFast),
    ] {
        let mut model = robot();
        (model.options.cone, model.options.integrator) = (cone, integrator);
        let bodies = Bodies::new(model.clone()).unwrap();
        model.options.contacts = false;
        let free = Bodies::new(model).unwrap();
        let mut rng = SmallRng::seed_from_u64(0);
        let mut mixed = 0;
        for _ in 0..200 {
            mixed += usize::from(compare::<f64, f64>(&bodies, &free, &mut rng));
            mixed += usize::from(compare::<f32, Single<f32>>(&bodies, &free, &mut rng));
        }
        assert!(mixed > 300, "{mixed} of 400 draws have contacts in some lanes only");
    }
}

#[test]
fn results_do_not_depend_on_earlier_calls_or_the_thread() {
    // All share the buffers of a thread. Two have as many degrees of freedom as the first.
    let models = [(true, Cone::Pyramidal), (false, Cone::Pyramidal), (true, Cone::Elliptic)].map(
        |(damps, cone)| {
            let mut model = robot();
            model.options.cone = cone;
            if !damps {
                model.joints.iter_mut().for_each(|joint| joint.damping = 0.0);
            }
            Bodies::new(model).unwrap()
        },
    );
    let mut rng = SmallRng::seed_from_u64(2);
    for i in 0..300 {
        let bodies = &models[i % 3];
        let (x, u) = (state(bodies, &mut rng), vec![0.5; bodies.control_dim()]);
        let here = results::<f64>(bodies, &x, &u);
        let there = std::thread::scope(|scope| {
            scope.spawn(|| results::<f64>(bodies, &x, &u)).join().unwrap()
        });
        assert_eq!(here, there, "state {i}");
    }
}

#[test]
fn steps_do_not_allocate_after_the_first() {
    let bodies = Bodies::new(robot()).unwrap();
    let mut rng = SmallRng::seed_from_u64(1);
    let mut x: Vec<Lanes<f32, 8>> = state(&bodies, &mut rng).into_iter().map(Lanes::from).collect();
    let u = vec![Lanes::from(0.5); bodies.control_dim()];
    let mut next = x.clone();
    let bar = x.clone();
    let (mut x_bar, mut u_bar) = (x.clone(), u.clone());
    let mut run = |x: &[Lanes<f32, 8>]| {
        bodies.step(Inputs::new(x, &u), &mut next);
        bodies.vjp(Inputs::new(x, &u), &bar, Cotangents::of(&mut x_bar, &mut u_bar));
    };
    // High above the ground first: contacts come later.
    x[2] = Lanes::from(9.0);
    run(&x);
    for height in [0.3, 0.1, -0.2] {
        x[2] = Lanes::from(height);
        assert_eq!(measure(|| run(&x)).count_total, 0, "at the height {height}");
    }
}

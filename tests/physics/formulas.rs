//! Physics against independent formulas: steps, energies, costs, ranges of initial states,
//! defaults.
//!
//! The tests use none of the library's equations. Mechanics uses d'Alembert's principle for point
//! masses, quantum mechanics a dense matrix. They therefore detect constants that are wrong in
//! forward and reverse pass alike. `tests/mutations/README.md` measures this.

use physgrad::policy::{Conv, Linear};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::tasks::*;
use physgrad::{
    Actuated, Actuator, AnyActuator, Cotangent, Cotangents, Delay, Effect, Forced, ForcedSystem, Inputs, Lag, Limit, LimitKind,
    Ode, Real, Scalar, Start, System, Task, check,
};
use rand::RngExt;
use std::f64::consts::{FRAC_PI_6, PI, TAU};
use std::ops::{Add, Mul, Sub};

/// Rounding error of numbers of magnitude 1 over the few hundred operations of a step.
const ROUNDING: f64 = 1e-11;

#[track_caller]
fn near(what: &str, found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!((found - expected).abs() <= ROUNDING * expected.abs().max(1.0), "{what}, {i}: {found} is not {expected}");
    }
}

/// Returns a hundred states with `n` components and controls with `m`, within ±3.
fn states(n: usize, m: usize) -> impl Iterator<Item = (Vec<f64>, Vec<f64>)> {
    let mut rng = stream(0, Purpose::Test, 0);
    let mut draw = move |len: usize| (0..len).map(|_| rng.random_range(-3.0..3.0)).collect::<Vec<f64>>();
    (0..100).map(move |_| (draw(n), draw(m)))
}

fn step<S: System>(system: &S, x: &[f64], u: &[f64]) -> Vec<f64> {
    let mut next = vec![f64::NAN; x.len()];
    system.step(at(x, u, &vec![PHASE; system.param_dim()]), &mut next);
    next
}

/// Number of the step, and value of every parameter, in [`step`].
const STEP: usize = 3;
const PHASE: f64 = 0.37;

fn at<'a>(x: &'a [f64], u: &'a [f64], p: &'a [f64]) -> Inputs<'a, f64> {
    Inputs { x, u, p, t: STEP }
}

/// Returns the Jacobian of a function at `at` by central differences: `out[i]` is the derivative
/// with respect to component `i`.
fn slopes(of: impl Fn(&[f64]) -> Vec<f64>, at: &[f64]) -> Vec<Vec<f64>> {
    const WIDTH: f64 = 1e-5;
    let beside = |i: usize, by: f64| {
        let mut at = at.to_vec();
        at[i] += by;
        of(&at)
    };
    let slope = |i: usize| {
        let (after, before) = (beside(i, WIDTH), beside(i, -WIDTH));
        after.iter().zip(before).map(|(after, before)| (after - before) / (2.0 * WIDTH)).collect()
    };
    (0..at.len()).map(slope).collect()
}

/// Compares derivatives. The tolerance covers the error of central differences for third
/// derivatives of up to 1e5.
#[track_caller]
fn near_slopes(what: &str, found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!((found - expected).abs() <= 1e-5 * expected.abs().max(1.0), "{what}, slope {i}: {found} is not {expected}");
    }
}

/// Checks that the step equals `expected`, and that its derivatives are those of the step and of
/// `expected`.
#[track_caller]
fn steps_as<S: System>(what: &str, system: &S, expected: impl Fn(&[f64], &[f64]) -> Vec<f64>) {
    let (n, m) = (system.state_dim(), system.control_dim());
    for (x, u) in states(n, m) {
        near(what, &step(system, &x, &u), &expected(&x, &u));
    }
    for (x, u) in states(n, m).take(8) {
        let bar: Vec<f64> = (0..n).map(|i| 0.3 + 0.1 * i as f64).collect();
        let (mut x_bar, mut u_bar) = (vec![0.0; n], vec![0.0; m]);
        system.vjp(at(&x, &u, &vec![PHASE; system.param_dim()]), &bar, Cotangents::of(&mut x_bar, &mut u_bar));
        let pulled = |next: Vec<f64>| vec![next.iter().zip(&bar).map(|(next, bar)| next * bar).sum()];
        let by_slopes = slopes(|xu| pulled(expected(&xu[..n], &xu[n..])), &[x, u].concat()).concat();
        near_slopes(what, &[x_bar, u_bar].concat(), &by_slopes);
    }
    let lively = |rng: &mut Rng, x: &mut [f64], u: &mut [f64], p: &mut [f64]| {
        x.iter_mut().chain(u).chain(p).for_each(|x| *x = rng.random_range(-3.0..3.0));
    };
    check::try_system_at(system, lively).unwrap_or_else(|mismatch| panic!("{what}: {mismatch}"));
}

/// Gaussian elimination with partial pivoting.
fn solve<T: Number>(mut a: Vec<Vec<T>>, mut b: Vec<T>) -> Vec<T> {
    let n = b.len();
    for i in 0..n {
        let pivot = (i..n).max_by(|&j, &k| a[j][i].size().total_cmp(&a[k][i].size())).expect("a row");
        a.swap(i, pivot);
        b.swap(i, pivot);
        let row = a[i].clone();
        for j in i + 1..n {
            let share = a[j][i] * row[i].inverse();
            for (entry, &above) in a[j][i..].iter_mut().zip(&row[i..]) {
                *entry = *entry - share * above;
            }
            b[j] = b[j] - share * b[i];
        }
    }
    for i in (0..n).rev() {
        let rest = (i + 1..n).fold(b[i], |rest, k| rest - a[i][k] * b[k]);
        b[i] = rest * a[i][i].inverse();
    }
    b
}

trait Number: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    fn size(self) -> f64;
    fn inverse(self) -> Self;
}

impl Number for f64 {
    fn size(self) -> f64 {
        self.abs()
    }
    fn inverse(self) -> f64 {
        1.0 / self
    }
}

// Mechanics.

/// Point mass at `(cart q₀ + Σ arms_k sin θ_k, Σ arms_k cos θ_k)`. With a cart, its position
/// precedes the angles.
struct Point {
    mass: f64,
    arms: Vec<f64>,
}

/// Point masses on massless rods, with or without a cart.
struct Mechanism {
    points: Vec<Point>,
    cart: bool,
    gravity: f64,
}

impl Mechanism {
    /// Returns `∂position/∂q_i` of a point.
    fn slope(&self, point: &Point, i: usize, q: &[f64]) -> [f64; 2] {
        match (self.cart, i) {
            (true, 0) => [1.0, 0.0],
            _ => {
                let arm = point.arms[i - usize::from(self.cart)];
                [arm * q[i].cos(), -arm * q[i].sin()]
            }
        }
    }

    /// d'Alembert's principle: `Σ m J_i · (J q̈ + dJ/dt q̇ - g) = Q_i`.
    fn accelerations(&self, x: &[f64], applied: &[f64]) -> Vec<f64> {
        let (q, speed): (Vec<f64>, Vec<f64>) = x.chunks_exact(2).map(|pair| (pair[0], pair[1])).unzip();
        let (n, first) = (q.len(), usize::from(self.cart));
        let (mut matrix, mut right) = (vec![vec![0.0; n]; n], applied.to_vec());
        for point in &self.points {
            let j: Vec<[f64; 2]> = (0..n).map(|i| self.slope(point, i, &q)).collect();
            let mut outward = [0.0, self.gravity];
            for i in first..n {
                let spin = point.arms[i - first] * speed[i] * speed[i];
                outward[0] -= spin * q[i].sin();
                outward[1] -= spin * q[i].cos();
            }
            for a in 0..n {
                right[a] -= point.mass * (j[a][0] * outward[0] + j[a][1] * outward[1]);
                for b in 0..n {
                    matrix[a][b] += point.mass * (j[a][0] * j[b][0] + j[a][1] * j[b][1]);
                }
            }
        }
        solve(matrix, right)
    }

    fn energy(&self, x: &[f64]) -> f64 {
        let (q, speed): (Vec<f64>, Vec<f64>) = x.chunks_exact(2).map(|pair| (pair[0], pair[1])).unzip();
        let of_point = |point: &Point| {
            let (mut v, mut height) = ([0.0; 2], 0.0);
            for (i, speed) in speed.iter().enumerate() {
                let slope = self.slope(point, i, &q);
                v = [v[0] + slope[0] * speed, v[1] + slope[1] * speed];
            }
            for (arm, theta) in point.arms.iter().zip(&q[usize::from(self.cart)..]) {
                height += arm * theta.cos();
            }
            point.mass * (0.5 * (v[0] * v[0] + v[1] * v[1]) + self.gravity * height)
        };
        self.points.iter().map(of_point).sum()
    }
}

/// Returns point masses equivalent to a uniform rod: a sixth of its mass at either end and the rest
/// in the middle have its mass, center and inertia.
fn rod(mass: f64, half_length: f64, base: &[f64], of_poles: usize, pole: usize) -> impl Iterator<Item = Point> {
    [(1.0 / 6.0, 0.0), (4.0 / 6.0, 1.0), (1.0 / 6.0, 2.0)].into_iter().map(move |(share, place)| {
        let mut arms = base.to_vec();
        arms.resize(of_poles, 0.0);
        arms[pole] = place * half_length;
        Point { mass: share * mass, arms }
    })
}

fn model(poles: usize) -> CartPoleSystem {
    CartPoleSystem { poles, cart_mass: 1.3.into(), pole_mass: 0.4.into(), half_length: 0.7.into(), gravity: 9.1.into(), dt: 0.02 }
}

/// Returns all poles on the cart, or chained end to end.
fn on_cart(model: &CartPoleSystem, chained: bool) -> Mechanism {
    let (poles, [cart_mass, pole_mass, half_length, gravity]) = (model.poles, model.nominal());
    let mut points = vec![Point { mass: cart_mass, arms: vec![0.0; poles] }];
    for pole in 0..poles {
        let base = vec![if chained { 2.0 * half_length } else { 0.0 }; pole];
        points.extend(rod(pole_mass, half_length, &base, poles, pole));
    }
    Mechanism { points, cart: true, gravity }
}

/// Updates speeds first, then positions with the new speeds.
fn semi_implicit(x: &[f64], accelerations: &[f64], dt: f64) -> Vec<f64> {
    let moved = |(pair, a): (&[f64], &f64)| [pair[0] + dt * (pair[1] + dt * a), pair[1] + dt * a];
    x.chunks_exact(2).zip(accelerations).flat_map(moved).collect()
}

/// Returns the accelerations of the authors' model. Each pole turns as if alone on the cart. ẍ
/// follows from the reactions of all poles and the mass of the cart and one pole.
fn uncoupled(model: &CartPoleSystem, x: &[f64], applied: &[f64]) -> Vec<f64> {
    let alone = on_cart(&CartPoleSystem { poles: 1, ..*model }, false);
    let moment = model.pole_mass.nominal() * model.half_length.nominal();
    let mut push = applied[0];
    let mut accelerations = vec![0.0];
    for (pole, torque) in x[2..].chunks_exact(2).zip(&applied[1..]) {
        let alpha = alone.accelerations(&[x[0], x[1], pole[0], pole[1]], &[applied[0], *torque])[1];
        push += moment * (pole[0].sin() * pole[1] * pole[1] - pole[0].cos() * alpha);
        accelerations.push(alpha);
    }
    accelerations[0] = push / (model.cart_mass.nominal() + model.pole_mass.nominal());
    accelerations
}

type Applied = fn(&CartPoleSystem, &[f64]) -> Vec<f64>;

/// Returns the drag of the wind w on cart and poles.
fn drag(model: &CartPoleSystem, w: f64, x: &[f64]) -> Vec<f64> {
    let mut forces = vec![0.05 * (w - x[1]).abs() * (w - x[1])];
    for pole in x[2..2 + 2 * model.poles].chunks_exact(2) {
        let across = (w - x[1]) * pole[0].cos() - model.half_length.nominal() * pole[1];
        let drag = 0.02 * across.abs() * across;
        forces[0] += drag * pole[0].cos();
        forces.push(drag * model.half_length.nominal());
    }
    forces
}

/// Returns all effects with distinct parameters, and the forces they apply.
fn on_cart_poles() -> Vec<(CartPoleEffect, Applied)> {
    fn on_cart(model: &CartPoleSystem, force: f64) -> Vec<f64> {
        let mut forces = vec![0.0; 1 + model.poles];
        forces[0] = force;
        forces
    }
    let bumper = |model: &CartPoleSystem, x: &[f64]| {
        let (side, depth) = (x[0].signum(), (x[0].abs() - 0.9).max(0.0));
        on_cart(model, -side * 40.0 * depth * (1.0 + 0.3 * side * x[1]).max(0.0))
    };
    vec![
        (PoleDamping { damping: 0.03.into() }.into(), |model, x| {
            (0..=model.poles).map(|i| if i == 0 { 0.0 } else { -0.03 * x[2 * i + 1] }).collect()
        }),
        (CartDamping { damping: 0.7.into() }.into(), |model, x| on_cart(model, -0.7 * x[1])),
        (DryFriction { force: 1.7.into(), smoothing: 1.9 }.into(), |model, x| on_cart(model, -1.7 * (x[1] / 1.9).tanh())),
        (SteadyWind { speed: 2.3.into(), cart_drag: 0.05.into(), pole_drag: 0.02.into() }.into(), |model, x| drag(model, 2.3, x)),
        (
            GustyWind { speed: 1.1.into(), gust: 1.9.into(), period: 1.7, cart_drag: 0.05.into(), pole_drag: 0.02.into() }.into(),
            |model, x| drag(model, 1.1 + 1.9 * (TAU * (STEP as f64 * model.dt + PHASE) / 1.7).sin(), x),
        ),
        (Bumpers { half_travel: 0.9, stiffness: 40.0.into(), damping: 0.3.into() }.into(), bumper),
    ]
}

/// Checks the step of a system under an effect, with the control acting on the cart.
#[track_caller]
fn cart_pole_steps_as<H: ForcedSystem<Model = CartPoleSystem> + Clone>(
    system: H,
    accelerations: impl Fn(&CartPoleSystem, &[f64], &[f64]) -> Vec<f64>,
) {
    let model = *system.model();
    for (effect, applied) in on_cart_poles() {
        let what = format!("{effect:?}");
        let next = |x: &[f64], u: &[f64]| {
            let mut forces = applied(&model, x);
            forces[0] += u[0];
            semi_implicit(x, &accelerations(&model, x, &forces), model.dt)
        };
        steps_as(&what, &Forced { system: system.clone(), effects: effect.clone() }, next);
        steps_as(&what, &Forced { system: system.clone(), effects: vec![effect.clone()] }, next);
        steps_as(&what, &EffectAlone { model, effect: effect.clone() }, |x, _| {
            let mut applied = applied(&model, x);
            applied.resize(x.len(), 0.0);
            applied
        });
        // Effects of statically known type may be fused into the loops of their system.
        if let CartPoleEffect::PoleDamping(effect) = effect {
            steps_as(&what, &Forced { system: system.clone(), effects: effect }, next);
        }
    }
}

/// Writes the forces of an effect to the first components of the next state.
struct EffectAlone<E> {
    model: CartPoleSystem,
    effect: E,
}

impl<E: Effect<CartPoleSystem>> System for EffectAlone<E> {
    fn state_dim(&self) -> usize {
        2 + 2 * self.model.poles
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn param_dim(&self) -> usize {
        self.effect.param_dim()
    }
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        next.fill(T::zero());
        self.effect.add_forces(&self.model, inputs.continuous(self.model.dt), &mut next[..1 + self.model.poles]);
    }
    fn vjp<R: Real, C: Cotangent<R>>(&self, inputs: Inputs<'_, R>, next_bar: &[C], cotangents: Cotangents<'_, C>) {
        self.effect.vjp(&self.model, inputs.continuous(self.model.dt), &next_bar[..1 + self.model.poles], cotangents);
    }
}

#[test]
fn poles_on_a_cart() {
    for poles in [1, 3] {
        cart_pole_steps_as(model(poles), uncoupled);
        let coupled = |model: &CartPoleSystem, x: &[f64], forces: &[f64]| on_cart(model, false).accelerations(x, forces);
        cart_pole_steps_as(CoupledCartPole(model(poles)), coupled);
        for (x, _) in states(2 + 2 * poles, 1) {
            near("energy", &[CoupledCartPole(model(poles)).energy(&x)], &[on_cart(&model(poles), false).energy(&x)]);
        }
    }
}

/// Compares drag, evaluated at the middle of the pole, with strip theory, as documented in
/// [`SteadyWind`].
#[test]
fn drag_at_the_middle_is_strip_theory_without_spin_and_half_of_it_without_wind() {
    let (model, c) = (model(1), 0.02);
    let l = model.half_length.nominal();
    // [D, τ] on an upright pole, without drag of the cart.
    let here = |wind: f64, spin: f64| {
        let mut forces = [0.0; 2];
        SteadyWind { speed: wind.into(), cart_drag: 0.0.into(), pole_drag: c.into() }.add_forces(
            &model,
            Inputs::new(&[0.0, 0.0, 0.0, spin], &[]).continuous(0.0),
            &mut forces,
        );
        forces
    };
    let strips = |wind: f64, spin: f64| {
        const STRIPS: usize = 100_000;
        let width = 2.0 * l / STRIPS as f64;
        (0..STRIPS).fold([0.0; 2], |[force, torque], i| {
            let s = (i as f64 + 0.5) * width;
            let drag = c / (2.0 * l) * width * (wind - s * spin).abs() * (wind - s * spin);
            [force + drag, torque + s * drag]
        })
    };
    // The sum over this many strips is accurate to 1e-9.
    let is = |found: f64, expected: f64| assert!((found / expected - 1.0).abs() < 1e-6, "{found} is not {expected}");
    for i in 0..2 {
        is(strips(3.0, 0.0)[i], here(3.0, 0.0)[i]);
        is(strips(0.0, 5.0)[i], here(0.0, 5.0)[i] * [4.0 / 3.0, 2.0][i]);
    }
    is(strips(0.0, 5.0)[1], -2.0 * c * l.powi(3) * 25.0);
    let slope = |torque: &dyn Fn(f64, f64) -> [f64; 2]| (torque(3.0, 1e-4)[1] - torque(3.0, -1e-4)[1]) / 2e-4;
    is(slope(&strips), -8.0 / 3.0 * c * l * l * 3.0);
    is(slope(&here), -2.0 * c * l * l * 3.0);
}

/// Checks the rates of an [`Ode`] whose positions and speeds alternate, and its energy.
#[track_caller]
fn moves_as<O: Ode + Copy>(what: &str, ode: O, energy: impl Fn(&[f64]) -> f64, mechanism: &Mechanism) {
    for (x, u) in states(ode.state_dim(), 1) {
        let mut applied = vec![0.0; x.len() / 2];
        applied[0] = u[0];
        let expected: Vec<f64> =
            mechanism.accelerations(&x, &applied).iter().zip(x.chunks_exact(2)).flat_map(|(a, pair)| [pair[1], *a]).collect();
        let mut rate = vec![f64::NAN; x.len()];
        ode.rate(Inputs::new(&x, &u).continuous(0.0), &mut rate);
        near(what, &rate, &expected);
        near(&format!("energy of a {what}"), &[energy(&x)], &[mechanism.energy(&x)]);
    }
    let passed = check::try_system(&physgrad::Integrated { ode, integrator: physgrad::SemiImplicit, dt: 0.02 });
    passed.unwrap_or_else(|mismatch| panic!("{what}: {mismatch}"));
}

#[test]
fn a_double_pendulum_is_two_point_masses() {
    let pendulum = DoublePendulum { masses: [1.3, 0.4], lengths: [0.7, 1.1], gravity: 9.1 };
    let points = vec![Point { mass: 1.3, arms: vec![0.7, 0.0] }, Point { mass: 0.4, arms: vec![0.7, 1.1] }];
    let mechanism = Mechanism { points, cart: false, gravity: 9.1 };
    moves_as("double pendulum", pendulum, |x| pendulum.energy(x), &mechanism);
}

#[test]
fn a_chain_is_rods_end_to_end() {
    for poles in [1, 2, 4] {
        let chain = PoleChain(model(poles));
        moves_as("chain", chain, |x| chain.energy(x), &on_cart(&model(poles), true));
    }
}

#[test]
fn linear_plants_are_a_spring_and_an_upright_pole() {
    // 1 kg, 1 N/m, 0.4 N s/m, steps of 0.1 s.
    let spring = Lqr::spring();
    steps_as("spring", spring.system(), |x, u| semi_implicit(x, &[u[0] - x[0] - 0.4 * x[1]], 0.1));
    // Equations linearized in θ, ω, F about 0.
    let [cart_mass, pole_mass, l, gravity] = CartPoleSystem::default().nominal();
    let dt = CartPoleSystem::default().dt;
    let (mass, moment, inertia) = (cart_mass + pole_mass, pole_mass * l, 4.0 / 3.0 * pole_mass * l * l);
    steps_as("upright pole", Lqr::upright_cart_pole().system(), |x, u| {
        let right = vec![u[0], moment * gravity * x[2]];
        semi_implicit(x, &solve(vec![vec![mass, moment], vec![moment, inertia]], right), dt)
    });
}

#[test]
fn a_block_slides_with_coulombs_friction() {
    let slider = SliderSystem { mass: 1.7, coefficient: 0.6, smoothing: 0.8, dt: 0.05, scheme: FrictionScheme::Explicit };
    // Newton's law with friction μ m g tanh(v / ε).
    let friction = |v: f64| 0.6 * 1.7 * 9.81 * (v / 0.8).tanh();
    steps_as("explicit", &slider, |x, u| semi_implicit(x, &[(u[0] - friction(x[1])) / 1.7], 0.05));
    let implicit = SliderSystem { scheme: FrictionScheme::Implicit, ..slider };
    steps_as("implicit", &implicit, |x, u| {
        // Friction at the new speed, found by bisection of an increasing function.
        let missing = |v: f64| v - x[1] - 0.05 * (u[0] - friction(v)) / 1.7;
        let (mut low, mut high) = (-100.0, 100.0);
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            if missing(middle) < 0.0 { low = middle } else { high = middle }
        }
        vec![x[0] + 0.05 * low, low]
    });
}

/// Returns position and speed of a body under constant acceleration.
fn fall(place: f64, speed: f64, acceleration: f64, time: f64) -> [f64; 2] {
    [place + speed * time + 0.5 * acceleration * time * time, speed + acceleration * time]
}

/// Returns the time at which a falling body reaches the ground.
fn landing(height: f64, speed: f64, acceleration: f64) -> f64 {
    2.0 * height / ((speed * speed - 2.0 * acceleration * height).sqrt() - speed)
}

#[test]
fn a_ball_falls_and_bounces() {
    let (mass, gravity, dt) = (0.7, 9.3, 0.1);
    let ball = |contact| BouncingBall { mass, gravity, contact, dt };
    let bouncing = ball(Contact::TimeOfImpact { restitution: 0.6 });
    let springy = ball(Contact::Penalty { stiffness: 30.0, damping: 0.2 });
    let mut landed = 0;
    for (x, u) in states(2, 1) {
        let acceleration = u[0] / mass - gravity;
        let height = 0.1 * x[0].abs();
        let time = landing(height, x[1], acceleration);
        let expected = if time < dt {
            landed += 1;
            let speed = -0.6 * (x[1] + acceleration * time);
            // Holds if the ball does not land again. Other cases have a negative height and are
            // skipped.
            fall(0.0, speed, acceleration, dt - time)
        } else {
            fall(height, x[1], acceleration, dt)
        };
        if expected[0] >= 0.0 {
            near("bounce", &step(&bouncing, &[height, x[1]], &u), &expected);
        }
        // The spring of the floor acts as in semi-implicit Euler. All other motion is free fall.
        let kick = dt / mass * 30.0 * (-x[0]).max(0.0) * (1.0 - 0.2 * x[1]).max(0.0);
        let [place, speed] = fall(x[0], x[1], acceleration, dt);
        near("spring", &step(&springy, &x, &u), &[place + dt * kick, speed + kick]);
    }
    assert!(landed > 20, "{landed}");
}

#[test]
fn two_bodies_hit_each_other() {
    let ([m1, m2], dt) = ([1.2, 0.5], 0.1);
    let pair = |contact| TwoBodies { masses: [m1, m2], contact_distance: 0.3, contact, dt };
    let elastic = pair(Contact::TimeOfImpact { restitution: 0.6 });
    let springy = pair(Contact::Penalty { stiffness: 30.0, damping: 0.2 });
    let mut hits = 0;
    for (x, u) in states(4, 1) {
        let push = u[0] / m1;
        let x = [x[0], x[0] + 0.3 + x[1].abs() * 0.2, x[2], x[3]];
        let (gap, speed) = (x[1] - x[0] - 0.3, x[3] - x[2]);
        let time = landing(gap, speed, -push);
        let [a, va] = fall(x[0], x[2], push, dt);
        let mut expected = [a, x[1] + dt * x[3], va, x[3]];
        if time > 0.0 && time < dt {
            hits += 1;
            let ([a, va], b) = (fall(x[0], x[2], push, time), x[1] + time * x[3]);
            // Momentum is conserved, and the bodies separate with 0.6 of their approach speed.
            let (center, separation) = ((m1 * va + m2 * x[3]) / (m1 + m2), 0.6 * (va - x[3]));
            let (after, other) = (center - m2 / (m1 + m2) * separation, center + m1 / (m1 + m2) * separation);
            let [a, va] = fall(a, after, push, dt - time);
            expected = [a, b + (dt - time) * other, va, other];
        }
        // Skips pairs that meet twice.
        if expected[1] - expected[0] >= 0.3 {
            near("hit", &step(&elastic, &x, &u), &expected);
        }
        let x = [x[0], x[0] + 0.1, x[2], x[3]];
        let force = 30.0 * 0.2 * (1.0 - 0.2 * (x[3] - x[2])).max(0.0);
        let [a, va] = fall(x[0], x[2], push, dt);
        let (back, on) = (dt * force / m1, dt * force / m2);
        near("spring", &step(&springy, &x, &u), &[a - dt * back, x[1] + dt * x[3] + dt * on, va - back, x[3] + on]);
    }
    assert!(hits > 5, "{hits}");
}

// Guidance.

type Pull = fn(usize, usize, [f64; 2], f64) -> [f64; 2];

/// Returns effects of pairs, with the acceleration of agent `k` due to agent `i` as a function of
/// `k`, `i`, their separation and the softened distance.
fn between() -> Vec<(GuidanceEffect, Pull)> {
    fn times(by: f64, [x, y]: [f64; 2]) -> [f64; 2] {
        [by * x, by * y]
    }
    vec![
        (Spread { strength: 0.7 }.into(), |k, i, r, d| times(if k < 2 && i < 2 { 0.7 / (d * d) } else { 0.0 }, r)),
        (Evade { strength: 3.1 }.into(), |k, i, r, d| times(if k >= 2 && i < 2 { 3.1 / (d * d) } else { 0.0 }, r)),
        (Drive { strength: 1.9 }.into(), |k, i, r, d| times(if k < 2 && i >= 2 { -1.9 / (d * d) } else { 0.0 }, r)),
        (Flock { strength: 0.8, distance: 1.4 }.into(), |k, i, r, d| {
            times(if k >= 2 && i >= 2 { -0.8 * (1.4 / d - 1.0) / d } else { 0.0 }, r)
        }),
    ]
}

/// Acceleration of agent `k` as a function of its state, independent of the other agents.
type Alone = fn(usize, &[f64]) -> [f64; 2];

fn alone() -> Vec<(GuidanceEffect, Alone)> {
    let obstacles = Obstacles { centers: vec![[0.5, -0.3], [-1.5, 1.0]], radius: 1.2, stiffness: 9.0 };
    vec![
        (Friction { drivers: 1.3, evaders: 3.7 }.into(), |k, x| {
            let friction = if k < 2 { 1.3 } else { 3.7 };
            [-friction * x[2], -friction * x[3]]
        }),
        (obstacles.into(), |_, x| {
            [[0.5, -0.3], [-1.5, 1.0]].iter().fold([0.0; 2], |sum, center| {
                let r = [x[0] - center[0], x[1] - center[1]];
                let far = (r[0] * r[0] + r[1] * r[1]).sqrt();
                let push = 9.0 * (1.2 - far).max(0.0) / (0.2 + far);
                [sum[0] + push * r[0], sum[1] + push * r[1]]
            })
        }),
        (Walls { half_width: 1.5, half_height: 0.8, stiffness: 7.0 }.into(), |_, x| {
            [(x[0], 1.5), (x[1], 0.8)].map(|(x, half)| -7.0 * x.signum() * (x.abs() - half).max(0.0))
        }),
    ]
}

#[test]
fn agents_in_the_plane() {
    let softening = 0.2;
    for center in [Center::Sum, Center::Mean] {
        let model = GuidanceSystem { drivers: 2, evaders: 3, center, softening, dt: 0.07 };
        // Explicit Euler with the drivers' steering and the accelerations of an effect.
        let next = |x: &[f64], u: &[f64], added: &dyn Fn(usize) -> [f64; 2]| -> Vec<f64> {
            let agents: Vec<&[f64]> = x.chunks_exact(4).collect();
            let share = if matches!(center, Center::Sum) { 1.0 } else { 1.0 / 3.0 };
            let herd = [0, 1].map(|axis| share * agents[2..].iter().map(|agent| agent[axis]).sum::<f64>());
            let moved = |(k, agent): (usize, &&[f64])| {
                let mut a = added(k);
                if k < 2 {
                    let (q, c) = ([agent[0] - herd[0], agent[1] - herd[1]], &u[2 * k..]);
                    a = [a[0] + c[0] * q[0] - c[1] * q[1], a[1] + c[0] * q[1] + c[1] * q[0]];
                }
                let [x, y, vx, vy] = [agent[0], agent[1], agent[2], agent[3]];
                [x + 0.07 * vx, y + 0.07 * vy, vx + 0.07 * a[0], vy + 0.07 * a[1]]
            };
            agents.iter().enumerate().flat_map(moved).collect()
        };
        for (effect, pull) in between() {
            steps_as(&format!("{effect:?}"), &Forced { system: model, effects: effect }, |x, u| {
                next(x, u, &|k| {
                    (0..5).filter(|&i| i != k).fold([0.0; 2], |sum, i| {
                        let r = [x[4 * k] - x[4 * i], x[4 * k + 1] - x[4 * i + 1]];
                        let pull = pull(k, i, r, softening + (r[0] * r[0] + r[1] * r[1]).sqrt());
                        [sum[0] + pull[0], sum[1] + pull[1]]
                    })
                })
            });
        }
        for (effect, alone) in alone() {
            let system = Forced { system: model, effects: effect.clone() };
            steps_as(&format!("{effect:?}"), &system, |x, u| next(x, u, &|k| alone(k, &x[4 * k..4 * k + 4])));
        }
    }
}

// Quantum control.

/// Complex number.
#[derive(Clone, Copy)]
struct Complex(f64, f64);

impl Add for Complex {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0 + other.0, self.1 + other.1)
    }
}
impl Sub for Complex {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self(self.0 - other.0, self.1 - other.1)
    }
}
impl Mul for Complex {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self(self.0 * other.0 - self.1 * other.1, self.0 * other.1 + self.1 * other.0)
    }
}
impl Number for Complex {
    fn size(self) -> f64 {
        self.0.hypot(self.1)
    }
    fn inverse(self) -> Self {
        let square = self.0 * self.0 + self.1 * self.1;
        Self(self.0 / square, -self.1 / square)
    }
}

type Matrix = Vec<Vec<Complex>>;
const GRID: usize = 7;
const LENGTH: f64 = 2.6;
const DT: f64 = 0.03;
const DX: f64 = LENGTH / (GRID + 1) as f64;

fn wave(x: &[f64]) -> Vec<Complex> {
    x.chunks_exact(2).map(|pair| Complex(pair[0], pair[1])).collect()
}

fn plain(psi: &[Complex]) -> Vec<f64> {
    psi.iter().flat_map(|psi| [psi.0, psi.1]).collect()
}

fn matrix(entry: impl Fn(usize, usize) -> Complex) -> Matrix {
    (0..GRID).map(|j| (0..GRID).map(|k| entry(j, k)).collect()).collect()
}

/// `dt H`: second difference and potential.
fn hamiltonian(potential: &[f64]) -> Matrix {
    matrix(|j, k| match j.abs_diff(k) {
        0 => Complex(DT * (2.0 / (DX * DX) + potential[j]), 0.0),
        1 => Complex(-DT / (DX * DX), 0.0),
        _ => Complex(0.0, 0.0),
    })
}

fn times(matrix: &Matrix, psi: &[Complex]) -> Vec<Complex> {
    let dot = |row: &Vec<Complex>| row.iter().zip(psi).fold(Complex(0.0, 0.0), |sum, (&entry, &psi)| sum + entry * psi);
    matrix.iter().map(dot).collect()
}

/// `(1 + i z/2 - tail z²)⁻¹ (1 - i z/2 - tail z²) ψ`.
fn rational(z: &Matrix, tail: f64, psi: &[Complex]) -> Vec<Complex> {
    let square: Matrix = (0..GRID).map(|j| times(z, &z.iter().map(|row| row[j]).collect::<Vec<_>>())).collect();
    let factor = |sign: f64| {
        matrix(|j, k| {
            let one = f64::from(u8::from(j == k));
            Complex(one, 0.0) + Complex(0.0, sign * 0.5) * z[j][k] - Complex(tail, 0.0) * square[k][j]
        })
    };
    solve(factor(1.0), times(&factor(-1.0), psi))
}

/// `exp(-i z) ψ` as 64 factors `exp(-i z / 64)`, each by its power series.
fn exponential(z: &Matrix, psi: &[Complex]) -> Vec<Complex> {
    (0..64).fold(psi.to_vec(), |psi, _| {
        let (mut sum, mut term) = (psi.clone(), psi);
        for n in 1..30 {
            let by = Complex(0.0, -1.0 / 64.0 / f64::from(n));
            term = times(z, &term).into_iter().map(|psi| by * psi).collect();
            sum = sum.iter().zip(&term).map(|(&sum, &term)| sum + term).collect();
        }
        sum
    })
}

/// V at the position ξ relative to the middle, for the probability density ρ.
type Potential = fn(f64, f64) -> f64;

fn potentials() -> Vec<(QuantumEffect, Potential)> {
    let table: Vec<f64> = (0..GRID).map(|j| 1.5 + DX * (j as f64 + 1.0)).collect();
    vec![
        (Harmonic { stiffness: 3.1, center: 0.2 }.into(), |xi, _| 3.1 * (xi - 0.2) * (xi - 0.2)),
        (Barrier { height: 4.3, width: 0.6, center: -0.3 }.into(), |xi, _| 4.3 / ((xi + 0.3) / 0.6).cosh().powi(2)),
        (DoubleWell { height: 2.7, separation: 1.3 }.into(), |xi, _| 2.7 * ((xi / 0.65) * (xi / 0.65) - 1.0).powi(2)),
        (Cubic { strength: 0.4 }.into(), |_, density| 0.4 * density),
        (Tabulated { values: table }.into(), |xi, _| 1.5 + xi + 0.5 * LENGTH),
    ]
}

#[test]
fn waves_in_a_box() {
    for control in [ControlShape::Tilt, ControlShape::Dipole] {
        let model = QuantumSystem { grid: GRID, length: LENGTH, dt: DT, control };
        let origin = if matches!(control, ControlShape::Tilt) { 0.0 } else { 0.5 * LENGTH };
        for (effect, potential) in potentials() {
            let at = |psi: &[Complex], u: &[f64]| -> Vec<f64> {
                let v = |(j, psi): (usize, &Complex)| {
                    let place = DX * (j as f64 + 1.0);
                    u[0] * (place - origin) + potential(place - 0.5 * LENGTH, (psi.0 * psi.0 + psi.1 * psi.1) / DX)
                };
                psi.iter().enumerate().map(v).collect()
            };
            let by = |tail: f64| {
                move |x: &[f64], u: &[f64]| {
                    let psi = wave(x);
                    plain(&rational(&hamiltonian(&at(&psi, u)), tail, &psi))
                }
            };
            let half_turn = |psi: Vec<Complex>, u: &[f64]| -> Vec<Complex> {
                let turned = |(&psi, v): (&Complex, f64)| {
                    let (sin, cos) = (-0.5 * DT * v).sin_cos();
                    Complex(cos, sin) * psi
                };
                psi.iter().zip(at(&psi, u)).map(turned).collect()
            };
            let strang = |x: &[f64], u: &[f64]| {
                let moved = exponential(&hamiltonian(&[0.0; GRID]), &half_turn(wave(x), u));
                plain(&half_turn(moved, u))
            };
            let what = format!("{effect:?}, {control:?}");
            let effects = || effect.clone();
            steps_as(&what, &Forced { system: model, effects: effects() }, by(0.0));
            steps_as(&what, &Forced { system: model, effects: vec![effects()] }, by(0.0));
            steps_as(&what, &Forced { system: Pade(model), effects: effects() }, by(1.0 / 12.0));
            steps_as(&what, &Forced { system: Strang::new(model), effects: effects() }, strang);
            // Effects of statically known type may be fused into the loops of their system.
            if let QuantumEffect::Cubic(effect) = effect {
                steps_as(&what, &Forced { system: model, effects: effect }, by(0.0));
                steps_as(&what, &Forced { system: Pade(model), effects: effect }, by(1.0 / 12.0));
                steps_as(&what, &Forced { system: Strang::new(model), effects: effect }, strang);
            }
            let edges = AbsorbingEdges { width: 0.7, strength: 4.0 };
            steps_as(&what, &Absorbing::new(Forced { system: model, effects: effects() }, edges), |x, u| {
                let mut next = by(0.0)(x, u);
                for j in 0..GRID {
                    let place = DX * (j as f64 + 1.0);
                    let depth = (0.7 - place.min(LENGTH - place)).max(0.0) / 0.7;
                    next[2 * j..2 * j + 2].iter_mut().for_each(|psi| *psi *= (-DT * 4.0 * depth * depth).exp());
                }
                next
            });
            steps_as(&what, &Renormalized { system: Forced { system: model, effects: effects() } }, |x, u| {
                let next = by(0.0)(x, u);
                let norm = next.iter().map(|psi| psi * psi).sum::<f64>().sqrt();
                next.iter().map(|psi| psi / norm).collect()
            });
        }
        for number in 1..=GRID {
            let sine =
                |j: usize| (2.0 / (GRID + 1) as f64).sqrt() * (PI * number as f64 * (j + 1) as f64 / (GRID + 1) as f64).sin();
            near("eigenstate", &model.eigenstate(number).collect::<Vec<_>>(), &(0..GRID).map(sine).collect::<Vec<_>>());
        }
    }
}

// Actuators.

#[test]
fn controls_reach_the_system_late_and_limited() {
    /// Returns a system that sums the outputs of the actuator.
    fn through<A: Actuator>(actuator: A) -> Actuated<Accumulator, A> {
        Actuated { system: Accumulator { dim: 1 }, actuator }
    }
    steps_as("smooth limit", &through(Limit { bound: 1.7, kind: LimitKind::Smooth }), |x, u| {
        vec![x[0] + 1.7 * (u[0] / 1.7).tanh()]
    });
    steps_as("hard limit", &through(Limit { bound: 1.7, kind: LimitKind::Hard }), |x, u| vec![x[0] + u[0].clamp(-1.7, 1.7)]);
    // Solution of df/dt = (u - f) / time after dt.
    let late = |x: &[f64], u: &[f64]| u[0] + (x[1] - u[0]) * (-0.05_f64 / 0.2).exp();
    steps_as("lag", &through(Lag::new(0.2, 0.05)), |x, u| vec![x[0] + late(x, u), late(x, u)]);
    steps_as("delay", &through(Delay { steps: 2 }), |x, u| vec![x[0] + x[1], x[2], u[0]]);
    let both = vec![AnyActuator::Limit(Limit { bound: 1.7, kind: LimitKind::Smooth }), AnyActuator::Lag(Lag::new(0.2, 0.05))];
    steps_as("both", &through(both), |x, u| {
        let late = late(x, &[1.7 * (u[0] / 1.7).tanh()]);
        vec![x[0] + late, late]
    });
}

// Tasks.

/// Checks running and terminal costs.
#[track_caller]
fn costs<T: Task>(what: &str, task: &T, on_the_way: impl Fn(&[f64], &[f64]) -> f64, last: impl Fn(&[f64]) -> f64) {
    let (n, m) = (task.system().state_dim(), task.system().control_dim());
    for (x, u) in states(n, m) {
        near(what, &[task.running_cost(Inputs::new(&x, &u), &x), task.terminal_cost(&x, &[])], &[on_the_way(&x, &u), last(&x)]);
        let (mut x_bar, mut u_bar, mut last_bar) = (vec![0.0; n], vec![0.0; m], vec![0.0; n]);
        task.running_cost_gradient(
            Inputs::new(&x, &u),
            &x,
            Cotangents { u: Some(&mut u_bar), ..Cotangents::default() },
            &mut x_bar,
        );
        task.terminal_cost_gradient(&x, &[], &mut last_bar, None);
        let by_slopes = slopes(|xu| vec![on_the_way(&xu[..n], &xu[n..])], &[&x[..], &u].concat()).concat();
        near_slopes(what, &[x_bar, u_bar].concat(), &by_slopes);
        near_slopes(what, &last_bar, &slopes(|x| vec![last(x)], &x).concat());
    }
}

/// As [`costs`], and checks the gradients of whole rollouts.
#[track_caller]
fn costs_of<T: Task>(what: &str, task: &T, on_the_way: impl Fn(&[f64], &[f64]) -> f64, last: impl Fn(&[f64]) -> f64) {
    costs(what, task, on_the_way, last);
    check::task(task, &Linear::new(task.system().state_dim(), task.system().control_dim()));
}

#[test]
fn every_task_has_its_price() {
    let none = |_: &[f64], _: &[f64]| 0.0;
    let height = |angles: &[f64]| angles.iter().map(|theta| 1.0 - theta.cos()).sum::<f64>() / angles.len() as f64;
    let swing = CartPole { horizon: 5, ..CartPole::with_system(model(2)) };
    costs_of("last angles", &swing, none, |x| height(&[x[2], x[4]]));
    let all = CartPole { loss: LossMode::Running, ..swing };
    costs_of("all angles", &all, |x, _| height(&[x[2], x[4]]) / 5.0, |_| 0.0);

    let upright = Upright { horizon: 5, control_weight: 0.3, ..Upright::double_pendulum() };
    costs_of("upright", &upright, |_, u| 0.3 * u[0] * u[0] / 2.0 / 5.0, |x| height(&[x[0], x[2]]));
    let held = Upright { loss: LossMode::Running, ..upright };
    costs_of("held", &held, |x, u| (height(&[x[0], x[2]]) + 0.3 * u[0] * u[0] / 2.0) / 5.0, |_| 0.0);
    let chain = Upright { horizon: 5, ..Upright::pole_chain(2) };
    costs_of("chain", &chain, none, |x| height(&[x[2], x[4]]));

    let herding = Guidance { horizon: 5, regularization: 0.7, loss: LossMode::Terminal, ..Guidance::new(2, 3) };
    let control_weight = |u: &[f64]| 0.7 * u.iter().map(|u| u * u).sum::<f64>() / 4.0 / 5.0;
    let away = |x: &[f64]| x[8..].chunks_exact(4).map(|agent| agent[0] * agent[0] + agent[1] * agent[1]).sum::<f64>() / 6.0;
    costs_of("herding", &herding, |_, u| control_weight(u), away);
    let always = Guidance { loss: LossMode::Running, ..herding };
    costs_of("herding always", &always, |x, u| control_weight(u) + away(x) / 5.0, |_| 0.0);

    let quantum = Quantum {
        horizon: 3,
        loss: LossMode::Terminal,
        ..Quantum::with_system(QuantumSystem { grid: GRID, ..Default::default() }, 2)
    };
    let missing = |x: &[f64]| {
        let phi: Vec<f64> = (1..=GRID).map(|j| 0.5 * (2.0 * PI * j as f64 / 8.0).sin()).collect();
        let part = |part: usize| phi.iter().zip(x.chunks_exact(2)).map(|(phi, psi)| phi * psi[part]).sum::<f64>();
        1.0 - part(0).powi(2) - part(1).powi(2)
    };
    costs("infidelity", &quantum, none, missing);
    check::task(&quantum, &Conv::new(GRID, 2));
    let every = Quantum { loss: LossMode::Running, ..quantum };
    costs("infidelity always", &every, |x, _| missing(x), |_| 0.0);
    check::task(&every, &Conv::new(GRID, 2));

    let slider = Slider { speed_weight: 0.3, horizon: 5, ..Slider::default() };
    costs_of("slider", &slider, none, |x| x[0] * x[0] + 0.3 * x[1] * x[1]);
    let bounce = Bounce { target: 1.4, horizon: 5, ..Bounce::default() };
    costs_of("bounce", &bounce, none, |x| (x[0] - 1.4) * (x[0] - 1.4));
    costs_of("push", &Push { horizon: 5, ..Push::default() }, none, |x| x[1] * x[1]);

    let reach = Reach { target: 1.4, ..Reach::default() };
    costs_of("reach", &reach, none, |x| (x[0] - 1.4) * (x[0] - 1.4) / 2.0);
    let bowl = Bowl { curvatures: [1.3, 3.1], angle: 0.4, ..Bowl::default() };
    costs_of("bowl", &bowl, none, |x| {
        let (sin, cos) = 0.4_f64.sin_cos();
        let (along, across) = (cos * x[0] + sin * x[1], cos * x[1] - sin * x[0]);
        (1.3 * along * along + 3.1 * across * across) / 2.0
    });

    // Integral of (|x|² + u²)/2. The terminal cost is the minimal remaining cost, by Riccati's
    // equation.
    for (mut lqr, dt) in [(Lqr::spring(), 0.1), (Lqr::upright_cart_pole(), 0.01)] {
        let price = |x: &[f64], u: &[f64]| dt * 0.5 * x.iter().chain(u).map(|x| x * x).sum::<f64>();
        lqr.horizon = 5;
        costs_of("regulator", &lqr, price, |x| {
            let gain = &lqr.optimum().gain;
            let u = [gain.iter().zip(x).map(|(gain, x)| gain * x).sum::<f64>()];
            let next = step(lqr.system(), x, &u);
            price(&next, &u) + lqr.terminal_cost(&next, &[])
        });
    }
}

/// Returns minimum and maximum of `of` over many initial states.
fn range<T: Task>(task: &T, of: impl Fn(&[f64]) -> f64) -> [f64; 2] {
    let mut rng = stream(0, Purpose::Train, 0);
    let (n, len) = (task.system().state_dim(), task.system().state_dim() + task.param_dim());
    let mut all = vec![0.0; len];
    (0..4000).fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], _| {
        all.fill(0.0);
        let (x, p) = all.split_at_mut(n);
        task.start(&mut rng, Start { x, p });
        [least.min(of(&all)), most.max(of(&all))]
    })
}

/// Checks bounds: 4000 draws come within 1 % of both ends with probability 1 - 2 · 0.99⁴⁰⁰⁰, and
/// never exceed them.
#[track_caller]
fn starts_within<T: Task>(what: &str, task: &T, low: f64, high: f64, of: impl Fn(&[f64]) -> f64) {
    let ([least, most], near) = (range(task, of), 0.01 * (high - low));
    assert!(least >= low && least < low + near, "{what} begins at {least}, not at {low}");
    assert!(most <= high && most > high - near, "{what} ends at {most}, not at {high}");
}

#[test]
fn rollouts_start_where_they_should() {
    let within = FRAC_PI_6;
    let swing = CartPole::new(1);
    for i in [0, 1, 3] {
        starts_within("cart", &swing, -1.0, 1.0, |x| x[i]);
    }
    starts_within("pole", &swing, PI - within, PI + within, |x| x[2]);
    let windy = Forced { system: model(1), effects: GustyWind { period: 1.7, ..GustyWind::default() } };
    starts_within("phase of the gusts", &CartPole::with_system(windy), 0.0, 1.7, |x| x[4]);
    starts_within("pendulum", &Upright::double_pendulum(), PI - within, PI + within, |x| x[2]);
    starts_within("rate", &Upright::double_pendulum(), -within, within, |x| x[3]);
    starts_within("held", &Upright::pole_chain(1).held(), -0.05, 0.05, |x| x[2]);
    starts_within("spring", &Lqr::spring(), -1.0, 1.0, |x| x[1]);
    starts_within("slider", &Slider::default(), -1.0, 1.0, |x| x[0]);
    starts_within("slider's speed", &Slider::default(), -2.0, 2.0, |x| x[1]);
    starts_within("ball", &Bounce::default(), 0.5, 1.5, |x| x[0]);
    starts_within("ball's speed", &Bounce::default(), -1.0, 1.0, |x| x[1]);
    starts_within("box", &Push::default(), -1.5, -0.5, |x| x[1]);
    starts_within("pusher's gap", &Push::default(), 0.1, 0.3, |x| x[1] - x[0] - 0.1);
    let herding = Guidance::new(1, 1);
    starts_within("driver", &herding, 3.0, 4.0, |x| x[0].hypot(x[1]));
    starts_within("driver's bearing", &herding, -PI, PI, |x| x[1].atan2(x[0]));
    assert_eq!(range(&Reach { start: 0.7, ..Reach::default() }, |x| x[0]), [0.7, 0.7]);
    // Bearings are uniformly distributed.
    evenly("driver's bearing", &herding, |x| x[1].atan2(x[0]));
    // Evaders are within half a metre of a common center.
    let many = Guidance::new(1, 40);
    let spread = range(&many, |x| {
        let xs: Vec<f64> = x[4..].chunks_exact(4).map(|agent| agent[0]).collect();
        xs.iter().fold(f64::MIN, |most, x| most.max(*x)) - xs.iter().fold(f64::MAX, |least, x| least.min(*x))
    });
    assert!(spread[1] <= 1.0 && spread[1] > 0.99, "{spread:?}");
    let center = range(&many, |x| {
        let mean = |axis: usize| x[4..].chunks_exact(4).map(|agent| agent[axis]).sum::<f64>() / 40.0;
        mean(0).hypot(mean(1))
    });
    // The mean of 40 is within 0.15 of the center: three standard deviations.
    assert!((center[0] - 1.0).abs() < 0.2 && (center[1] - 2.0).abs() < 0.2, "{center:?}");
    // Initial states mix the eigenstates 1 and 2 with any share from 0 to 1.
    let mixture = Quantum::new(3);
    let share = |number: usize, x: &[f64]| {
        let part = |part| mixture.system.eigenstate(number).zip(x.chunks_exact(2)).map(|(phi, psi)| phi * psi[part]).sum::<f64>();
        part(0).powi(2) + part(1).powi(2)
    };
    starts_within("ground state", &mixture, 0.0, 1.0, |x| share(1, x));
    let lopsided = Quantum { weighting: [2.0, 0.0], ..mixture };
    assert!(range(&lopsided, |x| share(1, x))[0] > 1.0 - ROUNDING);
    let [least, most] = range(&mixture, |x| share(1, x) + share(2, x));
    near("norm", &[least, most], &[1.0, 1.0]);
    // A negative amplitude shifts the phase by half a turn.
    evenly("phase", &lopsided, |x| 2.0 * x[1].atan2(x[0]));
}

/// Checks uniformity: the mean direction of 4000 uniform draws has norm 1/√4000 = 0.016. For a
/// range that is 10 % too long, it is 0.085.
#[track_caller]
fn evenly<T: Task>(what: &str, task: &T, angle: impl Fn(&[f64]) -> f64) {
    let (mut rng, mut sum) = (stream(0, Purpose::Train, 1), [0.0; 2]);
    for _ in 0..4000 {
        let mut x = vec![0.0; task.system().state_dim()];
        task.start(&mut rng, Start { x: &mut x, p: &mut [] });
        let (sin, cos) = angle(&x).sin_cos();
        sum = [sum[0] + cos, sum[1] + sin];
    }
    let length = sum[0].hypot(sum[1]) / 4000.0;
    assert!(length < 0.06, "{what}: the mean direction has a length of {length}");
}

/// Compares defaults with the documentation, the paper, and the authors' code.
#[test]
fn defaults_are_as_published() {
    #[track_caller]
    fn is<T: Default + PartialEq + std::fmt::Debug>(expected: T) {
        assert_eq!(T::default(), expected);
    }
    // Barto, Sutton and Anderson 1983, except for steps of 0.01 s.
    is(CartPoleSystem {
        poles: 1,
        cart_mass: 1.0.into(),
        pole_mass: 0.1.into(),
        half_length: 0.5.into(),
        gravity: 9.8.into(),
        dt: 0.01,
    });
    is(PoleDamping { damping: (2e-3).into() });
    is(CartDamping { damping: 0.1.into() });
    is(DryFriction { force: 0.5.into(), smoothing: 0.05 });
    is(SteadyWind { speed: 3.0.into(), cart_drag: 0.06.into(), pole_drag: 0.013.into() });
    is(GustyWind { speed: 3.0.into(), gust: 2.0.into(), period: 1.0, cart_drag: 0.06.into(), pole_drag: 0.013.into() });
    is(Bumpers { half_travel: 2.4, stiffness: 1e3.into(), damping: 0.5.into() });
    is(DoublePendulum { masses: [1.0, 1.0], lengths: [1.0, 1.0], gravity: 9.81 });
    // 60 steps in 4 s, and the forces of the authors' code.
    is(GuidanceSystem { drivers: 2, evaders: 4, center: Center::Sum, softening: 0.1, dt: 4.0 / 60.0 });
    is(Friction { drivers: 1.0, evaders: 4.0 });
    is(Spread { strength: 0.2 });
    is(Evade { strength: 15.0 });
    is(Flock { strength: 0.2, distance: 0.5 });
    is(Drive { strength: 0.2 });
    is(Obstacles { centers: vec![[1.0, 0.0], [-0.5, 0.85], [-0.5, -0.85]], radius: 0.5, stiffness: 10.0 });
    is(Walls { half_width: 6.0, half_height: 4.0, stiffness: 10.0 });
    // 128 steps in 8 units of time, a box of length 2.
    is(QuantumSystem { grid: 32, length: 2.0, dt: 8.0 / 128.0, control: ControlShape::Tilt });
    is(Harmonic { stiffness: 100.0, center: 0.0 });
    is(Barrier { height: 30.0, width: 0.1, center: 0.0 });
    is(DoubleWell { height: 30.0, separation: 1.2 });
    is(Cubic { strength: 5.0 });
    is(AbsorbingEdges { width: 0.2, strength: 10.0 });
    is(SliderSystem { mass: 1.0, coefficient: 0.5, smoothing: 1e-3, dt: 0.01, scheme: FrictionScheme::Implicit });
    let slider = Slider::default();
    assert_eq!((slider.speed_weight, slider.horizon), (0.1, 100));
    is(BouncingBall { mass: 1.0, gravity: 9.81, contact: Contact::TimeOfImpact { restitution: 0.8 }, dt: 0.01 });
    assert_eq!((Bounce::default().target, Bounce::default().horizon), (1.0, 100));
    let restitution = |restitution: f64| Contact::TimeOfImpact { restitution };
    assert_eq!(TwoBodies::balls(), TwoBodies { masses: [1.0, 1.0], contact_distance: 0.1, contact: restitution(1.0), dt: 0.01 });
    assert_eq!(TwoBodies::pusher(), TwoBodies { masses: [1.0, 2.0], contact_distance: 0.1, contact: restitution(0.0), dt: 0.01 });
    is(Reach { system: Accumulator { dim: 1 }, start: -0.3, target: 2.0, horizon: 4 });
    is(Bowl { system: Accumulator { dim: 2 }, curvatures: [1.0, 4.0], angle: FRAC_PI_6 });
    let (swing, chain) = (Upright::double_pendulum(), Upright::pole_chain(2));
    assert_eq!((swing.system.dt, swing.control_weight, chain.system.dt, chain.system.ode.0.poles), (0.01, 0.0, 0.01, 2));
    assert_eq!(swing.held().control_weight, 1e-3);
    assert_eq!((Guidance::new(1, 1).regularization, Quantum::new(3).weighting), (1.0, [1.0, 1.0]));
}

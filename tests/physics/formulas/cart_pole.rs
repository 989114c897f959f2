//! Cart-pole and its effects.

use super::mechanism::*;
use super::*;

/// Returns the accelerations of the authors' model: cart, then poles.
///
/// Each pole turns as if alone on the cart. The acceleration of the cart follows from the reactions
/// of all poles and the mass of the cart and one pole.
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

/// Forces of an effect on cart and poles, as a function of the state.
type Applied = fn(&CartPoleSystem, &[f64]) -> Vec<f64>;

/// Returns the forces of wind at the speed w, with drag coefficients of 0.05 (cart) and 0.02
/// (poles).
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

/// Returns all effects, with parameters that differ from the defaults, and their forces.
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
        (DryFriction { force: 1.7.into(), smoothing: 1.9 }.into(), |model, x| {
            on_cart(model, -1.7 * (x[1] / 1.9).tanh())
        }),
        (
            SteadyWind { speed: 2.3.into(), cart_drag: 0.05.into(), pole_drag: 0.02.into() }.into(),
            |model, x| drag(model, 2.3, x),
        ),
        (
            GustyWind {
                speed: 1.1.into(),
                gust: 1.9.into(),
                period: 1.7,
                cart_drag: 0.05.into(),
                pole_drag: 0.02.into(),
            }
            .into(),
            |model, x| {
                drag(model, 1.1 + 1.9 * (TAU * (STEP as f64 * model.dt + PHASE) / 1.7).sin(), x)
            },
        ),
        (Bumpers { half_travel: 0.9, stiffness: 40.0.into(), damping: 0.3.into() }.into(), bumper),
    ]
}

/// Compares steps under each effect with `accelerations`. The control acts on the cart.
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

/// System whose next state consists of the forces of an effect, followed by zeros.
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
        self.effect.add_forces(
            &self.model,
            inputs.continuous(self.model.dt),
            &mut next[..1 + self.model.poles],
        );
    }
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        self.effect.vjp(
            &self.model,
            inputs.continuous(self.model.dt),
            &next_bar[..1 + self.model.poles],
            cotangents,
        );
    }
}

#[test]
fn steps_of_cart_poles_with_each_effect_equal_their_formulas() {
    for poles in [1, 3] {
        cart_pole_steps_as(model(poles), uncoupled);
        let coupled = |model: &CartPoleSystem, x: &[f64], forces: &[f64]| {
            on_cart(model, false).accelerations(x, forces)
        };
        cart_pole_steps_as(CoupledCartPole(model(poles)), coupled);
        for (x, _) in states(2 + 2 * poles, 1) {
            near(
                "energy",
                &[CoupledCartPole(model(poles)).energy(&x)],
                &[on_cart(&model(poles), false).energy(&x)],
            );
        }
    }
}

/// Compares drag, evaluated at the middle of the pole, with strip theory, as documented in
/// [`SteadyWind`].
#[test]
fn drag_at_the_middle_equals_strip_theory_without_spin_and_has_half_its_torque_without_wind() {
    let (model, c) = (model(1), 0.02);
    let l = model.half_length.nominal();
    // Returns [drag, torque] of the library on an upright pole, without drag of the cart.
    let here = |wind: f64, spin: f64| {
        let mut forces = [0.0; 2];
        SteadyWind { speed: wind.into(), cart_drag: 0.0.into(), pole_drag: c.into() }.add_forces(
            &model,
            Inputs::new(&[0.0, 0.0, 0.0, spin], &[]).continuous(0.0),
            &mut forces,
        );
        forces
    };
    // Returns [drag, torque] as sums over strips of the pole.
    let strips = |wind: f64, spin: f64| {
        const STRIPS: usize = 100_000;
        let width = 2.0 * l / STRIPS as f64;
        (0..STRIPS).fold([0.0; 2], |[force, torque], i| {
            let s = (i as f64 + 0.5) * width;
            let drag = c / (2.0 * l) * width * (wind - s * spin).abs() * (wind - s * spin);
            [force + drag, torque + s * drag]
        })
    };
    // The sum over the strips is accurate to 1e-9.
    let is = |found: f64, expected: f64| {
        assert!((found / expected - 1.0).abs() < 1e-6, "{found} is not {expected}")
    };
    for i in 0..2 {
        is(strips(3.0, 0.0)[i], here(3.0, 0.0)[i]);
        is(strips(0.0, 5.0)[i], here(0.0, 5.0)[i] * [4.0 / 3.0, 2.0][i]);
    }
    is(strips(0.0, 5.0)[1], -2.0 * c * l.powi(3) * 25.0);
    let slope = |torque: &dyn Fn(f64, f64) -> [f64; 2]| {
        (torque(3.0, 1e-4)[1] - torque(3.0, -1e-4)[1]) / 2e-4
    };
    is(slope(&strips), -8.0 / 3.0 * c * l * l * 3.0);
    is(slope(&here), -2.0 * c * l * l * 3.0);
}

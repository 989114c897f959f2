//! Custom effect: cart-pole with an eddy-current brake on the cart.
//!
//! Run: `cargo run --release --example own_effect -- [epochs]`

use physgrad::count::OpCount;
use physgrad::prelude::*;
use physgrad::tasks::{CartPole, CartPoleSystem, PoleDamping};
use physgrad::{Cotangent, Cotangents, Effect, Forced, OdeInputs, Real, TrainError};

/// Magnet on the cart above a metal rail: F = -2 force s / (1 + s²), with `s = ẋ / speed`.
///
/// The force is viscous at low speed, largest at `speed`, and smaller beyond (Wouterse 1991, IEE
/// Proceedings B 138, 153).
#[derive(Clone, Copy, Debug)]
struct EddyBrake {
    /// Largest force, N.
    force: f64,
    /// Speed at which the force is largest, m/s.
    speed: f64,
}

/// [`CartPoleSystem`] defines states and forces: x = [x, ẋ, θ₁, ω₁, …], forces = [F, τ₁, …].
impl Effect<CartPoleSystem> for EddyBrake {
    fn add_forces<T: Scalar>(
        &self,
        _model: &CartPoleSystem,
        OdeInputs { x, .. }: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        let s = x[1] * (1.0 / self.speed);
        forces[0] -= s * (2.0 * self.force) / (s * s + 1.0);
    }
}

/// Brake with an analytic derivative: dF/dẋ = -2 force / speed · (1 - s²) / (1 + s²)².
#[derive(Clone, Copy, Debug)]
struct ByHand(EddyBrake);

impl Effect<CartPoleSystem> for ByHand {
    #[inline(always)]
    fn add_forces<T: Scalar>(
        &self,
        model: &CartPoleSystem,
        inputs: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        self.0.add_forces(model, inputs, forces);
    }
    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        _: &CartPoleSystem,
        inputs: OdeInputs<'_, R>,
        f_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let Some(x_bar) = cotangents.x else { return };
        let s = inputs.x[1] * R::from(1.0 / self.0.speed);
        let per_square = R::one() / (R::one() + s * s);
        x_bar[1] -= f_bar[0]
            * (R::from(2.0 * self.0.force / self.0.speed)
                * (R::one() - s * s)
                * per_square
                * per_square);
    }
}

fn main() -> Result<(), TrainError> {
    let epochs =
        std::env::args().nth(1).map_or(3, |text| text.parse().expect("a number of epochs"));
    let system = CartPoleSystem { poles: 2, ..CartPoleSystem::default() };
    let brake = EddyBrake { force: 5.0, speed: 1.0 };
    // Compares both derivatives with dual numbers, and panics if they differ.
    check::system(&Forced { system, effects: brake }).unwrap();
    check::system(&Forced { system, effects: ByHand(brake) }).unwrap();

    // Counts operations. Absent effects cost nothing.
    let (alone, by_duals) = (OpCount::of(&system), OpCount::of(&Forced { system, effects: brake }));
    let by_hand = OpCount::of(&Forced { system, effects: ByHand(brake) });
    for (pass, alone, with) in
        [("step", alone.step, by_hand.step), ("reverse", alone.vjp, by_hand.vjp)]
    {
        println!(
            "{pass:>8}: {} operations, with the brake {}: {}",
            alone.total(),
            with.total(),
            with - alone
        );
    }
    println!("          with its derivative by dual numbers {}", by_duals.vjp.total());

    // Combines the custom effect with a built-in one.
    let braked =
        CartPole::with_system(Forced { system, effects: (PoleDamping::default(), ByHand(brake)) });
    let policy = Mlp::new([6, 32, 32, 1]);
    let without =
        Trainer::new(CartPole::with_system(system), policy.clone()).epochs(epochs).run()?;
    let with = Trainer::new(braked, policy).epochs(epochs).run()?;
    for (name, report) in [("alone", without), ("braked", with)] {
        let loss = report.records.last().map_or(f64::NAN, |record| record.test_loss);
        println!("{name:>6}: test loss {loss:.4} after {epochs} epochs");
    }
    Ok(())
}

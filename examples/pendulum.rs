use physgrad::prelude::*;

/// Driven pendulum, semi-implicit Euler: x = [angle rad (0 = up), rate rad/s], u = [torque N m].
#[rustfmt::skip]
struct Pendulum { mass: f64, length: f64, dt: f64 }
#[rustfmt::skip]
impl System for Pendulum {
    fn state_dim(&self) -> usize { 2 }
    fn control_dim(&self) -> usize { 1 }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        let inertia = self.mass * self.length * self.length;
        next[1] = x[1] + (u[0] / inertia + x[0].sin() * (9.81 / self.length)) * self.dt;
        next[0] = x[0] + next[1] * self.dt;
    }
}

/// Swing-up from near hanging to upright and at rest, with little torque.
#[rustfmt::skip]
impl Task for Pendulum {
    type System = Self;
    fn system(&self) -> &Self { self }
    fn horizon(&self) -> usize { 40 }
    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x[0] = std::f64::consts::PI + rng.random_range(-0.5..0.5);
        x[1] = rng.random_range(-1.0..1.0);
    }
    fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, _next: &[T]) -> T { u[0] * u[0] * 1e-5 }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T { T::one() - x[0].cos() + x[1] * x[1] * 0.05 }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let pendulum = Pendulum { mass: 1.0, length: 0.5, dt: 0.05 };
    let policy = Mlp::new([2, 32, 32, 1]);
    check::system(&pendulum).unwrap(); // Panics if a derivative is wrong, and names it with both values.
    check::task(&pendulum, &policy).unwrap(); // Compares whole rollouts, in all flows, with dual numbers.
    let records = Trainer::new(pendulum, policy).field(Field::combined()).epochs(30).run()?.records;
    println!("test loss {:.3}, then {:.4}", records[0].test_loss, records[29].test_loss);
    Ok(())
}

//! The two simple examples of the paper (ICLR 2024): norms of R and M over two parameters, and Adam
//! on a field with a rotation.
//!
//! Run: `cargo run --release --example paper_examples`

use physgrad::policy::{Constant, Quadratic};
use physgrad::tasks::{Bowl, Reach};
use physgrad::train::vector_field::{self, LEARNING_RATE, ROTATION, Rotated, START, Sample};
use physgrad::{Divergence, Field};

fn main() -> Result<(), Divergence> {
    let task = Reach::default();
    println!(
        "u = θ₁ x² + θ₂ x from x = {}, {} steps, target {}:",
        task.start, task.horizon, task.target
    );
    println!("{:>12} {:>9} {:>9} {:>9}", "θ", "loss", "|R|", "|M|");
    // Exploding gradient, typical point, plateau with a vanishing R, and a point close to a
    // minimum.
    let thetas = [[-3.5, 3.5], [1.0, 1.0], [0.1, -1.05], [1.3, -2.99]];
    let [r, m] = [Field::regular(), Field::modified()]
        .map(|field| vector_field::sample(&task, &Quadratic, &field, &thetas));
    for (r, m) in r?.iter().zip(&m?) {
        println!(
            "{:>6.2}{:>6.2} {:>9.1e} {:>9.1e} {:>9.1e}",
            r.theta[0],
            r.theta[1],
            r.loss,
            r.norm(),
            m.norm()
        );
    }
    for field in [Field::regular(), Field::modified()] {
        let samples =
            vector_field::sample(&task, &Quadratic, &field, &vector_field::grid(4.0, 80))?;
        let norms = || samples.iter().map(Sample::norm);
        let (low, high) = (norms().fold(f64::INFINITY, f64::min), norms().fold(0.0, f64::max));
        println!(
            "{field} over [-4, 4]²: {low:.1e} to {high:.1e}, {:.1} orders of magnitude",
            (high / low).log10()
        );
    }

    println!(
        "\nAdam ({LEARNING_RATE}) in a bowl, with a rotation {ROTATION} times as long as the gradient:"
    );
    println!("{:>20} {:>9} {:>9} {:>9} {:>9}", "iteration", 0, 500, 1000, 1500);
    for (name, field) in Rotated::figure() {
        let path = vector_field::descend(
            &Bowl::default(),
            &Constant::new(2, 2),
            &field,
            START,
            LEARNING_RATE,
            1500,
        )?;
        let [a, b, c, d] = [0, 500, 1000, 1500].map(|i| path[i].loss);
        println!("{name:>20} {a:>9.1e} {b:>9.1e} {c:>9.1e} {d:>9.1e}");
    }
    Ok(())
}

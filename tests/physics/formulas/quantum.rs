//! Quantum control and its effects, by dense complex matrices.

use super::*;

/// Complex number: real and imaginary part.
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

/// Number of grid points.
pub(super) const GRID: usize = 7;

/// Length of the box.
const LENGTH: f64 = 2.6;

/// Time step.
const DT: f64 = 0.03;

/// Distance between grid points.
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

/// Returns `dt H`. H is the negative second difference quotient plus the potential.
fn hamiltonian(potential: &[f64]) -> Matrix {
    matrix(|j, k| match j.abs_diff(k) {
        0 => Complex(DT * (2.0 / (DX * DX) + potential[j]), 0.0),
        1 => Complex(-DT / (DX * DX), 0.0),
        _ => Complex(0.0, 0.0),
    })
}

fn times(matrix: &Matrix, psi: &[Complex]) -> Vec<Complex> {
    let dot = |row: &Vec<Complex>| {
        row.iter().zip(psi).fold(Complex(0.0, 0.0), |sum, (&entry, &psi)| sum + entry * psi)
    };
    matrix.iter().map(dot).collect()
}

/// Returns `(1 + i z/2 - tail z²)⁻¹ (1 - i z/2 - tail z²) ψ`.
fn rational(z: &Matrix, tail: f64, psi: &[Complex]) -> Vec<Complex> {
    let square: Matrix =
        (0..GRID).map(|j| times(z, &z.iter().map(|row| row[j]).collect::<Vec<_>>())).collect();
    let factor = |sign: f64| {
        matrix(|j, k| {
            let one = f64::from(u8::from(j == k));
            Complex(one, 0.0) + Complex(0.0, sign * 0.5) * z[j][k]
                - Complex(tail, 0.0) * square[k][j]
        })
    };
    solve(factor(1.0), times(&factor(-1.0), psi))
}

/// Returns `exp(-i z) ψ` by 4 factors `exp(-i z / 4)`, each by its power series. The norm of z
/// is about 1.
fn exponential(z: &Matrix, psi: &[Complex]) -> Vec<Complex> {
    (0..4).fold(psi.to_vec(), |psi, _| {
        let (mut sum, mut term) = (psi.clone(), psi);
        for n in 1..30 {
            let by = Complex(0.0, -0.25 / f64::from(n));
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
        (Barrier { height: 4.3, width: 0.6, center: -0.3 }.into(), |xi, _| {
            4.3 / ((xi + 0.3) / 0.6).cosh().powi(2)
        }),
        (DoubleWell { height: 2.7, separation: 1.3 }.into(), |xi, _| {
            2.7 * ((xi / 0.65) * (xi / 0.65) - 1.0).powi(2)
        }),
        (Cubic { strength: 0.4 }.into(), |_, density| 0.4 * density),
        (Tabulated { values: table }.into(), |xi, _| 1.5 + xi + 0.5 * LENGTH),
    ]
}

#[test]
fn steps_of_quantum_schemes_with_each_effect_equal_dense_matrices() {
    for control in [ControlShape::Tilt, ControlShape::Dipole] {
        let model = QuantumSystem { grid: GRID, length: LENGTH, dt: DT, control };
        let origin = if matches!(control, ControlShape::Tilt) { 0.0 } else { 0.5 * LENGTH };
        for (effect, potential) in potentials() {
            let at = |psi: &[Complex], u: &[f64]| -> Vec<f64> {
                let v = |(j, psi): (usize, &Complex)| {
                    let place = DX * (j as f64 + 1.0);
                    u[0] * (place - origin)
                        + potential(place - 0.5 * LENGTH, (psi.0 * psi.0 + psi.1 * psi.1) / DX)
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
            steps_as(
                &what,
                &Absorbing::new(Forced { system: model, effects: effects() }, edges),
                |x, u| {
                    let mut next = by(0.0)(x, u);
                    for j in 0..GRID {
                        let place = DX * (j as f64 + 1.0);
                        let depth = (0.7 - place.min(LENGTH - place)).max(0.0) / 0.7;
                        next[2 * j..2 * j + 2]
                            .iter_mut()
                            .for_each(|psi| *psi *= (-DT * 4.0 * depth * depth).exp());
                    }
                    next
                },
            );
            steps_as(
                &what,
                &Renormalized { system: Forced { system: model, effects: effects() } },
                |x, u| {
                    let next = by(0.0)(x, u);
                    let norm = next.iter().map(|psi| psi * psi).sum::<f64>().sqrt();
                    next.iter().map(|psi| psi / norm).collect()
                },
            );
        }
        for number in 1..=GRID {
            let sine = |j: usize| {
                (2.0 / (GRID + 1) as f64).sqrt()
                    * (PI * number as f64 * (j + 1) as f64 / (GRID + 1) as f64).sin()
            };
            near(
                "eigenstate",
                &model.eigenstate(number).collect::<Vec<_>>(),
                &(0..GRID).map(sine).collect::<Vec<_>>(),
            );
        }
    }
}

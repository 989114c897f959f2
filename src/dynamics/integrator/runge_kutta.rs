//! [`RungeKutta`]: explicit Runge–Kutta methods with one analytic VJP for all tableaus.

use super::{Buffer, Integrator, buffer, stage_time};
use crate::dynamics::inputs::{Cotangents, Inputs, add};
use crate::dynamics::ode::{DynOde, DynOdeVjp};
use crate::numbers::scalar::{Cotangent, Real, Scalar};

/// Maximal number of stages of a tableau.
const MAX_STAGES: usize = 7;

/// An explicit Runge–Kutta method: `k_i = f(x + h Σ_{j<i} a_ij k_j, u, p, t + c_i h)`,
/// `x' = x + h Σ_i b_i k_i`.
///
/// The VJP processes the stages from last to first (Hairer, Lubich and Wanner, Geometric Numerical
/// Integration, VI.4; Sanz-Serna 2016, doi:10.1137/151002769):
///
/// ```text
/// k̄_i = h (b_i x̄' + Σ_{j>i} a_ji ȳ_j),   ȳ_i = (∂f/∂x)ᵀ k̄_i
/// ū += (∂f/∂u)ᵀ k̄_i,   x̄ = x̄' + Σ_i ȳ_i
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RungeKutta(&'static Tableau);

/// Butcher tableau; unused entries are 0. `c_i = Σ_j a_ij`.
#[derive(Debug, PartialEq)]
struct Tableau {
    stages: usize,
    a: [[f64; MAX_STAGES - 1]; MAX_STAGES],
    b: [f64; MAX_STAGES],
    c: [f64; MAX_STAGES],
}

impl RungeKutta {
    /// Explicit Euler method: order 1, one evaluation of the vector field.
    pub const EULER: Self = Self(&Tableau::new(1, &[], &[1.0]));
    /// Heun's method, the explicit trapezoidal rule: order 2, two evaluations.
    pub const HEUN: Self = Self(&Tableau::new(2, &[&[1.0]], &[0.5, 0.5]));
    /// Classical Runge–Kutta method: order 4, four evaluations.
    pub const RK4: Self = Self(&Tableau::new(
        4,
        &[&[0.5], &[0.0, 0.5], &[0.0, 0.0, 1.0]],
        &[1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0],
    ));
    /// Tsitouras 2011 (doi:10.1016/j.camwa.2011.06.002): order 5, six evaluations.
    pub const TSIT5: Self = Self(&Tableau::new(
        6,
        &[
            &[0.161],
            &[-0.008_480_655_492_356_989, 0.335_480_655_492_357],
            &[2.897_153_057_105_493, -6.359_448_489_975_075, 4.362_295_432_869_581_5],
            &[
                5.325_864_828_439_257,
                -11.748_883_564_062_828,
                7.495_539_342_889_836_5,
                -0.092_495_066_361_755_25,
            ],
            &[
                5.861_455_442_946_42,
                -12.920_969_317_847_11,
                8.159_367_898_576_159,
                -0.071_584_973_281_401,
                -0.028_269_050_394_068_383,
            ],
        ],
        &[
            0.096_460_766_818_065_23,
            0.01,
            0.479_889_650_414_499_6,
            1.379_008_574_103_742,
            -3.290_069_515_436_081,
            2.324_710_524_099_774,
        ],
    ));

    /// Number of stages: evaluations of the vector field per step.
    pub fn stages(&self) -> usize {
        self.0.stages
    }

    /// Writes the argument of each stage to `at` and its rate to `rates`. Both have shape
    /// (stages, n) for n state components.
    ///
    /// `inputs.t` returns the time in s at a fraction of the step.
    #[inline(always)]
    pub(super) fn run<T: Scalar>(
        &self,
        ode: &dyn DynOde<T>,
        h: T,
        inputs: Inputs<'_, T, impl Fn(f64) -> T + Copy>,
        at: &mut [T],
        rates: &mut [T],
    ) {
        let n = inputs.x.len();
        for i in 0..self.0.stages {
            let at = &mut at[i * n..(i + 1) * n];
            at.copy_from_slice(inputs.x);
            for (j, &weight) in self.0.a[i][..i].iter().enumerate() {
                if weight != 0.0 {
                    add_scaled(at, h * weight, &rates[j * n..(j + 1) * n]);
                }
            }
            ode.rate(inputs.at((inputs.t)(self.0.c[i])).with_x(at), &mut rates[i * n..(i + 1) * n]);
        }
    }

    /// Adds `h Σ_i weight_i k_i` to `next`.
    #[inline(always)]
    pub(super) fn sum<T: Scalar>(&self, weights: &[f64], h: T, rates: &[T], next: &mut [T]) {
        let n = next.len();
        for (i, &weight) in weights[..self.0.stages].iter().enumerate() {
            if weight != 0.0 {
                add_scaled(next, h * weight, &rates[i * n..(i + 1) * n]);
            }
        }
    }

    /// Workspace for the arguments and rates of all stages, for `n` state components.
    #[inline(always)]
    pub(super) fn stage_buffers<T: Scalar>(&self, n: usize) -> (Buffer<T>, Buffer<T>) {
        (buffer(T::zero(), self.0.stages * n), buffer(T::zero(), self.0.stages * n))
    }

    /// The weights `b_i` of the stages in the next state.
    pub(super) fn weights(&self) -> &[f64] {
        &self.0.b
    }
}

impl Tableau {
    const fn new(stages: usize, rows: &[&[f64]], weights: &[f64]) -> Self {
        let (mut a, mut b, mut c) =
            ([[0.0; MAX_STAGES - 1]; MAX_STAGES], [0.0; MAX_STAGES], [0.0; MAX_STAGES]);
        let mut i = 0;
        while i < weights.len() {
            b[i] = weights[i];
            let mut j = 0;
            while i > 0 && j < rows[i - 1].len() {
                a[i][j] = rows[i - 1][j];
                c[i] += a[i][j];
                j += 1;
            }
            i += 1;
        }
        Self { stages, a, b, c }
    }
}

/// `y += factor x`.
#[inline(always)]
pub(super) fn add_scaled<T: Scalar>(y: &mut [T], factor: T, x: &[T]) {
    for i in 0..y.len() {
        y[i] += factor * x[i];
    }
}

impl RungeKutta {
    /// VJP of a step of any duration; see [`run`](Self::run). Adds to the requested cotangents.
    #[inline(always)]
    pub(super) fn run_back<R: Real, C: Cotangent<R>>(
        &self,
        ode: &dyn DynOdeVjp<R, C>,
        h: R,
        inputs: Inputs<'_, R, impl Fn(f64) -> R + Copy>,
        next_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        let n = inputs.x.len();
        let (mut at, mut rates) = self.stage_buffers(n);
        self.run(ode, h, inputs, &mut at, &mut rates);
        let (mut at_bar, mut rate_bar) =
            (buffer(C::null(), self.0.stages * n), buffer(C::null(), n));
        // Slices: indexing a `SmallVec` may compile to a call.
        let (at_bar, rate_bar) = (&mut at_bar[..], &mut rate_bar[..]);
        for i in (0..self.0.stages).rev() {
            for (c, rate_bar) in rate_bar.iter_mut().enumerate() {
                *rate_bar = next_bar[c] * (h * R::from(self.0.b[i]));
                for j in i + 1..self.0.stages {
                    if self.0.a[j][i] != 0.0 {
                        *rate_bar += at_bar[j * n + c] * (h * R::from(self.0.a[j][i]));
                    }
                }
            }
            let mut stage_bars = cotangents.reborrow();
            stage_bars.x = Some(&mut at_bar[i * n..(i + 1) * n]);
            ode.rate_vjp(
                inputs.at((inputs.t)(self.0.c[i])).with_x(&at[i * n..(i + 1) * n]),
                rate_bar,
                stage_bars,
            );
        }
        if let Some(x_bar) = cotangents.x {
            add(x_bar, next_bar);
            for stage in at_bar.chunks_exact(n) {
                add(x_bar, stage);
            }
        }
    }
}

impl Integrator for RungeKutta {
    #[inline(always)]
    fn advance<T: Scalar>(
        &self,
        ode: &dyn DynOde<T>,
        dt: f64,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    ) {
        let (h, (mut at, mut rates)) = (T::from(dt), self.stage_buffers(inputs.x.len()));
        self.run(ode, h, inputs.at(|c| stage_time(inputs.t, dt, c)), &mut at, &mut rates);
        next.copy_from_slice(inputs.x);
        self.sum(&self.0.b, h, &rates, next);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        ode: &dyn DynOdeVjp<R, C>,
        dt: f64,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        self.run_back(
            ode,
            R::from(dt),
            inputs.at(|c| stage_time(inputs.t, dt, c)),
            next_bar,
            cotangents,
        );
    }
}

//! [`Counted`] counts the correct operations and computes the same values as `f64`.

use crate::common::operations::{NUMBERS, operations};
use physgrad::count::{Counted, Ops};
use physgrad::rng::{Purpose, stream};
use physgrad::scalar::{CotangentPack, Dual};
use physgrad::tasks::{CartPole, Guidance, Quantum};
use physgrad::{Cotangent, Cotangents, Inputs, Real, Scalar, System, Task, initial_states};
use rand::RngExt;

const NONE: Ops =
    Ops { add: 0, negate: 0, multiply: 0, divide: 0, sqrt: 0, transcendental: 0, compare: 0 };

/// Returns the bits of a number. NaNs are canonicalized, because the language does not specify
/// their bits.
fn bits_of(number: f64) -> u64 {
    if number.is_nan() { f64::NAN } else { number }.to_bits()
}

#[test]
fn every_operation_has_the_bits_of_f64() {
    for ((name, plain), (_, counted)) in operations().into_iter().zip(operations()) {
        for (a, b) in NUMBERS.into_iter().flat_map(|a| NUMBERS.map(|b| (a, b))) {
            let (expected, found): (f64, Counted) = (plain(a, b), counted(Counted(a), Counted(b)));
            assert_eq!(bits_of(found.0), bits_of(expected), "{name} of {a} and {b}");
        }
    }
}

#[test]
fn every_operation_on_duals_has_the_bits_of_f64() {
    for ((name, plain), (_, counted)) in operations().into_iter().zip(operations()) {
        for (a, b) in NUMBERS.into_iter().flat_map(|a| NUMBERS.map(|b| (a, b))) {
            let (da, db) = ([0.5, -1.0, 0.0, 3.0], [2.0, 0.0, 0.7, -0.1]);
            let dual = |value, tangents| Dual { value, tangents };
            let counting = |value, tangents: [f64; 4]| Dual {
                value: Counted(value),
                tangents: tangents.map(Counted),
            };
            let expected: Dual<f64, 4> = plain(dual(a, da), dual(b, db));
            let found: Dual<Counted, 4> = counted(counting(a, da), counting(b, db));
            assert_eq!(bits_of(found.value.0), bits_of(expected.value), "{name} of {a} and {b}");
            let (found, expected) =
                (found.tangents.map(|t| bits_of(t.0)), expected.tangents.map(bits_of));
            assert_eq!(found, expected, "tangents of {name} of {a} and {b}");
        }
    }
}

#[test]
fn every_operation_is_counted() {
    let add = Ops { add: 1, ..NONE };
    let multiply = Ops { multiply: 1, ..NONE };
    let divide = Ops { divide: 1, ..NONE };
    let function = Ops { transcendental: 1, ..NONE };
    let compare = Ops { compare: 1, ..NONE };
    for (name, operation) in operations::<Counted>() {
        let expected = match name {
            "add" | "sub" | "add_assign" | "sub_assign" | "add_f64" | "sub_f64" => add,
            "mul" | "mul_assign" | "mul_f64" => multiply,
            "div" | "div_assign" | "div_f64" => divide,
            "neg" => Ops { negate: 1, ..NONE },
            "sqrt" => Ops { sqrt: 1, ..NONE },
            "exp" | "ln" | "sin" | "cos" | "tanh" | "atan2" => function,
            "select_lt" | "min" | "max" => compare,
            "abs" => Ops { compare: 1, negate: 1, ..NONE },
            "powi" => Ops { multiply: 3, ..NONE },
            "from" | "detach" => NONE,
            other => panic!("{other} is not counted here"),
        };
        assert_eq!(Ops::of(|| operation(Counted(0.4), Counted(0.3))).0, expected, "{name}");
    }
    assert_eq!(Ops::of(|| Counted(0.4).sin_cos()).0, function);
}

#[test]
fn every_operation_on_duals_counts_the_value_and_four_tangents() {
    for (name, operation) in operations::<Dual<Counted, 4>>() {
        // A constant has four zero tangents.
        let (x, y) = (Dual::variable(Counted(0.4), 1), Dual::constant(Counted(0.3)));
        let expected = match name {
            "add" | "add_assign" | "sub" | "sub_assign" => Ops { add: 5, ..NONE },
            // A constant summand changes only the value. A constant factor scales the tangents too.
            "add_f64" | "sub_f64" => Ops { add: 1, ..NONE },
            "mul_f64" => Ops { multiply: 5, ..NONE },
            "div_f64" => Ops { divide: 5, ..NONE },
            // a' b + a b'.
            "mul" | "mul_assign" => Ops { multiply: 1 + 8, add: 4, ..NONE },
            // q = a / b, i = 1 / b; (a' - q b') i. The guard against an infinite b takes the
            // absolute value of i, and one selection per tangent.
            "div" | "div_assign" => {
                Ops { divide: 2, multiply: 8, add: 4, compare: 1 + 4, negate: 1, ..NONE }
            }
            "neg" => Ops { negate: 5, ..NONE },
            // The guard against an infinite slope takes the absolute values of the slope and of
            // each tangent, and two selections per tangent.
            "sqrt" => Ops { sqrt: 1, divide: 1, multiply: 4, compare: 1 + 12, negate: 5, ..NONE },
            "ln" => Ops {
                transcendental: 1,
                divide: 1,
                multiply: 4,
                compare: 1 + 12,
                negate: 5,
                ..NONE
            },
            "exp" => Ops { transcendental: 1, multiply: 4, ..NONE },
            "sin" | "cos" => Ops { transcendental: 1, negate: 1, multiply: 8, ..NONE },
            "tanh" => Ops { transcendental: 1, add: 1, multiply: 1 + 4, ..NONE },
            // With unit = 1 unless a or b is huge or tiny: a = a unit, b = b unit, s = a a + b b;
            // (b / s unit) a' - (a / s unit) b', with the guard of sqrt for both slopes. The choice
            // of the unit takes two absolute values, their maximum, and four selections.
            "atan2" => Ops {
                transcendental: 1,
                add: 1 + 4,
                multiply: 6 + 8,
                divide: 2,
                compare: 2 + 1 + 4 + 2 * 13,
                negate: 2 + 2 * 5,
                ..NONE
            },
            "select_lt" | "min" | "max" => Ops { compare: 5, ..NONE },
            "abs" => Ops { compare: 5, negate: 5, ..NONE },
            // 1·x·x·x, and the slope 1·x·x·3.
            "powi" => Ops { multiply: 3 + 3 + 4, ..NONE },
            "from" | "detach" => NONE,
            other => panic!("{other} is not counted here"),
        };
        assert_eq!(Ops::of(|| operation(x, y)).0, expected, "{name}");
    }
}

#[test]
fn operations_of_a_nested_count_are_in_both_counts() {
    let (outer, inner) = Ops::of(|| {
        let x = Counted(2.0) * Counted(3.0);
        let (inner, y) = Ops::of(|| (x + x) / x);
        assert_eq!(y, Counted(2.0));
        let _ = -y;
        inner
    });
    assert_eq!(inner, Ops { add: 1, divide: 1, ..NONE });
    assert_eq!(outer, Ops { add: 1, divide: 1, multiply: 1, negate: 1, ..NONE });
    assert_eq!(outer - inner, Ops { multiply: 1, negate: 1, ..NONE });
    assert_eq!((outer.total(), inner.total(), Ops::default().total()), (4, 2, 0));
    assert_eq!(outer.to_string(), "1 add, 1 negate, 1 multiply, 1 divide");
    assert_eq!(Ops::default().to_string(), "nothing");
}

/// Mass on a hardening spring, q' = q + v' dt, v' = v + (u - q³) dt: 4 multiplications, 3
/// additions. Derivatives are analytic if `BY_HAND`, else by dual numbers.
struct Spring<const BY_HAND: bool>;

/// Time step, s.
const DT: f64 = 0.1;

impl<const BY_HAND: bool> System for Spring<BY_HAND> {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[1] = x[1] + (u[0] - x[0] * x[0] * x[0]) * DT;
        next[0] = x[0] + next[1] * DT;
    }
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        if !BY_HAND {
            return ByDuals(self).vjp(inputs, next_bar, cotangents);
        }
        let (x, dt) = (inputs.x, R::from(DT));
        let speed_bar = next_bar[1] + next_bar[0] * dt;
        if let Some(x_bar) = cotangents.x {
            x_bar[0] += next_bar[0] - speed_bar * (R::from(3.0) * x[0] * x[0] * dt);
            x_bar[1] += speed_bar;
        }
        if let Some(u_bar) = cotangents.u {
            u_bar[0] += speed_bar * dt;
        }
    }
}

/// Wrapper with the dimensions and the step of a system, and default derivatives.
struct ByDuals<'a, S>(&'a S);

impl<S: System> System for ByDuals<'_, S> {
    fn state_dim(&self) -> usize {
        self.0.state_dim()
    }
    fn control_dim(&self) -> usize {
        self.0.control_dim()
    }
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        self.0.step(inputs, next);
    }
}

/// Returns the operations of the step of a spring, then of its `vjp` for three requests: state and
/// control, state only, control only. `bar` sets the type of the cotangents.
fn spring<S: System, C: Cotangent<Counted>>(system: &S, bar: C) -> [Ops; 4] {
    let (x, u) = ([Counted(0.3), Counted(-1.2)], [Counted(0.8)]);
    let (mut next, mut x_bar, mut u_bar) = (x, [bar; 2], [bar; 1]);
    [
        Ops::of(|| system.step(Inputs::new(&x, &u), &mut next)).0,
        Ops::of(|| {
            system.vjp(Inputs::new(&x, &u), &[bar; 2], Cotangents::of(&mut x_bar, &mut u_bar))
        })
        .0,
        Ops::of(|| {
            system.vjp(
                Inputs::new(&x, &u),
                &[bar; 2],
                Cotangents { x: Some(&mut x_bar), ..Cotangents::default() },
            )
        })
        .0,
        Ops::of(|| {
            system.vjp(
                Inputs::new(&x, &u),
                &[bar; 2],
                Cotangents { u: Some(&mut u_bar), ..Cotangents::default() },
            )
        })
        .0,
    ]
}

#[test]
fn operations_of_a_spring_equal_those_counted_by_hand() {
    let counts = |multiply, add, negate| Ops { multiply, add, negate, ..NONE };
    let step = counts(4, 3, 0);
    let (one, two) = (Counted(0.7), CotangentPack([Counted(0.7), Counted(-0.4)]));

    // Analytic: 3 multiplications for 3 q² dt. Each column of cotangents needs 3 multiplications
    // and 2 additions, and 3 additions to the outputs.
    assert_eq!(spring(&Spring::<true>, one)[..2], [step, counts(3 + 3, 2 + 3, 0)]);
    assert_eq!(spring(&Spring::<true>, two)[..2], [step, counts(3 + 2 * 3, 2 * (2 + 3), 0)]);

    // Dual numbers, all inputs at once. Each of 2 products of variables takes 9 multiplications and
    // 4 additions. Each of 2 products with dt takes 5 multiplications, each of 3 sums 5 additions.
    // Each column of cotangents then takes 2 multiplications and 3 additions per input. For each of
    // the 2 outputs, these are a product and a sum. The third addition is that to the cotangent.
    let inputs = |inputs: u64, columns: u64| {
        counts(2 * (9 + 5) + columns * 2 * inputs, 2 * 4 + 3 * 5 + columns * 3 * inputs, 0)
    };
    let [both, state, control] = [3, 2, 1].map(|count| move |columns| inputs(count, columns));
    assert_eq!(spring(&Spring::<false>, one), [step, both(1), state(1), control(1)]);
    assert_eq!(spring(&Spring::<false>, two), [step, both(2), state(2), control(2)]);
}

/// Returns the bits of a step and its derivatives, for random controls and two columns of
/// cotangents.
fn bits<R: Real<Real = f64>, S: System>(system: &S, x: &[f64]) -> Vec<u64> {
    let mut rng = stream(5, Purpose::Check, 0);
    let mut draw =
        |len: usize| -> Vec<R> { (0..len).map(|_| R::from(rng.random_range(-1.0..1.0))).collect() };
    let (n, m) = (system.state_dim(), system.control_dim());
    let x: Vec<R> = x.iter().map(|&x| R::from(x)).collect();
    let (u, cotangents) = (draw(m), draw(2 * n));
    let next_bar: Vec<_> = cotangents
        .chunks_exact(2)
        .map(|cotangents| CotangentPack([cotangents[0], cotangents[1]]))
        .collect();
    let mut all = vec![R::zero(); n];
    let null = CotangentPack::<R, 2>::null();
    let (mut x_bar, mut state_bar, mut u_bar, mut control_bar) =
        (vec![null; n], vec![null; n], vec![null; m], vec![null; m]);
    system.step(Inputs::new(&x, &u), &mut all);
    system.vjp(Inputs::new(&x, &u), &next_bar, Cotangents::of(&mut x_bar, &mut u_bar));
    system.vjp(
        Inputs::new(&x, &u),
        &next_bar,
        Cotangents { x: Some(&mut state_bar), ..Cotangents::default() },
    );
    system.vjp(
        Inputs::new(&x, &u),
        &next_bar,
        Cotangents { u: Some(&mut control_bar), ..Cotangents::default() },
    );
    let columns = [x_bar, state_bar, u_bar, control_bar].concat();
    all.extend(columns.iter().flat_map(|c| c.0));
    all.iter().map(|number| number.lane(0).to_bits()).collect()
}

fn counted_is_f64<T: Task>(task: &T) {
    for x in initial_states(task, 6, Purpose::Train, 4).chunks_exact(task.system().state_dim()) {
        assert_eq!(bits::<Counted, _>(task.system(), x), bits::<f64, _>(task.system(), x));
        let by_duals = ByDuals(task.system());
        assert_eq!(bits::<Counted, _>(&by_duals, x), bits::<f64, _>(&by_duals, x));
    }
}

#[test]
fn counted_systems_have_the_bits_of_f64() {
    counted_is_f64(&CartPole::new(2));
    counted_is_f64(&Guidance::new(2, 4));
    counted_is_f64(&Quantum::new(3));
}

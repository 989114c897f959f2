//! Equations as text: values against formulas in Rust, derivatives against dual numbers, errors.

use physgrad::graph::{Costs, Equations, GraphTask, Names, Replaced, Replacement};
use physgrad::integrator::{AnyIntegrator, RungeKutta};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::tasks::CartPole;
use physgrad::{Cotangents, DynTask, Inputs, Scalar, System, Task, check};
use rand::RngExt as _;

const RK4: AnyIntegrator = AnyIntegrator::RungeKutta(RungeKutta::RK4);

/// Steps from the states `a` and `b`, with the control `u` and the parameter `k`.
fn two_states(next: [&str; 2]) -> Equations {
    let of = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect();
    Equations {
        states: of(&["a", "b"]),
        controls: of(&["u"]),
        dt: 0.5,
        parameters: [("k".to_owned(), 0.7.into()), ("two".to_owned(), 2.0.into())].into(),
        next: [("a".to_owned(), next[0].to_owned()), ("b".to_owned(), next[1].to_owned())].into(),
        ..Equations::default()
    }
}

fn task(equations: &Equations) -> GraphTask {
    GraphTask::new(equations, &Costs::default(), RK4, 1, 10)
        .unwrap_or_else(|error| panic!("{error}"))
}

/// Value of an expression of a, b and u.
fn value(text: &str, [a, b, u]: [f64; 3]) -> f64 {
    let mut next = [0.0; 2];
    let inputs = Inputs { x: &[a, b], u: &[u], p: &[], t: 3 };
    task(&two_states([text, "b"])).system().step(inputs, &mut next);
    next[0]
}

#[test]
fn expressions_have_the_order_of_operations_of_python() {
    let (a, b, u) = (0.3, -1.7, 2.2);
    for (text, expected) in [
        ("-a ^ 2", -(a * a)),
        ("2 ^ 3 ^ 2 * a", 512.0 * a),
        ("2 ** -1 * a", 0.5 * a),
        ("a - b - u", a - b - u),
        ("a / b * u", a / b * u),
        ("a - (b - u)", a - (b - u)),
        ("-a * b", -a * b),
        ("a + b * u ^ 3", a + b * (u * u * u)),
        ("a ^ -2", 1.0 / (a * a)),
        ("a ^ 0", 1.0),
        ("1.5e-1 * a + .5", 0.15 * a + 0.5),
        ("pi / 3 * a", std::f64::consts::PI / 3.0 * a),
        ("t", 1.5),
        ("dt * a", 0.5 * a),
        ("where(a < b, 1, 2)", 2.0),
        ("where(not a < b and u > 1, a, b)", a),
        ("where(a <= a and b >= b or a < b, a, b)", a),
        ("clip(u, 0, 1) + min(a, b) + max(a, b)", 1.0 + b + a),
        ("sign(b) + abs(b) + sign(0 * a)", -1.0 + 1.7),
        ("hypot(a, b)", Scalar::hypot(a, b)),
        ("k * a", 0.7 * a),
        ("b ^ two", b * b),
        ("detach(a) + wrap(a)", a + a.wrap_angle()),
    ] {
        assert_eq!(value(text, [a, b, u]), expected, "{text}");
    }
    for (text, expected) in [
        ("tan(a)", a.tan()),
        ("asin(a)", a.asin()),
        ("acos(a)", a.acos()),
        ("atan(a)", a.atan()),
        ("atan2(a, b)", a.atan2(b)),
        ("sinh(b)", b.sinh()),
        ("cosh(b)", b.cosh()),
        ("tanh(b)", b.tanh()),
        ("exp(b)", b.exp()),
        ("log(u)", u.ln()),
        ("sqrt(u)", u.sqrt()),
        ("u ^ 1.3", u.powf(1.3)),
        ("u ^ a", u.powf(a)),
        ("pow(u, 2.5)", u.powf(2.5)),
    ] {
        let found = value(text, [a, b, u]);
        assert!((found - expected).abs() < 4e-16 * expected.abs().max(1.0), "{text}: {found}");
    }
}

#[test]
fn definitions_are_read_in_any_order_and_tables_follow_the_steps() {
    let mut equations = two_states(["first", "wind"]);
    equations.define = [("first", "second * 2"), ("second", "third + a"), ("third", "a * b")]
        .map(|(name, text)| (name.to_owned(), text.to_owned()))
        .into();
    equations.tables = [("wind".to_owned(), vec![1.0, 2.0, 4.0])].into();
    for (t, wind) in [(0, 1.0), (2, 4.0), (7, 4.0)] {
        let mut next = [0.0; 2];
        task(&equations).system().step(Inputs { x: &[2.0, 3.0], u: &[0.0], p: &[], t }, &mut next);
        assert_eq!(next, [16.0, wind]);
    }
}

#[test]
fn errors_name_the_setting_the_column_and_the_replacement() {
    let with = |change: &dyn Fn(&mut Equations)| {
        let mut equations = two_states(["a", "b"]);
        change(&mut equations);
        let costs = Costs::default();
        let task = GraphTask::new(&equations, &costs, RK4, 1, 10);
        task.map(drop).expect_err("an error").to_string()
    };
    let next = |text: &str| with(&|equations| drop(equations.next.insert("a".into(), text.into())));
    for (text, message) in [
        (
            "a + c",
            "`next.a` has an error in column 5 of `a + c`: `c` is unknown; known are `a`, `b`, `u`, `k`, `two`",
        ),
        ("a + ", "column 5 of `a + `: the end where a number, a name or `(` is expected"),
        ("(a + b", "column 7"),
        ("2 a", "column 3 of `2 a`: `a` where an operator is expected"),
        ("a == b", "column 3 of `a == b`: `==` in an expression; numbers are hardly ever equal"),
        (
            "where(a == b, a, b)",
            "column 9 of `where(a == b, a, b)`: `==` in an expression; numbers are hardly ever equal, and no derivative tells \
             where they are; write `abs(a - b) < width`, or a smooth function as `exp(-((a - b) / width)^2)`",
        ),
        ("where(a != b, a, b)", "column 9 of `where(a != b, a, b)`: `!=` in an expression"),
        (
            "where(a = b, a, b)",
            "`=` has no meaning here; compare by `<`, `<=`, `>` or `>=`, as in `abs(a - b) < width`",
        ),
        ("a < b", "a condition where a number is expected; write `where(condition, a, b)`"),
        ("where(a, a, b)", "column 7 of `where(a, a, b)`: a number where a condition is expected"),
        ("where(0 < a < b, a, b)", "two comparisons in a row; write `a < b and b < c`"),
        ("sine(a)", "`sine` is not a function; functions are sin, cos"),
        ("a(b)", "`a` is a number, not a function; write `a * (...)` for a product"),
        ("atan2(a)", "`atan2` takes 2 arguments, here are fewer"),
        ("sin(a, b)", "`sin` takes 1 arguments, here are more"),
        ("1 / 0 * a", "the result of these literals is inf"),
        ("1e999", "`1e999` is not a number"),
        ("a * 0,5", "`,` where an operator is expected; decimals have a point, as in 0.5"),
        ("2 a²", "`a` where an operator is expected; write a product as `a * b`"),
        ("a²", "`²` has no meaning here; write a power as `x^2`"),
        ("ln(a)", "`ln` is not a function; write `log`, the natural logarithm"),
        ("a if b", "`if` where an operator is expected; write `where(condition, a, b)`"),
        ("a # b", "`#` has no meaning here"),
        ("next.a", "depends on `next`, which only the running cost knows"),
        ("next.c", "`c` is not a state; states are `a`, `b`"),
    ] {
        let error = next(text);
        assert!(error.contains(message), "{text}: {error}");
    }
    let joined = "where(".to_owned() + &"a < 1 or ".repeat(2000) + "b < 1, a, b)";
    assert!(next(&joined).contains("more than 1000 conditions"));
    let deep = "(".repeat(5000) + "a";
    assert!(next(&deep).contains("more than 100 levels; name a part of it in `define`"));
    for (change, message) in [
        (
            (&|e: &mut Equations| drop(e.next.remove("b"))) as &dyn Fn(&mut Equations),
            "`next.b` is missing; each state needs an equation",
        ),
        (&|e| e.controls.push("a".into()), "`controls` has `a`, which is also in `states`"),
        (&|e| e.controls.clear(), "`controls` is empty; name at least one control"),
        (&|e| e.states[0] = "a".repeat(101), "which is longer than 100 letters"),
        (
            &|e| e.define = (0..40_000).map(|i| (format!("d{i}"), "a + b * u".into())).collect(),
            "allowed: at most 500000 bytes",
        ),
        (&|e| e.states[0] = "pi".into(), "`states` has `pi`, which has a meaning of its own"),
        (&|e| e.states[0] = "1a".into(), "`states` has `1a`, which is not a name"),
        (&|e| e.dt = -1.0, "`dt` is -1; allowed: a positive number"),
        (&|e| e.angles.push("c".into()), "`angles` has `c`, which is not a state"),
        (&|e| drop(e.next.insert("c".into(), "1".into())), "`next` has `c`, which is not a state"),
        (&|e| drop(e.rate.insert("a".into(), "1".into())), "`next` and `rate` are both there"),
        (&|e| drop(e.tables.insert("w".into(), vec![])), "`tables.w` is empty"),
        (&|e| e.bounds = [("u".into(), [1.0, 0.0])].into(), "`bounds.u` is [1, 0]"),
        (
            &|e| e.define = [("f", "g"), ("g", "f")].map(|(a, b)| (a.into(), b.into())).into(),
            "`define.f` depends on itself",
        ),
        (&|e| e.observe = vec!["u".into()], "`observe` depends on the control"),
    ] {
        let error = with(change);
        assert!(error.contains(message), "{error}");
    }
}

/// A random expression of a, b, u and k.
fn expression(rng: &mut Rng, depth: usize) -> String {
    const LEAVES: [&str; 8] = ["a", "b", "u", "k", "0.3", "2", "a", "b"];
    const FUNCTIONS: [&str; 13] = [
        "sin", "cos", "tan", "atan", "tanh", "sinh", "cosh", "exp", "sqrt", "log", "abs", "asin",
        "-",
    ];
    const PAIRS: [&str; 4] = ["min", "max", "atan2", "hypot"];
    if depth == 0 {
        return LEAVES[rng.random_range(0..LEAVES.len())].to_owned();
    }
    let mut part = || expression(rng, depth - 1);
    let (a, b) = (part(), part());
    match rng.random_range(0..8) {
        0..=2 => {
            let operator = ["+", "-", "*", "/"][rng.random_range(0..4)];
            format!("({a} {operator} {b})")
        }
        3 | 4 => format!("{}({a})", FUNCTIONS[rng.random_range(0..FUNCTIONS.len())]),
        5 => format!("{}({a}, {b})", PAIRS[rng.random_range(0..PAIRS.len())]),
        6 => {
            let exponent = ["2", "3", "-1", "0", "1.5", "0.5"][rng.random_range(0..6)];
            format!("({a}) ^ {exponent}")
        }
        _ => {
            let operator = ["<", "<=", ">", ">="][rng.random_range(0..4)];
            format!("where({a} {operator} {b}, {b}, {a})")
        }
    }
}

/// The same steps without derivatives of their own.
struct Plain(GraphTask);

impl System for Plain {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        self.0.system().step(inputs, next);
    }
}

fn compare_derivatives(text: [&str; 2], numbers: [f64; 3], bars: [f64; 2]) {
    let Ok(graph) = GraphTask::new(&two_states(text), &Costs::default(), RK4, 1, 10) else {
        // Literals alone may give infinity.
        return;
    };
    let (x, u) = (&numbers[..2], &numbers[2..]);
    let pull = |system: &dyn Fn(Cotangents<'_, f64>)| {
        let (mut x_bar, mut u_bar) = ([-0.0; 2], [-0.0; 1]);
        system(Cotangents::of(&mut x_bar, &mut u_bar));
        [x_bar[0], x_bar[1], u_bar[0]]
    };
    let inputs = Inputs { x, u, p: &[], t: 0 };
    let mut next = [0.0; 2];
    graph.system().step(inputs, &mut next);
    if next.iter().any(|next| !next.is_finite()) {
        // A rollout ends there.
        return;
    }
    let found = pull(&|cotangents| graph.system().vjp(inputs, &bars, cotangents));
    let plain = Plain(graph.clone());
    let expected = pull(&|cotangents| plain.vjp(inputs, &bars, cotangents));
    for (i, (found, expected)) in found.into_iter().zip(expected).enumerate() {
        // Terms of very different size may cancel, and dual numbers may meet 0 times infinity on
        // a path that the graph does not have.
        let size = expected.abs().max(1.0);
        let is_close =
            (found - expected).abs() <= 1e-9 * size || expected.is_nan() || expected.abs() > 1e12;
        assert!(
            is_close,
            "{text:?} at {numbers:?}, input {i}: {found}, by dual numbers {expected}"
        );
    }
}

#[test]
fn derivatives_of_random_expressions_agree_with_dual_numbers() {
    let special = [0.0, -0.0, 1.0, -1.0, 1e-3, 1e3, f64::INFINITY, f64::NAN];
    for index in 0..10_000 {
        let mut rng = stream(0, Purpose::Check, index);
        let [first, second] = [0; 2].map(|_| {
            let depth = rng.random_range(0..5);
            expression(&mut rng, depth)
        });
        let text = [&first[..], &second];
        let bars = [0; 2].map(|_| rng.random_range(-1.0..1.0));
        compare_derivatives(text, [0; 3].map(|_| rng.random_range(-3.0..3.0)), bars);
        let numbers = [0; 3].map(|_| special[rng.random_range(0..special.len())]);
        compare_derivatives(text, numbers, bars);
    }
}

#[test]
fn rates_are_integrated_and_checked_with_costs_and_varied_numbers() {
    let parse = |text: &str| serde_json::from_str::<Equations>(text).expect("settings");
    let equations = parse(
        r#"{"states": ["h1", "h2"], "controls": ["pump"], "dt": 1.0, "bounds": {"pump": [0, 5]},
            "parameters": {"valve": {"uniform": [0.01, 0.03]}, "gain": 0.01, "area": {"normal": [1, 0.1]}},
            "start": {"h1": {"uniform": [0.1, 0.5]}, "h2": 0.2},
            "tables": {"rain": [0.0, 0.01, 0.0]},
            "define": {"q": "valve * sqrt(max(h1, 0))"},
            "rate": {"h1": "(gain * clip(pump, 0, 5) + rain - q) / area", "h2": "(q - valve * sqrt(max(h2, 0))) / area"},
            "observe": ["h1 - h2", "h2", "valve"]}"#,
    );
    let costs = Costs {
        running: "(next.h2 - 0.3)^2 + 1e-3 * pump^2 + 1e-2 * t * h1".into(),
        terminal: "100 * (h2 - 0.3)^2 / area".into(),
        ..Costs::default()
    };
    for substeps in [1, 3] {
        let task = GraphTask::new(&equations, &costs, RK4, substeps, 20).expect("a task");
        check::task(&task, &physgrad::policy::Mlp::new([3, 8, 1])).expect("exact derivatives");
    }
}

#[test]
fn names_that_nothing_uses_short_tables_and_no_costs_are_remarked() {
    let mut equations = two_states(["a + k", "b + part * two"]);
    let costs = Costs { running: "u^2".into(), ..Costs::default() };
    equations.define = [("part".to_owned(), "a * b".to_owned())].into();
    assert_eq!(equations.remarks(&costs, 10), [""; 0]);
    equations.define.insert("prat".into(), "a".into());
    equations.parameters.insert("spare".into(), 1.0.into());
    equations.tables = [("wind".to_owned(), vec![1.0, 2.0])].into();
    assert_eq!(
        equations.remarks(&Costs::default(), 10),
        [
            "no expression uses `spare` of `parameters`",
            "no expression uses `wind` of `tables`",
            "no expression uses `prat` of `define`",
            "no expression uses `u` of `controls`",
            "the table `wind` has 2 values for 10 steps; its last value holds afterwards",
            "there is no cost, so a training has nothing to minimize",
        ]
    );
}

#[test]
fn expressions_for_another_task_may_not_hide_its_names() {
    let replaced = |replacement: Replacement| {
        let names = Names {
            states: ["x", "x_dot", "theta_1", "omega_1"].map(str::to_owned).into(),
            controls: vec!["force".into()],
            params: vec![],
            dt: 0.02,
        };
        let task = Replaced::new(DynTask::new(CartPole::new(1)), names, &replacement);
        task.map(drop).map_err(|error| error.to_string())
    };
    let of = |name: &str, text: &str| Replacement {
        running: "x^2".into(),
        define: [(name.to_owned(), text.to_owned())].into(),
        ..Replacement::default()
    };
    assert_eq!(replaced(of("lean", "1 - cos(theta_1)")), Ok(()));
    for (replacement, message) in [
        (of("x", "theta_1"), "`define` has `x`, which is the name of another number"),
        (of("sin", "theta_1"), "`define` has `sin`, which has a meaning of its own"),
        (of("a b", "theta_1"), "`define` has `a b`, which is not a name"),
        (Replacement { running: String::new(), ..of("lean", "x") }, "`define` has no effect"),
    ] {
        let error = replaced(replacement).expect_err(message);
        assert!(error.contains(message), "{error}");
    }
}

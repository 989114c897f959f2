//! Check of the costs and of the observation of a task.

use super::oracle::pulled_back;
use super::visited::VisitedStep;
use super::{CASES, Comparison, Failure, Mismatch, ONE_STEP, Passed, normal};
use crate::dynamics::inputs::{Cotangents, Inputs, Start};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::rng::{Purpose, Rng, stream};

/// Checks the costs and the observation of a task near its initial states, with drawn parameters
/// and random controls, at evenly spaced steps.
///
/// The check requires:
///
/// - [`observe`](Task::observe) writes every component.
/// - The observation and the costs are finite.
/// - [`observe_vjp`](Task::observe_vjp), [`running_cost_gradient`](Task::running_cost_gradient) and
///   [`terminal_cost_gradient`](Task::terminal_cost_gradient) agree with dual numbers with respect
///   to every input. They also agree if the caller requests only some of the cotangents.
/// - These three methods add to their outputs.
///
/// # Errors
/// Returns the first [`Mismatch`].
pub fn cost<T: Task>(task: &T) -> Result<Passed, Failure> {
    check(task).map_err(Failure::of_costs)
}

fn check<T: Task>(task: &T) -> Result<Passed, Mismatch> {
    let (n, m, params) = (task.system().state_dim(), task.system().control_dim(), task.param_dim());
    let mut c = Comparison::new(ONE_STEP);
    for case in 0..CASES {
        c.case = case;
        let mut rng = stream(case, Purpose::Check, 0);
        let (mut x, mut p) = (vec![0.0; n], vec![0.0; params]);
        task.draw_start(&mut rng, Start { x: &mut x, p: &mut p });
        // A parameter that the task does not set is trained, so any value may occur.
        p.iter_mut().filter(|p| p.is_nan()).for_each(|p| *p = normal(&mut rng, 1)[0]);
        x.iter_mut().zip(normal(&mut rng, n)).for_each(|(x, noise)| *x += 0.1 * noise);
        let (u, noise) = (normal(&mut rng, m), normal(&mut rng, n));
        let next: Vec<f64> = x.iter().zip(noise).map(|(x, noise)| x + 0.1 * noise).collect();
        // Steps over the whole horizon: costs may depend on the step number.
        let t = case as usize * task.horizon().saturating_sub(1) / (CASES as usize - 1);
        check_at(
            task,
            &VisitedStep { x, u, p, next, t },
            "near an initial state",
            &mut rng,
            &mut c,
        )?;
    }
    Ok(c.passed)
}

/// Checks the costs and the observation at one step. `place` describes the step in messages.
pub(super) fn check_at<T: Task>(
    task: &T,
    VisitedStep { x, u, p, next, t }: &VisitedStep,
    place: &str,
    rng: &mut Rng,
    c: &mut Comparison,
) -> Result<(), Mismatch> {
    let inputs = Inputs { x, u, p, t: *t };
    check_observation(task, inputs.with_u(&[]), place, rng, c)?;
    let costs = [task.running_cost(inputs, next), task.terminal_cost(x, p)];
    c.finite(&format!("the cost is not finite {place}: (running, terminal)"), &costs)?;
    check_running_cost(task, inputs, next, c)?;
    check_terminal_cost(task, x, p, c)
}

/// Checks the observation. `inputs` has no control.
fn check_observation<T: Task>(
    task: &T,
    inputs: Inputs<'_, f64>,
    place: &str,
    rng: &mut Rng,
    c: &mut Comparison,
) -> Result<(), Mismatch> {
    let Some(observed) = task.observation_dim() else { return Ok(()) };
    let Inputs { x, p, t, .. } = inputs;
    let (n, params) = (x.len(), p.len());
    let [from_zeros, from_nans] = [0.0, f64::NAN].map(|initial| {
        let mut y = vec![initial; observed];
        task.observe(inputs, &mut y);
        y
    });
    c.equal("observe leaves a component unwritten: y", &from_nans, &from_zeros)?;
    c.finite(&format!("observe is not finite {place}: y"), &from_zeros)?;
    let y_bar = normal(rng, observed);
    let expected = pulled_back(&[x, p].concat(), &y_bar, &|all, y| {
        task.observe(Inputs { x: &all[..n], u: &[], p: &all[n..], t }, y);
    });
    let mut cotangents = [vec![-0.0; n], vec![-0.0; params]];
    c.adds("observe_vjp", ["x_bar", "p_bar"], &mut cotangents, &expected, &mut |[x, p]| {
        let cotangents = Cotangents { x: Some(x), u: None, p: (params > 0).then_some(p) };
        task.observe_vjp(inputs, &y_bar, cotangents);
    })?;
    let (by_x, by_p) = expected.split_at(n);
    let (mut x_bar, mut p_bar) = (vec![0.0; n], vec![0.0; params]);
    task.observe_vjp(inputs, &y_bar, Cotangents { x: Some(&mut x_bar), u: None, p: None });
    task.observe_vjp(
        inputs,
        &y_bar,
        Cotangents { x: None, u: None, p: (params > 0).then_some(&mut p_bar) },
    );
    c.slices("observe_vjp with x alone requested: x_bar", &x_bar, by_x)?;
    c.slices("observe_vjp with p alone requested: p_bar", &p_bar, by_p)?;
    Ok(())
}

/// Checks the gradient of the running cost.
fn check_running_cost<T: Task>(
    task: &T,
    inputs: Inputs<'_, f64>,
    next: &[f64],
    c: &mut Comparison,
) -> Result<(), Mismatch> {
    let Inputs { x, u, p, t } = inputs;
    let (n, m, params) = (x.len(), u.len(), p.len());
    let expected = pulled_back(&[x, u, p, next].concat(), &[1.0], &|all, cost| {
        let (x, rest) = all.split_at(n);
        let (u, rest) = rest.split_at(m);
        let (p, next) = rest.split_at(params);
        cost[0] = task.running_cost(Inputs { x, u, p, t }, next);
    });
    let mut cotangents = [n, m, params, n].map(|len| vec![-0.0; len]);
    let names = ["x_bar", "u_bar", "p_bar", "next_bar"];
    c.adds("running_cost_gradient", names, &mut cotangents, &expected, &mut |[
        x,
        u,
        p,
        next_bar,
    ]| {
        let cotangents = Cotangents { x: Some(x), u: Some(u), p: (params > 0).then_some(p) };
        task.running_cost_gradient(inputs, next, cotangents, next_bar);
    })?;
    check_requests(task, inputs, next, &expected, c)
}

/// Checks the gradient of the running cost if only some cotangents are requested. `expected`
/// concatenates the cotangents of x, u, p and the next state.
fn check_requests<T: Task>(
    task: &T,
    inputs: Inputs<'_, f64>,
    next: &[f64],
    expected: &[f64],
    c: &mut Comparison,
) -> Result<(), Mismatch> {
    let (n, m, params) = (inputs.x.len(), inputs.u.len(), inputs.p.len());
    let (by_x, rest) = expected.split_at(n);
    let (by_u, rest) = rest.split_at(m);
    let (by_p, by_next) = rest.split_at(params);
    for (asked, which) in [
        ([true, true, false], "x and u alone"),
        ([true, false, false], "x alone"),
        ([false, true, false], "u alone"),
        ([false, false, true], "p alone"),
    ] {
        let [mut x_bar, mut u_bar, mut p_bar, mut next_bar] =
            [n, m, params, n].map(|len| vec![0.0; len]);
        let request = Cotangents {
            x: asked[0].then_some(&mut x_bar[..]),
            u: asked[1].then_some(&mut u_bar[..]),
            p: (asked[2] && params > 0).then_some(&mut p_bar[..]),
        };
        task.running_cost_gradient(inputs, next, request, &mut next_bar);
        let mut compare = |name: &str, bar: &[f64], own: &[f64]| {
            c.slices(&format!("running_cost_gradient with {which} requested: {name}"), bar, own)
        };
        let compared = [("x_bar", &x_bar, by_x), ("u_bar", &u_bar, by_u), ("p_bar", &p_bar, by_p)];
        for ((name, bar, own), _) in compared.into_iter().zip(asked).filter(|(_, asked)| *asked) {
            compare(name, bar, own)?;
        }
        compare("next_bar", &next_bar, by_next)?;
    }
    Ok(())
}

/// Checks the gradient of the terminal cost.
fn check_terminal_cost<T: Task>(
    task: &T,
    x: &[f64],
    p: &[f64],
    c: &mut Comparison,
) -> Result<(), Mismatch> {
    let (n, params) = (x.len(), p.len());
    let expected = pulled_back(&[x, p].concat(), &[1.0], &|all, cost| {
        cost[0] = task.terminal_cost(&all[..n], &all[n..]);
    });
    let mut cotangents = [vec![-0.0; n], vec![-0.0; params]];
    c.adds("terminal_cost_gradient", ["x_bar", "p_bar"], &mut cotangents, &expected, &mut |[
        x_bar,
        p_bar,
    ]| {
        task.terminal_cost_gradient(x, p, x_bar, (params > 0).then_some(p_bar));
    })?;
    let mut x_bar = vec![0.0; n];
    task.terminal_cost_gradient(x, p, &mut x_bar, None);
    c.slices("terminal_cost_gradient with x alone requested: x_bar", &x_bar, &expected[..n])
}

impl Comparison {
    /// Calls `add` twice. After each call, compares `cotangents`, divided by the number of calls,
    /// with the concatenated `expected`.
    fn adds<const K: usize>(
        &mut self,
        method: &str,
        names: [&str; K],
        cotangents: &mut [Vec<f64>; K],
        expected: &[f64],
        add: &mut dyn FnMut([&mut [f64]; K]),
    ) -> Result<(), Mismatch> {
        for calls in [1.0, 2.0] {
            add(cotangents.each_mut().map(|bar| &mut bar[..]));
            let mut rest = expected;
            for (name, bar) in names.iter().zip(&*cotangents) {
                let (own, others) = rest.split_at(bar.len());
                let found: Vec<f64> = bar.iter().map(|bar| bar / calls).collect();
                let call = if calls == 1.0 { "" } else { ", second call that adds" };
                self.slices(&format!("{method}{call}: {name}"), &found, own)?;
                rest = others;
            }
        }
        Ok(())
    }
}

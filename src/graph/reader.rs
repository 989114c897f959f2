//! [`Reader`]: expressions as functions of a graph, with names for its inputs.

use super::equations::{EquationError, Operations};
use super::function::{Function, LISTS};
use super::lexer::{ParseError, names as words};
use super::op::{Graph, Id, Op};
use super::parse::{Parser, Term, name_problem, short};
use super::quantities::RecordedQuantities;
use super::record::record;
use std::cell::RefCell;
use std::collections::{BTreeMap, HashMap};

/// Lists of inputs: state, control, parameters, next state, and time followed by the tables.
pub(super) const X: usize = 0;
pub(super) const U: usize = 1;
pub(super) const P: usize = 2;
const NEXT: usize = 3;
pub(super) const TIME: usize = 4;

/// Names that expressions may use.
pub(super) struct Vocabulary<'a> {
    pub(super) states: Vec<String>,
    pub(super) controls: Vec<String>,
    /// Parameters of a sample.
    pub(super) params: Vec<String>,
    /// Values over time.
    pub(super) tables: Vec<String>,
    pub(super) constants: Vec<(String, f64)>,
    /// The time step, which has the name `dt`.
    pub(super) dt: f64,
    /// Expressions by name.
    pub(super) define: &'a BTreeMap<String, String>,
    /// Numbers that a task computes from a state.
    pub(super) quantities: &'a dyn RecordedQuantities,
}

impl Vocabulary<'_> {
    /// All names, for suggestions.
    fn all(&self, known: &HashMap<String, Term>) -> Vec<String> {
        let quantities = self.quantities.all_names();
        let next: Vec<String> = quantities.iter().map(|name| format!("next.{name}")).collect();
        known.keys().cloned().chain(quantities).chain(next).collect()
    }
}

/// Reads a text into a graph in which names have numbers.
type Read = fn(&str, &mut Graph, &dyn Fn(&str) -> Result<Term, String>) -> Result<Term, ParseError>;

/// A graph in which names have numbers.
pub(super) struct Reader<'a> {
    names: Vocabulary<'a>,
    graph: Graph,
    lengths: [usize; LISTS],
    known: HashMap<String, Term>,
    /// Whether the quantities are in the graph.
    is_computed: bool,
}

impl<'a> Reader<'a> {
    /// Reads the definitions.
    pub(super) fn new(names: Vocabulary<'a>) -> Result<Self, EquationError> {
        let Vocabulary { states, controls, params, tables, constants, .. } = &names;
        let lengths = [states.len(), controls.len(), params.len(), states.len(), 1 + tables.len()];
        let mut graph = Graph::new(lengths.iter().sum());
        let next: Vec<String> = states.iter().map(|name| format!("next.{name}")).collect();
        let time = ["t".to_owned()];
        let lists = [states, controls, params, &next, &time[..], tables];
        let inputs = lists.into_iter().flatten().cloned();
        let mut known: HashMap<_, _> = inputs.zip((0..).map(Term::Number)).collect();
        for (name, value) in constants {
            known.insert(name.clone(), Term::Number(graph.constant(*value)));
        }
        let dt = graph.constant(names.dt);
        known.insert("dt".to_owned(), Term::Number(dt));
        let mut reader = Self { names, graph, lengths, known, is_computed: false };
        reader.define()?;
        Ok(reader)
    }

    /// Records the quantities of the state and of the next state, once an expression names one.
    fn compute(&mut self, text: &str) {
        let quantities = self.names.quantities;
        let names = quantities.all_names();
        let is_quantity = |name: &str| {
            let name = name.strip_prefix("next.").unwrap_or(name);
            names.iter().any(|known| known == name)
        };
        if self.is_computed || !words(text).into_iter().any(is_quantity) {
            return;
        }
        self.is_computed = true;
        let [n, m, k, ..] = self.lengths;
        let recorded = record(&mut self.graph, |inputs| {
            let p = &inputs[n + m..n + m + k];
            let next = &inputs[n + m + k..][..n];
            [quantities.record(&inputs[..n], p), quantities.record(next, p)]
        });
        let [now, next] = recorded.expect("quantities do not branch on values");
        for ((name, now), next) in names.into_iter().zip(now).zip(next) {
            self.known.insert(format!("next.{name}"), Term::Number(next.0));
            self.known.insert(name, Term::Number(now.0));
        }
    }

    /// Reads all definitions, each after those that it names.
    fn define(&mut self) -> Result<(), EquationError> {
        let define = self.names.define;
        for name in define.keys() {
            let problem = name_problem(name).map(|problem| format!("which {problem}"));
            let is_known = self.known.contains_key(name);
            let known = || is_known.then(|| "which is the name of another number".to_owned());
            if let Some(problem) = problem.or_else(known) {
                return Err(EquationError::new(
                    "define",
                    format!("has `{}`, {problem}", short(name)),
                ));
            }
        }
        let mut waits: HashMap<&str, usize> = HashMap::new();
        let mut followers: HashMap<&str, Vec<&str>> = HashMap::new();
        for (name, text) in define {
            let mut before = words(text);
            before.retain(|name| define.contains_key(*name));
            before.sort_unstable();
            before.dedup();
            waits.insert(name, before.len());
            before.into_iter().for_each(|before| followers.entry(before).or_default().push(name));
        }
        let mut ready: Vec<&str> =
            define.keys().map(String::as_str).filter(|name| waits[name] == 0).collect();
        ready.reverse();
        while let Some(name) = ready.pop() {
            waits.remove(name);
            let term = self.term(&format!("define.{name}"), &define[name])?;
            self.known.insert(name.to_owned(), term);
            for follower in followers.remove(name).unwrap_or_default() {
                let count = waits.get_mut(follower).expect("a definition that waits");
                *count -= 1;
                if *count == 0 {
                    ready.push(follower);
                }
            }
        }
        let Some(name) = waits.keys().min() else { return Ok(()) };
        let what = "depends on itself, directly or through other definitions; allowed: no circle";
        Err(EquationError::new(format!("define.{name}"), what))
    }

    fn term(&mut self, key: &str, text: &str) -> Result<Term, EquationError> {
        self.compute(text);
        self.read(key, text, |text, graph, resolve| Parser::read(text, graph, resolve))
    }

    fn read(&mut self, key: &str, text: &str, read: Read) -> Result<Term, EquationError> {
        let (known, names) = (&self.known, &self.names);
        let missing = RefCell::new(None);
        let resolve = |name: &str| {
            known.get(name).copied().ok_or_else(|| {
                missing.replace(Some(name.to_owned()));
                unknown(names, name)
            })
        };
        let term = read(text, &mut self.graph, &resolve);
        term.map_err(|ParseError { column, what }| EquationError {
            unknown: missing.take().map(|name| (name, names.all(known))),
            ..EquationError::new(key, located(text, column, &what))
        })
    }

    /// The number of an expression.
    pub(super) fn expression(&mut self, key: &str, text: &str) -> Result<Id, EquationError> {
        Ok(self.term(key, text)?.id(&mut self.graph))
    }

    /// Number of operations, as written and as the outputs need them.
    pub(super) fn operations(&self, outputs: impl Iterator<Item = Id>) -> Operations {
        let needed = self.graph.needed(outputs);
        let ops = self.graph.ops().iter().zip(needed).filter(|(_, needed)| *needed);
        let evaluated = ops.filter(|(op, _)| !matches!(op, Op::Input | Op::Const(_))).count();
        Operations { written: self.graph.added(), evaluated }
    }

    /// Function of these outputs, which may depend on the `allowed` lists.
    pub(super) fn function(
        &self,
        key: &str,
        outputs: Vec<Id>,
        allowed: &[usize],
    ) -> Result<Function, EquationError> {
        let error = |what: String| EquationError::new(key, what);
        let function = Function::new(self.graph.clone(), outputs, self.lengths);
        let function = function.map_err(|_| {
            error("needs more than 65,535 numbers at once, with its derivative; simplify it".into())
        })?;
        for (list, what) in [
            (U, "the control, which is not known there"),
            (NEXT, "`next`, which only the running cost knows"),
            (TIME, "the time or a table, which is not known there"),
        ] {
            if function.reads(list) && !allowed.contains(&list) {
                return Err(error(format!("depends on {what}")));
            }
        }
        Ok(function)
    }

    /// Function of these expressions. None without expressions.
    pub(super) fn observation(
        &mut self,
        key: &str,
        texts: &[String],
    ) -> Result<Option<Function>, EquationError> {
        let mut outputs = Vec::with_capacity(texts.len());
        for (i, text) in texts.iter().enumerate() {
            outputs.push(self.expression(&format!("{key}[{i}]"), text)?);
        }
        let some = !outputs.is_empty();
        some.then(|| self.function(key, outputs, &[X, P, TIME])).transpose()
    }

    /// The running cost. None if the expression is empty.
    pub(super) fn running_cost(
        &mut self,
        key: &str,
        text: &str,
    ) -> Result<Option<Function>, EquationError> {
        self.cost(key, text, &[X, U, P, NEXT, TIME])
    }

    /// The terminal cost. None if the expression is empty.
    pub(super) fn terminal_cost(
        &mut self,
        key: &str,
        text: &str,
    ) -> Result<Option<Function>, EquationError> {
        self.cost(key, text, &[X, P])
    }

    /// Function that is negative where the condition of the end holds. None if the condition is
    /// empty. Expressions that follow may use the name `ended`: 1 where it holds, else 0.
    pub(super) fn margin(
        &mut self,
        key: &str,
        text: &str,
    ) -> Result<Option<Function>, EquationError> {
        if text.is_empty() {
            return Ok(None);
        }
        self.compute(text);
        let read: Read = |text, graph, resolve| Parser::read_condition(text, graph, resolve);
        let term = self.read(key, text, read)?;
        let output = term.id(&mut self.graph);
        let ended = self.term(key, &format!("where({text}, 1, 0)"))?;
        if self.known.insert("ended".to_owned(), ended).is_some() {
            let what = "tells whether an episode `ended`, which is the name of another number too; \
                        rename that one";
            return Err(EquationError::new(key, what));
        }
        self.function(key, vec![output], &[X, P]).map(Some)
    }

    fn cost(
        &mut self,
        key: &str,
        text: &str,
        allowed: &[usize],
    ) -> Result<Option<Function>, EquationError> {
        if text.is_empty() {
            return Ok(None);
        }
        let output = self.expression(key, text)?;
        self.function(key, vec![output], allowed).map(Some)
    }
}

/// Names in a message, at most a dozen.
pub(super) fn listed<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let names: Vec<&str> = names.collect();
    let shown = names.iter().take(12).map(|name| format!("`{name}`")).collect::<Vec<_>>();
    match names.len() {
        0 => "nothing".into(),
        count if count > 12 => format!("{} and {} more", shown.join(", "), count - 12),
        _ => shown.join(", "),
    }
}

/// Message of an unknown name.
fn unknown(names: &Vocabulary<'_>, name: &str) -> String {
    let Vocabulary { states, controls, params, tables, constants, define, dt: _, quantities } =
        names;
    let name = &*short(name);
    if let Some(state) = name.strip_prefix("next.") {
        let states = listed(states.iter().map(String::as_str));
        return format!("`{state}` is not a state; states are {states}");
    }
    let lists = [states, controls, params, tables].into_iter().flatten();
    let computed = quantities.all_names();
    let all =
        lists.chain(constants.iter().map(|(name, _)| name)).chain(define.keys()).chain(&computed);
    format!(
        "`{name}` is unknown; known are {} and `t`, `dt`, `pi`",
        listed(all.map(String::as_str))
    )
}

/// A problem at a column of an expression, with the text around it.
fn located(text: &str, column: usize, what: &str) -> String {
    let around: String = text.chars().skip(column.saturating_sub(21)).take(41).collect();
    let around = around.trim();
    if text.chars().count() <= 41 {
        format!("has an error in column {column} of `{text}`: {what}")
    } else {
        format!("has an error in column {column}, at `…{around}…`: {what}")
    }
}

//! [`Parser`]: an expression as text, appended to a graph.
//!
//! The operations of the graph are those of the text, in its order: nothing is reassociated.
//! Operations on literals alone are computed in f64 when the text is read.

use super::lexer::{Lexer, ParseError, Token};
use super::op::{Graph, Id, Op};
use crate::numbers::scalar::Scalar;
use std::f64::consts::PI;

/// A number of an expression.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Term {
    /// A literal, or the result of operations on literals.
    Literal(f64),
    /// A number of the graph.
    Number(Id),
}

impl Term {
    pub(super) fn id(self, graph: &mut Graph) -> Id {
        match self {
            Self::Literal(value) => graph.constant(value),
            Self::Number(id) => id,
        }
    }
}

/// A comparison of numbers, or several of them.
#[derive(Debug)]
enum Condition {
    Less(Id, Id),
    LessOrEqual(Id, Id),
    And(Box<[Condition; 2]>),
    Or(Box<[Condition; 2]>),
    Not(Box<Condition>),
}

impl Condition {
    /// `yes` where the condition holds, else `no`.
    fn select(&self, graph: &mut Graph, yes: Id, no: Id) -> Id {
        match self {
            Self::Less(a, b) => graph.add(Op::Select(*a, *b, yes, no)),
            Self::LessOrEqual(a, b) => graph.add(Op::SelectLe(*a, *b, yes, no)),
            Self::And(both) => {
                let second = both[1].select(graph, yes, no);
                both[0].select(graph, second, no)
            }
            Self::Or(both) => {
                let second = both[1].select(graph, yes, no);
                both[0].select(graph, yes, second)
            }
            Self::Not(condition) => condition.select(graph, no, yes),
        }
    }
}

enum Value {
    Term(Term),
    Condition(Condition),
}

/// Functions with their numbers of arguments.
const FUNCTIONS: [(&str, usize); 23] = [
    ("sin", 1),
    ("cos", 1),
    ("tan", 1),
    ("asin", 1),
    ("acos", 1),
    ("atan", 1),
    ("atan2", 2),
    ("sinh", 1),
    ("cosh", 1),
    ("tanh", 1),
    ("exp", 1),
    ("log", 1),
    ("sqrt", 1),
    ("abs", 1),
    ("sign", 1),
    ("min", 2),
    ("max", 2),
    ("hypot", 2),
    ("clip", 3),
    ("where", 3),
    ("detach", 1),
    ("wrap", 1),
    ("pow", 2),
];

/// Words that cannot be names: those of expressions, and the keys of a number that varies.
const WORDS: [&str; 12] = [
    "pi",
    "t",
    "dt",
    "next",
    "and",
    "or",
    "not",
    "uniform",
    "normal",
    "log_uniform",
    "choice",
    "start",
];

/// Largest length of a name.
const LONGEST: usize = 100;

/// A name in a message, shortened.
pub(super) fn short(name: &str) -> String {
    if name.len() <= LONGEST {
        return name.to_owned();
    }
    name.chars().take(20).chain("…".chars()).collect()
}

/// Why a name cannot be that of a number, or None.
pub(super) fn name_problem(name: &str) -> Option<&'static str> {
    let mut letters = name.chars();
    let begins = letters.next().is_some_and(|first| first.is_ascii_alphabetic() || first == '_');
    if !begins || !letters.all(|letter| letter.is_ascii_alphanumeric() || letter == '_') {
        return Some("is not a name; allowed: letters, digits and `_`, and no digit first");
    }
    if name.len() > LONGEST {
        return Some("is longer than 100 letters; choose a shorter name");
    }
    let is_taken = WORDS.contains(&name) || FUNCTIONS.iter().any(|(function, _)| *function == name);
    is_taken.then_some("has a meaning of its own; choose another name")
}

/// Returns whether a text can be the name of a number in expressions.
pub fn is_name(text: &str) -> bool {
    name_problem(text).is_none()
}

/// Strengths of operators: a higher one binds first.
mod strength {
    pub(super) const OR: u8 = 1;
    pub(super) const AND: u8 = 2;
    pub(super) const NOT: u8 = 3;
    pub(super) const COMPARISON: u8 = 4;
    pub(super) const SUM: u8 = 5;
    pub(super) const PRODUCT: u8 = 6;
    pub(super) const SIGN: u8 = 7;
    pub(super) const POWER: u8 = 8;
}

/// What an expression begins with, in messages.
const OPERAND: &str = "a number, a name or `(`";

/// Largest depth of parentheses, functions and signs.
const DEPTH: usize = 100;
/// Largest number of `and` and `or` in one expression, whose results are nested.
const JOINED: usize = 1000;
/// Largest number of operations in all expressions together. It bounds the memory of equations that
/// somebody else wrote.
pub(super) const OPERATIONS: usize = 200_000;
/// Largest whole exponent that is repeated multiplication.
const MULTIPLIED: f64 = 64.0;

/// Reads one expression.
pub(super) struct Parser<'a, 'g> {
    lexer: Lexer<'a>,
    /// The next token and its place.
    next: (usize, Token<'a>),
    depth: usize,
    /// Number of conditions joined by `and` and `or` so far.
    joined: usize,
    graph: &'g mut Graph,
    /// The number with this name, or what is wrong with the name.
    resolve: &'g dyn Fn(&str) -> Result<Term, String>,
}

impl<'a, 'g> Parser<'a, 'g> {
    /// Appends the expression to the graph.
    pub(super) fn read(
        text: &'a str,
        graph: &'g mut Graph,
        resolve: &'g dyn Fn(&str) -> Result<Term, String>,
    ) -> Result<Term, ParseError> {
        Self::whole(text, graph, resolve, |parser, value| parser.term(value, 0))
    }

    /// Appends a number to the graph that is -1 where the condition holds, else 1.
    pub(super) fn read_condition(
        text: &'a str,
        graph: &'g mut Graph,
        resolve: &'g dyn Fn(&str) -> Result<Term, String>,
    ) -> Result<Term, ParseError> {
        Self::whole(text, graph, resolve, |parser, value| {
            let condition = parser.condition(value, 0)?;
            let [yes, no] = [-1.0, 1.0].map(|value| parser.graph.constant(value));
            Ok(Term::Number(condition.select(parser.graph, yes, no)))
        })
    }

    /// Reads the whole text, and converts its value.
    fn whole(
        text: &'a str,
        graph: &'g mut Graph,
        resolve: &'g dyn Fn(&str) -> Result<Term, String>,
        convert: impl FnOnce(&mut Self, Value) -> Result<Term, ParseError>,
    ) -> Result<Term, ParseError> {
        let mut parser = Self::new(text, graph, resolve)?;
        let value = parser.expression(0)?;
        let term = convert(&mut parser, value)?;
        parser.end()?;
        Ok(term)
    }

    fn new(
        text: &'a str,
        graph: &'g mut Graph,
        resolve: &'g dyn Fn(&str) -> Result<Term, String>,
    ) -> Result<Self, ParseError> {
        let mut lexer = Lexer { text, at: 0 };
        let next = lexer.token()?;
        Ok(Self { lexer, next, depth: 0, joined: 0, graph, resolve })
    }

    /// Refuses what follows the expression.
    fn end(&self) -> Result<(), ParseError> {
        match self.next {
            (_, Token::End) => Ok(()),
            (at, token) => Err(self.unexpected(at, token, "an operator")),
        }
    }

    fn error(&self, at: usize, what: impl Into<String>) -> ParseError {
        self.lexer.error(at, what)
    }

    fn unexpected(&self, at: usize, token: Token<'_>, expected: &str) -> ParseError {
        let hint = match token {
            Token::Symbol(",") => "; decimals have a point, as in 0.5",
            Token::Name("if" | "else") => "; write `where(condition, a, b)`",
            Token::Name(_) | Token::Number(_) | Token::Symbol("(") if expected != OPERAND => {
                "; write a product as `a * b`"
            }
            _ => "",
        };
        self.error(at, format!("{token} where {expected} is expected{hint}"))
    }

    fn advance(&mut self) -> Result<(usize, Token<'a>), ParseError> {
        let token = self.lexer.token()?;
        Ok(std::mem::replace(&mut self.next, token))
    }

    fn expect(&mut self, symbol: &'static str) -> Result<(), ParseError> {
        match self.next {
            (_, token) if token == Token::Symbol(symbol) => self.advance().map(drop),
            (at, token) => Err(self.unexpected(at, token, &format!("`{symbol}`"))),
        }
    }

    fn term(&self, value: Value, at: usize) -> Result<Term, ParseError> {
        match value {
            Value::Term(term) => Ok(term),
            Value::Condition(_) => {
                let what = "a condition where a number is expected; write `where(condition, a, b)`";
                Err(self.error(at, what))
            }
        }
    }

    fn condition(&self, value: Value, at: usize) -> Result<Condition, ParseError> {
        match value {
            Value::Condition(condition) => Ok(condition),
            Value::Term(_) => {
                Err(self.error(at, "a number where a condition is expected, such as `a < b`"))
            }
        }
    }

    /// Reads an expression whose operators bind at least as strongly as `least`.
    fn expression(&mut self, least: u8) -> Result<Value, ParseError> {
        self.depth += 1;
        if self.depth > DEPTH {
            let what = format!("more than {DEPTH} levels; name a part of it in `define`");
            return Err(self.error(self.next.0, what));
        }
        let start = self.next.0;
        let mut left = self.operand()?;
        loop {
            let (at, token) = self.next;
            let (operator, strength, right) = match token {
                Token::Symbol(symbol @ ("+" | "-")) => (symbol, strength::SUM, strength::SUM + 1),
                Token::Symbol(symbol @ ("*" | "/")) => {
                    (symbol, strength::PRODUCT, strength::PRODUCT + 1)
                }
                // From right to left; an exponent may have a sign.
                Token::Symbol(symbol @ "^") => (symbol, strength::POWER, strength::SIGN),
                Token::Symbol(symbol @ ("<" | "<=" | ">" | ">=")) => {
                    (symbol, strength::COMPARISON, strength::COMPARISON + 1)
                }
                Token::Name("and") => ("and", strength::AND, strength::AND + 1),
                Token::Name("or") => ("or", strength::OR, strength::OR + 1),
                Token::Symbol(symbol @ ("==" | "!=")) => {
                    let what = format!(
                        "`{symbol}` in an expression; numbers are hardly ever equal, and no derivative tells where they are; \
                         write `abs(a - b) < width`, or a smooth function as `exp(-((a - b) / width)^2)`"
                    );
                    return Err(self.error(at, what));
                }
                _ => break,
            };
            if strength < least {
                break;
            }
            self.advance()?;
            let second = self.next.0;
            let right = self.expression(right)?;
            left = self.combined(operator, (left, start), (right, second), at)?;
        }
        self.depth -= 1;
        Ok(left)
    }

    /// Result of an operator between two values with their places.
    fn combined(
        &mut self,
        operator: &str,
        (left, start): (Value, usize),
        (right, second): (Value, usize),
        at: usize,
    ) -> Result<Value, ParseError> {
        if let "and" | "or" = operator {
            self.joined += 1;
            if self.joined > JOINED {
                let what =
                    format!("more than {JOINED} conditions; allowed: fewer in one expression");
                return Err(self.error(at, what));
            }
            let both = Box::new([self.condition(left, start)?, self.condition(right, second)?]);
            let joined = if operator == "and" { Condition::And(both) } else { Condition::Or(both) };
            return Ok(Value::Condition(joined));
        }
        if let ("<" | "<=" | ">" | ">=", Value::Condition(_)) = (operator, &left) {
            return Err(self.error(at, "two comparisons in a row; write `a < b and b < c`"));
        }
        let (left, right) = (self.term(left, start)?, self.term(right, second)?);
        if let "<" | "<=" | ">" | ">=" = operator {
            let (a, b) = (left.id(self.graph), right.id(self.graph));
            return Ok(Value::Condition(match operator {
                "<" => Condition::Less(a, b),
                "<=" => Condition::LessOrEqual(a, b),
                ">" => Condition::Less(b, a),
                _ => Condition::LessOrEqual(b, a),
            }));
        }
        let term = match operator {
            "+" => self.binary(left, right, Op::Add, |a, b| a + b),
            "-" => self.binary(left, right, Op::Sub, |a, b| a - b),
            "*" => self.binary(left, right, Op::Mul, |a, b| a * b),
            "/" => self.binary(left, right, Op::Div, |a, b| a / b),
            _ => self.power(left, right),
        };
        self.checked(term, at).map(Value::Term)
    }

    /// Refuses literals such as `1 / 0`.
    fn checked(&self, term: Term, at: usize) -> Result<Term, ParseError> {
        match term {
            Term::Literal(value) if !value.is_finite() => {
                Err(self.error(at, format!("the result of these literals is {value}")))
            }
            term => Ok(term),
        }
    }

    fn binary(
        &mut self,
        a: Term,
        b: Term,
        op: fn(Id, Id) -> Op,
        of_literals: fn(f64, f64) -> f64,
    ) -> Term {
        if let (Term::Literal(a), Term::Literal(b)) = (a, b) {
            return Term::Literal(of_literals(a, b));
        }
        let (a, b) = (a.id(self.graph), b.id(self.graph));
        Term::Number(self.graph.add(op(a, b)))
    }

    fn unary(&mut self, a: Term, op: fn(Id) -> Op, of_literal: fn(f64) -> f64) -> Term {
        match a {
            Term::Literal(a) => Term::Literal(of_literal(a)),
            Term::Number(a) => Term::Number(self.graph.add(op(a))),
        }
    }

    /// A power with a whole constant exponent is a product, as [`Scalar::powi`] is. Another constant
    /// exponent is [`Scalar::powf`]; with an exponent that varies, `a^b` is `exp(b log(a))`.
    fn power(&mut self, base: Term, exponent: Term) -> Term {
        let constant = match exponent {
            Term::Literal(power) => Some(power),
            Term::Number(id) => self.graph.as_constant(id),
        };
        let Some(power) = constant else {
            let log = self.unary(base, Op::Ln, Scalar::ln);
            let product = self.binary(log, exponent, Op::Mul, |a, b| a * b);
            return self.unary(product, Op::Exp, Scalar::exp);
        };
        let Term::Number(a) = base else {
            let Term::Literal(base) = base else { unreachable!("a term is one of two") };
            return Term::Literal(base.powf(power));
        };
        if power.fract() != 0.0 || power.abs() > MULTIPLIED {
            let exponent = self.graph.constant(power);
            return Term::Number(self.graph.add(Op::Powf(a, exponent)));
        }
        let one = self.graph.constant(1.0);
        let product =
            (0..power.abs() as u32).fold(one, |product, _| self.graph.add(Op::Mul(product, a)));
        let is_negative = power < 0.0;
        Term::Number(if is_negative { self.graph.add(Op::Div(one, product)) } else { product })
    }

    /// Reads a number, a name, a function, a sign or parentheses.
    fn operand(&mut self) -> Result<Value, ParseError> {
        let (at, token) = self.advance()?;
        if self.graph.ops().len() > OPERATIONS {
            let what = format!("exceeds {OPERATIONS} operations in all equations; allowed: fewer");
            return Err(self.error(at, what));
        }
        match token {
            Token::Number(value) => Ok(Value::Term(Term::Literal(value))),
            Token::Symbol("(") => {
                let value = self.expression(0)?;
                self.expect(")")?;
                Ok(value)
            }
            Token::Symbol("-") => {
                let value = self.expression(strength::SIGN)?;
                let term = self.term(value, at)?;
                Ok(Value::Term(self.unary(term, Op::Neg, |a| -a)))
            }
            Token::Symbol("+") => self.expression(strength::SIGN),
            Token::Name("not") => {
                let value = self.expression(strength::NOT)?;
                let condition = self.condition(value, at)?;
                Ok(Value::Condition(Condition::Not(Box::new(condition))))
            }
            Token::Name("pi") => Ok(Value::Term(Term::Literal(PI))),
            Token::Name(name) if self.next.1 == Token::Symbol("(") => self.call(name, at),
            Token::Name(name) if !["and", "or"].contains(&name) => {
                let term = (self.resolve)(name).map_err(|what| self.error(at, what))?;
                Ok(Value::Term(term))
            }
            token => Err(self.unexpected(at, token, OPERAND)),
        }
    }

    /// Reads the arguments of a function.
    fn call(&mut self, name: &str, at: usize) -> Result<Value, ParseError> {
        let Some((_, count)) = FUNCTIONS.iter().find(|(function, _)| *function == name) else {
            let known = FUNCTIONS.map(|(function, _)| function).join(", ");
            let what = if (self.resolve)(name).is_ok() {
                format!(
                    "`{name}` is a number, not a function; write `{name} * (...)` for a product"
                )
            } else if name == "ln" {
                "`ln` is not a function; write `log`, the natural logarithm".into()
            } else {
                format!("`{name}` is not a function; functions are {known}")
            };
            return Err(self.error(at, what));
        };
        self.expect("(")?;
        let mut arguments = Vec::new();
        loop {
            let start = self.next.0;
            arguments.push((self.expression(0)?, start));
            match self.next.1 {
                Token::Symbol(",") if arguments.len() < *count => drop(self.advance()?),
                _ => break,
            }
        }
        if arguments.len() < *count || self.next.1 == Token::Symbol(",") {
            let more = if arguments.len() < *count { "fewer" } else { "more" };
            let hint = if more == "more" { "; decimals have a point, as in 0.5" } else { "" };
            let what = format!("`{name}` takes {count} arguments, here are {more}{hint}");
            return Err(self.error(at, what));
        }
        self.expect(")")?;
        let condition = if name == "where" {
            let (first, start) = arguments.remove(0);
            Some(self.condition(first, start)?)
        } else {
            None
        };
        let mut terms = [Term::Literal(0.0); 3];
        for (term, (value, start)) in terms.iter_mut().zip(arguments) {
            *term = self.term(value, start)?;
        }
        let term = match condition {
            Some(condition) => {
                let [yes, no] = [terms[0], terms[1]].map(|term| term.id(self.graph));
                Term::Number(condition.select(self.graph, yes, no))
            }
            None => self.function(name, terms),
        };
        self.checked(term, at).map(Value::Term)
    }

    /// Result of a function of numbers.
    fn function(&mut self, name: &str, [a, b, c]: [Term; 3]) -> Term {
        match name {
            "sin" => self.unary(a, Op::Sin, Scalar::sin),
            "cos" => self.unary(a, Op::Cos, Scalar::cos),
            "tan" => {
                let (sin, cos) = (self.function("sin", [a; 3]), self.function("cos", [a; 3]));
                self.binary(sin, cos, Op::Div, |a, b| a / b)
            }
            "asin" => self.unary(a, Op::Asin, Scalar::asin),
            "acos" => self.unary(a, Op::Acos, Scalar::acos),
            "atan" => self.binary(a, Term::Literal(1.0), Op::Atan2, Scalar::atan2),
            "atan2" => self.binary(a, b, Op::Atan2, Scalar::atan2),
            "tanh" => self.unary(a, Op::Tanh, Scalar::tanh),
            "cosh" => {
                let minus = self.unary(a, Op::Neg, |a| -a);
                let [up, down] = [a, minus].map(|a| self.unary(a, Op::Exp, Scalar::exp));
                let sum = self.binary(up, down, Op::Add, |a, b| a + b);
                self.binary(sum, Term::Literal(0.5), Op::Mul, |a, b| a * b)
            }
            // Accurate near 0, where the difference of exponentials is not.
            "sinh" => {
                let (tanh, cosh) = (self.function("tanh", [a; 3]), self.function("cosh", [a; 3]));
                self.binary(tanh, cosh, Op::Mul, |a, b| a * b)
            }
            "exp" => self.unary(a, Op::Exp, Scalar::exp),
            "log" => self.unary(a, Op::Ln, Scalar::ln),
            "sqrt" => self.unary(a, Op::Sqrt, Scalar::sqrt),
            "abs" => self.unary(a, Op::Abs, Scalar::abs),
            "detach" => self.unary(a, Op::Detach, |a| a),
            "min" => self.binary(a, b, Op::Min, f64::min),
            "max" => self.binary(a, b, Op::Max, f64::max),
            "hypot" => self.binary(a, b, Op::Hypot, Scalar::hypot),
            "pow" => self.power(a, b),
            "clip" => {
                let above = self.binary(a, b, Op::Max, f64::max);
                self.binary(above, c, Op::Min, f64::min)
            }
            "wrap" => {
                let (sin, cos) = (self.function("sin", [a; 3]), self.function("cos", [a; 3]));
                self.binary(sin, cos, Op::Atan2, Scalar::atan2)
            }
            _ => self.sign(a),
        }
    }

    /// -1, 0 or 1, without a derivative.
    fn sign(&mut self, a: Term) -> Term {
        let Term::Number(a) = a else {
            return self.unary(a, Op::Detach, |a| if a == 0.0 { a } else { a.signum() });
        };
        let [zero, one, minus] = [0.0, 1.0, -1.0].map(|value| self.graph.constant(value));
        let value = self.graph.add(Op::Detach(a));
        let not_negative = self.graph.add(Op::Select(zero, value, one, value));
        Term::Number(self.graph.add(Op::Select(value, zero, minus, not_negative)))
    }
}

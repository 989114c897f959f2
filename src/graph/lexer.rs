//! [`Lexer`]: the tokens of an expression, with their places.

use std::fmt;

/// An error in an expression, with its place.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ParseError {
    /// Column of the first character that does not fit, from 1.
    pub(super) column: usize,
    /// What is wrong, and what to write instead.
    pub(super) what: String,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Token<'a> {
    Number(f64),
    Name(&'a str),
    Symbol(&'static str),
    End,
}

impl fmt::Display for Token<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(value) => write!(f, "`{value}`"),
            Self::Name(name) => write!(f, "`{name}`"),
            Self::Symbol(symbol) => write!(f, "`{symbol}`"),
            Self::End => f.write_str("the end"),
        }
    }
}

/// Symbols, longer ones first.
const SYMBOLS: [&str; 14] =
    ["**", "<=", ">=", "==", "!=", "<", ">", "+", "-", "*", "/", "^", "(", ")"];

/// Names in an expression, for the order of definitions. Invalid text has the names before the
/// first invalid character.
pub(super) fn names(text: &str) -> Vec<&str> {
    let mut lexer = Lexer { text, at: 0 };
    let mut names = Vec::new();
    while let Ok((_, token)) = lexer.token() {
        match token {
            Token::Name(name) => names.push(name),
            Token::End => break,
            _ => {}
        }
    }
    names
}

pub(super) struct Lexer<'a> {
    pub(super) text: &'a str,
    /// Bytes that were read.
    pub(super) at: usize,
}

impl<'a> Lexer<'a> {
    pub(super) fn error(&self, at: usize, what: impl Into<String>) -> ParseError {
        ParseError { column: self.text[..at].chars().count() + 1, what: what.into() }
    }

    /// The next token and its place.
    pub(super) fn token(&mut self) -> Result<(usize, Token<'a>), ParseError> {
        let rest = self.text[self.at..].trim_start();
        let start = self.text.len() - rest.len();
        let Some(first) = rest.chars().next() else {
            self.at = start;
            return Ok((start, Token::End));
        };
        let is_of_name = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
        let (length, token) = if first.is_ascii_digit() || first == '.' {
            let length = number_length(rest);
            let value: Option<f64> = rest[..length].parse().ok();
            let Some(value) = value.filter(|value| value.is_finite()) else {
                return Err(self.error(start, format!("`{}` is not a number", &rest[..length])));
            };
            (length, Token::Number(value))
        } else if first.is_ascii_alphabetic() || first == '_' {
            // `next.name` is one name.
            let dotted = |letter: char| is_of_name(letter) || letter == '.';
            let length = rest.find(|letter| !dotted(letter)).unwrap_or(rest.len());
            (length, Token::Name(&rest[..length]))
        } else if first == ',' {
            (1, Token::Symbol(","))
        } else if let Some(symbol) = SYMBOLS.into_iter().find(|symbol| rest.starts_with(symbol)) {
            (symbol.len(), Token::Symbol(if symbol == "**" { "^" } else { symbol }))
        } else {
            let hint = match first {
                '²' | '³' => "; write a power as `x^2`",
                '·' | '×' => "; write a product as `a * b`",
                '=' => "; compare by `<`, `<=`, `>` or `>=`, as in `abs(a - b) < width`",
                '[' | ']' | '{' | '}' => "; write parentheses",
                ';' => "; separate arguments by `,`",
                first if !first.is_ascii() => "; names have the letters a to z",
                _ => "",
            };
            return Err(self.error(start, format!("`{first}` has no meaning here{hint}")));
        };
        self.at = start + length;
        Ok((start, token))
    }
}

/// Length of the number at the start of the text: digits, a point, an exponent.
fn number_length(text: &str) -> usize {
    let bytes = text.as_bytes();
    let digits =
        |from: usize| bytes[from..].iter().take_while(|byte| byte.is_ascii_digit()).count();
    let mut length = digits(0);
    if bytes.get(length) == Some(&b'.') {
        length += 1 + digits(length + 1);
    }
    if matches!(bytes.get(length), Some(b'e' | b'E')) {
        let sign = usize::from(matches!(bytes.get(length + 1), Some(b'+' | b'-')));
        let exponent = digits((length + 1 + sign).min(bytes.len()));
        if exponent > 0 {
            length += 1 + sign + exponent;
        }
    }
    length
}

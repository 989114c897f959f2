//! XML documents as trees of elements that know file and line.
//!
//! Files may come from anywhere. Size, depth and counts have bounds, and entities are refused, so
//! that a small file cannot use much memory or time.

use crate::files::{FileError, Place};
use std::io::Read as _;
use std::path::Path;
use std::sync::Arc;

/// Largest size of a file, bytes.
const BYTES: usize = 16 << 20;
/// Largest number of elements of a file.
pub(crate) const ELEMENTS: usize = 100_000;
/// Largest depth of nested elements. Readers call themselves once a level.
pub(crate) const DEPTH: usize = 300;
/// Largest number of attributes of an element.
const ATTRIBUTES: usize = 200;
/// Largest magnitude of a number, which keeps products of numbers finite.
const LARGEST: f64 = 1e20;

/// An element with its attributes and children. Text between elements is left out.
#[derive(Clone, Debug)]
pub(crate) struct Element {
    pub name: String,
    pub attributes: Vec<(String, String)>,
    pub children: Vec<Element>,
    pub file: Arc<str>,
    pub line: u32,
}

impl Element {
    /// The text of an attribute.
    pub fn get(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(key, _)| key == name).map(|(_, value)| value.as_str())
    }

    /// The first child with this name.
    pub fn child(&self, name: &str) -> Option<&Element> {
        self.children.iter().find(|c| c.name == name)
    }

    /// Where the element stands.
    pub fn place(&self) -> Place {
        Place { file: self.file.clone(), line: self.line, element: self.label() }
    }

    /// An error at this element.
    pub fn error(&self, what: impl Into<String>) -> FileError {
        FileError {
            file: self.file.to_string(),
            line: self.line,
            element: self.label(),
            what: what.into(),
        }
    }

    /// The beginning of the element, with the attributes that identify it.
    fn label(&self) -> String {
        const TELLING: [&str; 9] =
            ["name", "class", "type", "joint", "tendon", "body1", "body2", "file", "mesh"];
        let mut label = format!("<{}", shorten(&self.name));
        for (key, value) in &self.attributes {
            if TELLING.contains(&key.as_str()) {
                label += &format!(" {key}=\"{}\"", shorten(value));
            }
        }
        label + ">"
    }

    /// Numbers of an attribute: at least `least`, at most `most`.
    pub fn numbers(&self, name: &str, least: usize, most: usize) -> Result<Vec<f64>, FileError> {
        let text = self.get(name).unwrap_or("");
        let mut numbers = Vec::new();
        for word in text.split_ascii_whitespace() {
            if numbers.len() == most {
                return Err(self.error(format!("`{name}` has more than {most} numbers")));
            }
            numbers.push(self.parsed(name, word)?);
        }
        if numbers.len() < least {
            let has = numbers.len();
            return Err(self.error(format!("`{name}` needs {least} numbers and has {has}")));
        }
        Ok(numbers)
    }

    fn parsed(&self, name: &str, word: &str) -> Result<f64, FileError> {
        match word.parse::<f64>() {
            Ok(value) if value.abs() <= LARGEST => Ok(value),
            Ok(_) => Err(self.error(format!(
                "`{name}` has `{}`; numbers must be finite and at most {LARGEST:e}",
                shorten(word)
            ))),
            Err(_) => Err(self.error(format!("`{name}` has `{}`, not a number", shorten(word)))),
        }
    }
}

/// The text, cut after 40 characters.
pub(crate) fn shorten(text: &str) -> String {
    match text.char_indices().nth(40) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_string(),
    }
}

/// The name that needs the fewest changes of letters, if it is close.
pub(crate) fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    if name.len() > 40 {
        return None;
    }
    let best = known.into_iter().map(|k| (distance(name, k), k)).min_by_key(|(d, _)| *d)?;
    (best.0 <= 1 + name.len() / 4).then_some(best.1)
}

/// Number of letters to insert, remove or replace, to make one word of the other.
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(x != *y);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(row[j] + 1).min(row[j + 1] + 1);
        }
    }
    row[b.len()]
}

/// Says `did you mean` with the nearest known name.
pub(crate) fn hint<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    match nearest(name, known) {
        Some(near) => format!("did you mean `{near}`?"),
        None => "remove it".to_string(),
    }
}

/// Reads a document from a file.
pub(crate) fn read(path: &Path) -> Result<Element, FileError> {
    let name = path.file_name().map_or(path.to_string_lossy(), |n| n.to_string_lossy());
    parse(&text(path, &name)?, &name)
}

/// The text of a file, whose name appears in errors.
pub(crate) fn text(path: &Path, name: &str) -> Result<String, FileError> {
    let whole = |what: String| FileError { file: name.into(), line: 0, element: "".into(), what };
    let cannot = |e: std::io::Error| whole(format!("cannot be read: {e}"));
    let file = std::fs::File::open(path).map_err(cannot)?;
    if !file.metadata().map_err(cannot)?.is_file() {
        return Err(whole("cannot be read: not a file".into()));
    }
    let mut bytes = Vec::new();
    file.take(BYTES as u64 + 1).read_to_end(&mut bytes).map_err(cannot)?;
    String::from_utf8(bytes).map_err(|_| whole("is not UTF-8 text; save it as UTF-8".into()))
}

/// Reads a document from text. The name of its file appears in errors.
pub(crate) fn parse(text: &str, file: &str) -> Result<Element, FileError> {
    guard(text).map_err(|(line, what)| FileError {
        file: file.into(),
        line,
        element: String::new(),
        what,
    })?;
    let document = roxmltree::Document::parse(text).map_err(|e| FileError {
        file: file.into(),
        line: e.pos().row,
        element: String::new(),
        what: format!("is not well-formed XML: {}", shorten_error(&e.to_string())),
    })?;
    let mut lines =
        Lines { text: text.as_bytes(), position: 0, line: 1, file: file.into(), ahead: 0 };
    for node in document.root().children().take_while(|node| !node.is_element()) {
        lines.turn(&node);
    }
    Ok(element(document.root_element(), &mut lines))
}

/// The error of the parser, which can quote a whole attribute.
fn shorten_error(text: &str) -> String {
    match text.char_indices().nth(200) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_string(),
    }
}

/// The element with its children, to the depth that [`guard`] has found.
fn element(node: roxmltree::Node, lines: &mut Lines) -> Element {
    let (file, line) = lines.place_of(&node);
    let mut children = Vec::new();
    for child in node.children() {
        if child.is_element() {
            children.push(element(child, lines));
        } else {
            lines.turn(&child);
        }
    }
    Element {
        name: qualified(&node),
        attributes: node
            .attributes()
            .filter(|a| a.namespace().is_none())
            .map(|a| (a.name().to_string(), a.value().to_string()))
            .collect(),
        file,
        line,
        children,
    }
}

/// The name with its prefix, as `xacro:macro`.
fn qualified(node: &roxmltree::Node) -> String {
    let name = node.tag_name().name();
    match node.tag_name().namespace().and_then(|uri| node.lookup_prefix(uri)) {
        Some(prefix) if !prefix.is_empty() => format!("{prefix}:{name}"),
        _ => name.to_string(),
    }
}

/// The instruction of an expanded text that the next line came from another file or line.
const FROM: &str = "from";

/// Counts lines forward, because counting from the beginning for every element takes quadratic
/// time.
struct Lines<'a> {
    text: &'a [u8],
    position: usize,
    line: u32,
    /// File from which the text came, and its lines before those of the text.
    file: Arc<str>,
    ahead: u32,
}

impl Lines<'_> {
    fn line_of(&mut self, position: usize) -> u32 {
        let passed = self.text.get(self.position..position).unwrap_or(&[]);
        self.line += passed.iter().filter(|b| **b == b'\n').count() as u32;
        self.position = self.position.max(position);
        self.line
    }

    /// File and line of an element.
    fn place_of(&mut self, node: &roxmltree::Node) -> (Arc<str>, u32) {
        let line = self.line_of(node.range().start);
        (self.file.clone(), line.wrapping_add(self.ahead))
    }

    /// Follows an instruction of [`write`] with file and line of what comes next.
    fn turn(&mut self, node: &roxmltree::Node) {
        let Some(from) = node.pi().filter(|from| from.target == FROM) else { return };
        let Some((line, file)) = from.value.and_then(|value| value.split_once(' ')) else { return };
        let Ok(line) = line.parse::<u32>() else { return };
        self.ahead = line.wrapping_sub(self.line_of(node.range().start));
        self.file = shorten(file.trim()).into();
    }
}

/// Refuses what could use much memory or time, before anything is built: entities, deep nesting,
/// and large counts. Malformed text passes; the parser refuses it.
fn guard(text: &str) -> Result<(), (u32, String)> {
    if text.len() > BYTES {
        return Err((0, format!("is larger than {} MB", BYTES >> 20)));
    }
    if text.matches("xmlns").count() > 50 {
        return Err((0, "has more than 50 namespaces".into()));
    }
    let (mut rest, mut depth, mut elements) = (text, 0usize, 0);
    while let Some(start) = rest.find('<') {
        let at = text.len() - rest.len() + start;
        let line = || 1 + text[..at].matches('\n').count() as u32;
        rest = &rest[start..];
        let end = if rest.starts_with("<!--") {
            rest.find("-->")
        } else if rest.starts_with("<![CDATA[") {
            rest.find("]]>")
        } else if rest.starts_with("<?") {
            rest.find("?>")
        } else if rest.starts_with("<!") {
            return Err((line(), "has a document type; entities are refused, remove it".into()));
        } else if rest.starts_with("</") {
            depth = depth.saturating_sub(1);
            rest.find('>')
        } else {
            let tag = Tag::scan(rest);
            depth += usize::from(!tag.closed);
            elements += 1;
            for (count, most, what) in [
                (depth, DEPTH, "levels of nested elements"),
                (elements, ELEMENTS, "elements"),
                (tag.attributes, ATTRIBUTES, "attributes in one element"),
            ] {
                if count > most {
                    return Err((line(), format!("has more than {most} {what}")));
                }
            }
            Some(tag.length)
        };
        rest = &rest[end.unwrap_or(rest.len()).max(1).min(rest.len())..];
    }
    Ok(())
}

/// The extent of the beginning of an element.
struct Tag {
    length: usize,
    attributes: usize,
    closed: bool,
}

impl Tag {
    /// Scans text that begins with `<` up to `>` outside of quotes. `<` cannot stand in a tag.
    fn scan(text: &str) -> Self {
        let (mut quote, mut attributes, mut last) = (None, 0, b'<');
        for (i, byte) in text.bytes().enumerate().skip(1) {
            match (quote, byte) {
                (Some(q), b) if q == b => quote = None,
                (Some(_), _) => {}
                (None, b'"' | b'\'') => {
                    quote = Some(byte);
                    attributes += 1;
                }
                (None, b'>') => return Self { length: i, attributes, closed: last == b'/' },
                (None, b'<') => return Self { length: i, attributes, closed: false },
                _ => {}
            }
            last = byte;
        }
        Self { length: text.len(), attributes, closed: false }
    }
}

/// The document as text. Elements keep their lines, and an instruction before the first element
/// and where the file changes says what these are.
pub(crate) fn write(root: &Element) -> String {
    let mut writer = Writer { out: String::new(), file: "".into(), line: 1 };
    writer.write(root, 0);
    writer.out + "\n"
}

struct Writer {
    out: String,
    /// File and line that the reader takes the end of the text for.
    file: Arc<str>,
    line: u32,
}

impl Writer {
    fn write(&mut self, element: &Element, indent: usize) {
        self.go_to(element, indent);
        self.out += &format!("<{}", element.name);
        for (key, value) in &element.attributes {
            self.out += &format!(" {key}=\"{}\"", escaped(value));
        }
        if element.children.is_empty() {
            self.out += "/>";
            return;
        }
        self.out += ">";
        for child in &element.children {
            self.write(child, indent + 1);
        }
        self.out += &format!("</{}>", element.name);
    }

    /// Begins the line of an element, if the text is not there yet.
    fn go_to(&mut self, element: &Element, indent: usize) {
        let is_elsewhere = self.file != element.file || element.line < self.line;
        if is_elsewhere || element.line > self.line.saturating_add(FAR) {
            let break_before = if self.out.is_empty() { "" } else { "\n" };
            let file = element.file.replace("?>", "");
            self.out +=
                &format!("{break_before}<?{FROM} {} {file}?>\n", element.line.saturating_sub(1));
            (self.file, self.line) = (element.file.clone(), element.line);
        } else if element.line > self.line {
            self.out.extend(std::iter::repeat_n('\n', (element.line - self.line) as usize));
            self.line = element.line;
        } else {
            return;
        }
        self.out += &"  ".repeat(indent);
    }
}

/// Empty lines that are written rather than an instruction.
const FAR: u32 = 20;

fn escaped(value: &str) -> String {
    value
        .replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('"', "&quot;")
        .replace('\t', "&#9;")
        .replace('\n', "&#10;")
        .replace('\r', "&#13;")
}

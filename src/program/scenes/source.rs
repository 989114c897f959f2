//! A scene as it is written: its values, and where each of them is from.

use crate::program::settings::VERSION;
use crate::program::settings::config_error::ConfigError;
use crate::program::tasks::{self, AnyTaskSpec, Scene};
use anyhow::{Context, Result, anyhow, bail};
use serde::Deserialize;
use std::collections::HashMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;
use toml::de::{DeTable, DeValue, Deserializer};
use toml::{Table, Value};

/// Bytes of a scene. A preset has about 2,000; parsing takes up to 100 times as much memory.
const MOST_BYTES: usize = 1_000_000;

/// Parts of a dotted key that an option may have. Keys of scenes have up to three.
const MOST_PARTS: usize = 8;

/// The sections whose parts are there or not.
pub const OPTIONAL: [&str; 2] = ["effects", "actuator"];

/// Settings of a file, and what the command line makes of them, before anything is known of the task.
#[derive(Clone)]
pub struct SceneSource {
    /// What it is called in messages.
    name: String,
    table: Table,
    /// Text of the file.
    text: String,
    /// The option that set a dotted key, or made its section.
    options: HashMap<String, String>,
}

impl SceneSource {
    /// The file at this path.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let mut bytes = Vec::new();
        let read = File::open(path).and_then(|file| file.take(1 + MOST_BYTES as u64).read_to_end(&mut bytes));
        read.with_context(|| format!("cannot read {name}"))?;
        if bytes.len() > MOST_BYTES {
            bail!("{name} has more than {MOST_BYTES} bytes, which is too long for a scene");
        }
        let text = std::str::from_utf8(&bytes).with_context(|| format!("{name} is no text in UTF-8"))?;
        Self::parse(&name, text)
    }

    /// The text of the file of this name.
    pub fn parse(name: &str, text: &str) -> Result<Self> {
        let wrong = |error: toml::de::Error| match error.span() {
            Some(span) => {
                let begin = text[..span.start].rfind('\n').map_or(0, |end| end + 1);
                let written = text[begin..].lines().next().unwrap_or_default().trim();
                anyhow!("{name}:{}: {}: {}", line(text, span.start), error.message(), short(written))
            }
            None => anyhow!("{name} cannot be read: {}", error.message()),
        };
        let parsed = DeTable::parse(text).map_err(wrong)?;
        let table = Table::deserialize(Deserializer::from(parsed)).map_err(wrong)?;
        Ok(Self { name: name.to_owned(), table, text: text.to_owned(), options: HashMap::new() })
    }

    /// The value at the top of the document.
    pub fn text(&self, key: &str) -> Option<&str> {
        self.table.get(key)?.as_str()
    }

    /// Puts a value at a dotted key, whether there is one or not, because this option says so.
    pub fn put(&mut self, key: &str, value: Value, option: &str) -> Result<()> {
        let (sections, last) = key.rsplit_once('.').unwrap_or(("", key));
        let parts = key.split('.').count();
        if parts > MOST_PARTS {
            bail!("{option}: the key has {parts} parts; allowed: up to {MOST_PARTS}");
        }
        if last.is_empty() {
            bail!("{option}: an empty key cannot be set");
        }
        let mut inner = &mut self.table;
        let mut path = String::new();
        for part in sections.split('.').filter(|part| !part.is_empty()) {
            path = join(&path, part);
            let section = inner.entry(part).or_insert_with(|| {
                self.options.insert(path.clone(), option.to_owned());
                Value::Table(Table::new())
            });
            inner = section.as_table_mut().with_context(|| format!("{option}: `{path}` is no section"))?;
        }
        if let Some(Value::Table(section)) = inner.get(last) {
            if value.as_table().is_some_and(Table::is_empty) {
                // It is asked for, and there.
                return Ok(());
            }
            let keys: Vec<String> = section.keys().map(|inner| format!("{key}.{inner}")).collect();
            bail!("{option}: `{key}` is a section; set one of its keys: {}", keys.join(", "));
        }
        inner.insert(last.into(), value);
        self.options.insert(key.to_owned(), option.to_owned());
        Ok(())
    }

    /// Takes a whole section away, if it is there.
    pub fn without_section(&mut self, name: &str) {
        self.table.remove(name);
    }

    /// Whether it has this effect or part of the actuator.
    pub fn has(&self, name: &str) -> bool {
        let name = part(name);
        OPTIONAL.iter().any(|section| self.table.get(*section).is_some_and(|section| section.get(name).is_some()))
    }

    /// Takes an effect or a part of the actuator away, which must be there.
    pub fn without(&mut self, name: &str) -> Result<()> {
        let name = part(name);
        let sections = || OPTIONAL.into_iter().filter_map(|section| self.table.get(section)?.as_table());
        let there: Vec<String> = sections().flat_map(|section| section.keys().cloned()).collect();
        if !self.has(name) {
            let there = if there.is_empty() { "none".into() } else { there.join(", ") };
            bail!("--without {name}: {} has no such effect or part of the actuator; it has {there}", self.name);
        }
        for section in OPTIONAL {
            if let Some(section) = self.table.get_mut(section).and_then(Value::as_table_mut) {
                section.remove(name);
            }
        }
        Ok(())
    }

    /// The scene that it describes: where it is silent, the task's defaults, but no effect that it does not name.
    pub fn scene(&self) -> Result<Scene> {
        self.checked().map_err(|problem| anyhow!("{}: {problem}", self.origin(&problem.key)))
    }

    fn checked(&self) -> Result<Scene, ConfigError> {
        match self.table.get("scene") {
            None => {
                let what = format!("is missing; a scene begins with `scene = {VERSION}`, the version of the format");
                return Err(ConfigError::new("scene", what));
            }
            Some(Value::Integer(VERSION)) => {}
            Some(other) => {
                let what = format!("is {other}; this version of physgrad reads scenes of version {VERSION}");
                return Err(ConfigError::new("scene", what));
            }
        }
        let names = || tasks::TASKS.map(|task| task.name()).join(", ");
        let task = match self.table.get("task") {
            None => return Err(ConfigError::new("task", format!("is missing; allowed: {}", names()))),
            Some(task) => task,
        };
        let kind = tasks::TASKS.into_iter().find(|kind| task.as_str() == Some(kind.name()));
        let kind = kind.ok_or_else(|| ConfigError::new("task", format!("is {task}; allowed: {}", names())))?;
        let mut settings = kind.defaults();
        overlay(&mut settings, &self.table);
        if settings.get("physgrad").is_some_and(Value::is_str) {
            // Whatever version a saved run is of, what is made of it now is of this one.
            settings.insert("physgrad".into(), env!("CARGO_PKG_VERSION").into());
        }
        kind.scene(settings).map_err(|problem| of_another_task(kind, problem))
    }

    /// The option or line that a key is from, or else its section.
    fn origin(&self, key: &str) -> String {
        let sections = std::iter::successors(Some(key), |key| key.rfind(['.', '[']).map(|end| &key[..end]));
        // An option replaces whatever the file has within its key.
        if let Some(option) = sections.into_iter().find_map(|key| self.options.get(key)) {
            return option.clone();
        }
        let parsed = DeTable::parse(&self.text).ok();
        match parsed.and_then(|parsed| place(&DeValue::Table(parsed.into_inner()), key)) {
            Some(at) => format!("{}:{}", self.name, line(&self.text, at)),
            None => self.name.clone(),
        }
    }
}

/// Says so if what is unknown here is an effect of another task.
fn of_another_task(kind: &dyn AnyTaskSpec, problem: ConfigError) -> ConfigError {
    let has = |kind: &dyn AnyTaskSpec| kind.effects().iter().any(|info| problem.key == format!("effects.{}", info.name));
    match tasks::TASKS.into_iter().find(|other| has(*other)) {
        Some(other) if !has(kind) => {
            let here: Vec<&str> = kind.effects().iter().map(|info| info.name).collect();
            let what = format!("is an effect of {}, not of {}; allowed here: {}", other.name(), kind.name(), here.join(", "));
            ConfigError::new(problem.key, what)
        }
        _ => problem,
    }
}

/// Position in the text of the key at this dotted path, or else of its section.
fn place(value: &DeValue, path: &str) -> Option<usize> {
    match value {
        DeValue::Table(table) => table.iter().find_map(|(key, inner)| {
            let rest = path.strip_prefix('.').unwrap_or(path).strip_prefix(&**key.get_ref())?;
            let is_whole = rest.is_empty() || rest.starts_with(['.', '[']);
            is_whole.then(|| place(inner.get_ref(), rest).unwrap_or(key.span().start))
        }),
        DeValue::Array(items) => {
            let (index, rest) = path.strip_prefix('[')?.split_once(']')?;
            let item = items.get(index.parse::<usize>().ok()?)?;
            Some(place(item.get_ref(), rest).unwrap_or(item.span().start))
        }
        _ => None,
    }
}

/// The text, or its beginning if it is long for a message.
pub fn short(text: &str) -> String {
    const MOST: usize = 100;
    match text.char_indices().nth(MOST) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.into(),
    }
}

/// Number of the line at a position in the text.
fn line(text: &str, at: usize) -> usize {
    1 + text.bytes().take(at).filter(|&byte| byte == b'\n').count()
}

/// What is called `bumpers` may also be called `effects.bumpers`.
fn part(name: &str) -> &str {
    OPTIONAL.iter().find_map(|section| name.strip_prefix(section)?.strip_prefix('.')).unwrap_or(name)
}

fn join(path: &str, key: &str) -> String {
    if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") }
}

/// Puts the upper values in place of the lower ones, section by section.
fn overlay(lower: &mut Table, upper: &Table) {
    for (key, value) in upper {
        match (lower.get_mut(key), value) {
            (Some(Value::Table(lower)), Value::Table(upper)) => overlay(lower, upper),
            _ => {
                lower.insert(key.clone(), value.clone());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WINDY: &str = "scene = 1\n[effects.wind]\nspeed = 3\n[actuator]\nlag = { time = 1 }\n[[effects.walls]]\nx = 1\n";

    #[test]
    fn every_key_knows_its_line() {
        let document = SceneSource::parse("a.toml", WINDY).expect("TOML");
        for (key, line) in [
            ("scene", 1),
            ("effects.wind", 2),
            ("effects.wind.speed", 3),
            ("effects.wind.of_the_default", 2),
            ("actuator.lag.time", 5),
            ("effects.walls[0].x", 7),
        ] {
            assert_eq!(document.origin(key), format!("a.toml:{line}"), "{key}");
        }
        assert_eq!(document.origin("task"), "a.toml");
    }

    #[test]
    fn effects_come_and_go() {
        let mut document = SceneSource::parse("a.toml", WINDY).expect("TOML");
        let error = document.without("rain").expect_err("there is none").to_string();
        assert!(error.ends_with("it has wind, walls, lag"), "{error}");
        document.without("effects.wind").expect("an effect");
        document.without("lag").expect("a part of the actuator");
        assert!(document.without("wind").is_err(), "it is gone");
        document.put("effects.rain.rate", Value::Integer(2), "--set").expect("another");
        assert_eq!(document.table["effects"]["rain"]["rate"].as_integer(), Some(2));
        assert_eq!([document.origin("effects.rain"), document.origin("effects.rain.rate")], ["--set"; 2]);
        document.put("effects.walls", Value::Integer(2), "--set walls").expect("a list is a value");
        assert_eq!(document.origin("effects.walls[0].x"), "--set walls", "the line of the old one is forgotten");
        let error = document.put("effects.rain", Value::Integer(2), "--set").expect_err("a section").to_string();
        assert!(error.ends_with("set one of its keys: effects.rain.rate"), "{error}");
    }
}

//! A scene as it is written: its values, and where each of them is from.

use super::kind::{self, AnyKind};
use super::problem::Problem;
use super::scene::Scene;
use super::settings::VERSION;
use anyhow::{Context, Result, anyhow, bail};
use serde::Deserialize;
use std::collections::HashMap;
use std::path::Path;
use toml::de::{DeTable, DeValue, Deserializer};
use toml::{Table, Value};

/// The sections whose parts are there or not.
pub const OPTIONAL: [&str; 2] = ["effects", "actuator"];

/// Settings of a file, and what the command line makes of them, before anything is known of the task.
#[derive(Clone)]
pub struct Document {
    /// What it is called in messages.
    name: String,
    table: Table,
    /// Of dotted keys: the file and the line, or the option.
    origins: HashMap<String, String>,
}

impl Document {
    /// The file at this path.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
        Self::parse(&path.display().to_string(), &text)
    }

    /// The text of the file of this name.
    pub fn parse(name: &str, text: &str) -> Result<Self> {
        let line = |at: usize| format!("{name}:{}", 1 + text.bytes().take(at).filter(|&byte| byte == b'\n').count());
        let wrong = |error: toml::de::Error| anyhow!("{}: {error}", line(error.span().map_or(0, |span| span.start)));
        let parsed = DeTable::parse(text).map_err(wrong)?;
        let mut origins = HashMap::new();
        locate(parsed.get_ref(), "", &mut |key, at| {
            origins.insert(key, line(at));
        });
        let table = Table::deserialize(Deserializer::from(parsed)).map_err(wrong)?;
        Ok(Self { name: name.to_owned(), table, origins })
    }

    /// The value at the top of the document.
    pub fn text(&self, key: &str) -> Option<&str> {
        self.table.get(key)?.as_str()
    }

    /// Puts a value at a dotted key, whether there is one or not, because this option says so.
    pub fn put(&mut self, key: &str, value: Value, option: &str) -> Result<()> {
        let (sections, last) = key.rsplit_once('.').unwrap_or(("", key));
        if last.is_empty() {
            bail!("{option}: an empty key cannot be set");
        }
        let mut inner = &mut self.table;
        let mut path = String::new();
        for part in sections.split('.').filter(|part| !part.is_empty()) {
            path = join(&path, part);
            let section = inner.entry(part).or_insert_with(|| {
                self.origins.insert(path.clone(), option.to_owned());
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
        // What was within the old value is gone.
        self.origins.retain(|other, _| !other.strip_prefix(key).is_some_and(|rest| rest.starts_with(['.', '['])));
        self.origins.insert(key.to_owned(), option.to_owned());
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

    fn checked(&self) -> Result<Scene, Problem> {
        match self.table.get("scene") {
            None => {
                let what = format!("is missing; a scene begins with `scene = {VERSION}`, the version of the format");
                return Err(Problem::new("scene", what));
            }
            Some(Value::Integer(VERSION)) => {}
            Some(other) => {
                let what = format!("is {other}; this version of physgrad reads scenes of version {VERSION}");
                return Err(Problem::new("scene", what));
            }
        }
        let tasks = || kind::KINDS.map(|kind| kind.name()).join(", ");
        let task = match self.table.get("task") {
            None => return Err(Problem::new("task", format!("is missing; allowed: {}", tasks()))),
            Some(task) => task,
        };
        let kind = kind::KINDS.into_iter().find(|kind| task.as_str() == Some(kind.name()));
        let kind = kind.ok_or_else(|| Problem::new("task", format!("is {task}; allowed: {}", tasks())))?;
        let mut settings = kind.defaults();
        overlay(&mut settings, &self.table);
        if settings.get("physgrad").is_some_and(Value::is_str) {
            // Whatever version a saved run is of, what is made of it now is of this one.
            settings.insert("physgrad".into(), env!("CARGO_PKG_VERSION").into());
        }
        kind.scene(settings).map_err(|problem| of_another_task(kind, problem))
    }

    /// Where a key is from, or else the section it is in.
    fn origin(&self, key: &str) -> &str {
        let mut key = key;
        loop {
            match (self.origins.get(key), key.rfind(['.', '['])) {
                (Some(origin), _) => return origin,
                (None, Some(end)) => key = &key[..end],
                (None, None) => return &self.name,
            }
        }
    }
}

/// Says so if what is unknown here is an effect of another task.
fn of_another_task(kind: &dyn AnyKind, problem: Problem) -> Problem {
    let has = |kind: &dyn AnyKind| kind.effects().iter().any(|info| problem.key == format!("effects.{}", info.name));
    match kind::KINDS.into_iter().find(|other| has(*other)) {
        Some(other) if !has(kind) => {
            let here: Vec<&str> = kind.effects().iter().map(|info| info.name).collect();
            let what = format!("is an effect of {}, not of {}; allowed here: {}", other.name(), kind.name(), here.join(", "));
            Problem::new(problem.key, what)
        }
        _ => problem,
    }
}

/// Tells of every key, dotted, where in the text it is.
fn locate(table: &DeTable, path: &str, tell: &mut impl FnMut(String, usize)) {
    for (key, value) in table {
        let path = join(path, key.get_ref());
        tell(path.clone(), key.span().start);
        match value.get_ref() {
            DeValue::Table(section) => locate(section, &path, tell),
            DeValue::Array(items) => {
                for (i, item) in items.iter().enumerate() {
                    let path = format!("{path}[{i}]");
                    tell(path.clone(), item.span().start);
                    if let DeValue::Table(section) = item.get_ref() {
                        locate(section, &path, tell);
                    }
                }
            }
            _ => {}
        }
    }
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
        let document = Document::parse("a.toml", WINDY).expect("TOML");
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
        let mut document = Document::parse("a.toml", WINDY).expect("TOML");
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

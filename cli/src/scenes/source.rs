//! [`SceneSource`]: a scene before validation, with the line or option of every value.
//!
//! A scene is read in four stages. [`SceneSource::read`] parses the TOML file, and options of the
//! command line override values. [`SceneSource::scene`] then finds the task, and the settings of
//! the task get their defaults and are validated (`tasks/settings.rs`).

use crate::platform::files;
use crate::platform::folder::{Folder, MAX_SETTINGS};
use crate::platform::terminal::did_you_mean;
use crate::scenes::ranges::{with_methods, with_numbers, with_range};
use crate::settings::config_error::{ConfigError, Problem, one_of};
use crate::settings::reading::{flat, is_drawn, is_number, overlay};
use crate::settings::{OPTIONAL, VERSION};
use crate::tasks::policy::{COMMON, is_kind};
use crate::tasks::scene::{INITIAL_POLICY, make_bare};
use crate::tasks::{self, AnyTaskSpec, FileSetting, Scene};
use anyhow::{Context, Result, anyhow, bail};
use serde::Deserialize;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use toml::de::{DeTable, DeValue, Deserializer};
use toml::{Table, Value};

/// Largest number of parts of a dotted key in [`SceneSource::put`]. Keys of built-in tasks have up
/// to three.
const MAX_PARTS: usize = 8;

/// Unvalidated settings of a scene file, with the overrides of the command line.
#[derive(Clone, Debug)]
pub struct SceneSource {
    /// Name in messages.
    name: String,
    table: Table,
    /// Folder of the file. None for a preset.
    folder: Option<PathBuf>,
    /// Text of the file, for line numbers.
    text: String,
    /// Option that set a key or created a section, by the dotted name of the key or section.
    options: HashMap<String, String>,
    /// Keys of the last changes, which another kind of policy keeps.
    recent: HashSet<String>,
    /// Keys that changes have added, in order.
    added: Vec<String>,
}

impl SceneSource {
    /// Reads the file at this path.
    pub fn read(path: &Path) -> Result<Self> {
        let source = Self::parse(&path.display().to_string(), &read_text(path)?)?;
        Ok(Self { folder: path.parent().map(Path::to_owned), ..source })
    }

    /// Parses the text of the file with this name.
    pub fn parse(name: &str, text: &str) -> Result<Self> {
        Self::of(name, text, parse_table(name, text)?)
    }

    /// Source of a scene that is part of another file in `folder`. Messages about its settings name
    /// no line.
    pub fn inner(name: &str, table: Table, folder: &Path) -> Result<Self> {
        Ok(Self { folder: Some(folder.to_owned()), ..Self::of(name, "", table)? })
    }

    fn of(name: &str, text: &str, table: Table) -> Result<Self> {
        let mut source = Self {
            name: name.to_owned(),
            table,
            folder: None,
            text: text.to_owned(),
            options: HashMap::new(),
            recent: HashSet::new(),
            added: Vec::new(),
        };
        source.place("vary")?;
        source.place("fit")?;
        Ok(source)
    }

    /// Moves the entries of the section `vary` or `fit` to the keys that they name.
    fn place(&mut self, section: &str) -> Result<()> {
        let Some(entries) = self.table.remove(section) else { return Ok(()) };
        let Value::Table(entries) = entries else {
            bail!("{}: `{section}` is not a section", self.origin(section))
        };
        for (key, value) in entries {
            let origin = self.origin(&format!("{section}.{key}"));
            let table = value.as_table();
            let (suits, allowed) = match section {
                "fit" => (
                    table.is_some_and(|table| table.contains_key("start")),
                    "{ start = value, min = bound, max = bound }; bounds are optional",
                ),
                _ => (
                    table.is_some_and(is_drawn),
                    "{ uniform = [low, high] }, another distribution, or { noise = deviation }",
                ),
            };
            if !suits {
                // TOML splits keys without quotation marks at their dots.
                let is_split = table.is_some() && !key.contains('.');
                let quoted = if is_split { "; write dotted keys in quotation marks" } else { "" };
                bail!("{origin}: `{key}` is {value}; allowed in [{section}]: {allowed}{quoted}");
            }
            if let Some(before) = self.get(&key) {
                let other = match section {
                    "fit" if before.as_table().is_some_and(is_drawn) => "as a number that varies",
                    _ => "in its own section",
                };
                bail!("{origin}: `{key}` is set twice: in [{section}] and {other}");
            }
            self.put(&key, value, &origin)?;
        }
        Ok(())
    }

    /// Value of a dotted key.
    fn get(&self, key: &str) -> Option<&Value> {
        find(&self.table, key)
    }

    /// Value of a top-level key. None if the key is absent or its value is not text.
    pub fn text(&self, key: &str) -> Option<&str> {
        self.table.get(key)?.as_str()
    }

    /// Begins further changes of the scene, after which a kind of policy keeps no earlier ones.
    pub fn begin_changes(&mut self) {
        self.recent.clear();
    }

    /// Sets the value of a dotted key. Messages name `option` as the source of the value.
    pub fn put(&mut self, key: &str, value: Value, option: &str) -> Result<()> {
        let (sections, last) = key.rsplit_once('.').unwrap_or(("", key));
        let parts = key.split('.').count();
        if parts > MAX_PARTS {
            bail!("{option}: the key has {parts} parts; allowed: up to {MAX_PARTS}");
        }
        if last.is_empty() {
            bail!("{option}: the key is empty; write KEY=VALUE, for example system.poles=4");
        }
        if is_kind(key) {
            self.leave_kind(sections, &value);
        }
        let mut inner = &mut self.table;
        let mut path = String::new();
        for part in sections.split('.').filter(|part| !part.is_empty()) {
            path = join(&path, part);
            if let Some((list, index)) = element(part) {
                let found =
                    inner.get_mut(list).and_then(|list| list.get_mut(index)?.as_table_mut());
                inner = found.with_context(|| {
                    format!(
                        "{option}: the scene has no `{path}`; list all elements in the scene first"
                    )
                })?;
                continue;
            }
            let section = inner.entry(part).or_insert_with(|| {
                self.options.insert(path.clone(), option.to_owned());
                Value::Table(Table::new())
            });
            inner = section
                .as_table_mut()
                .with_context(|| format!("{option}: `{path}` is not a section"))?;
        }
        if let Some(Value::Table(section)) = inner.get(last)
            && !is_number(section)
        {
            // A table replaces only those keys of a section that it contains.
            if let Value::Table(values) = value {
                return values.into_iter().try_for_each(|(inner, value)| {
                    self.put(&format!("{key}.{inner}"), value, option)
                });
            }
            let keys: Vec<String> = section.keys().map(|inner| format!("{key}.{inner}")).collect();
            let keys = if keys.is_empty() { format!("`{key}.KEY=VALUE`") } else { keys.join(", ") };
            bail!("{option}: `{key}` is a section; set one of its keys: {keys}");
        }
        if inner.insert(last.into(), value).is_none() {
            self.added.push(key.to_owned());
        }
        self.options.insert(key.to_owned(), option.to_owned());
        self.recent.insert(key.to_owned());
        Ok(())
    }

    /// Removes the settings of the present kind of policy in this section, if `kind` is another one.
    /// Keeps what every kind has, and what options have set.
    fn leave_kind(&mut self, section: &str, kind: &Value) {
        let Self { table, recent, .. } = self;
        let default = table.get("task").and_then(Value::as_str).and_then(|task| {
            let spec = tasks::all().iter().find(|spec| spec.name() == task)?;
            (section == "policy").then(|| Value::from(spec.policy()))
        });
        let found = section
            .split('.')
            .try_fold(table, |table, part| table.get_mut(part).and_then(Value::as_table_mut));
        let Some(settings) = found else { return };
        if settings.get("kind").or(default.as_ref()) != Some(kind) {
            settings.retain(|key, _| COMMON.contains(&key) || recent.contains(&join(section, key)));
        }
    }

    /// Name in messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Settings, without defaults.
    pub fn table(&self) -> &Table {
        &self.table
    }

    /// Replaces a number by a fixed value, even if it is drawn or trained.
    pub fn fix(&mut self, key: &str, value: f64) -> Result<()> {
        self.put(key, Value::Float(value), &format!("{key} = {value}"))
    }

    /// Replaces the value of a dotted key, even if the present value is the table of a number. A
    /// table changes only its keys of a section that is present.
    pub fn replace(&mut self, key: &str, value: Value, option: &str) -> Result<()> {
        let is_section = |value: &Value| value.as_table().is_some_and(|table| !is_number(table));
        if is_section(&value) && self.get(key).is_some_and(is_section) {
            let Value::Table(values) = value else { unreachable!("a section is a table") };
            return values.into_iter().try_for_each(|(inner, value)| {
                self.replace(&format!("{key}.{inner}"), value, option)
            });
        }
        let (section, last) = key.rsplit_once('.').unwrap_or(("", key));
        let mut path = section.split('.').filter(|part| !part.is_empty());
        let section = path.try_fold(&mut self.table, |table, part| match element(part) {
            Some((list, index)) => table.get_mut(list)?.get_mut(index)?.as_table_mut(),
            None => table.get_mut(part)?.as_table_mut(),
        });
        if let Some(before) = section.and_then(|section| section.get_mut(last))
            && before.is_table()
        {
            // `put` would change single keys of a table.
            *before = Value::Boolean(false);
        }
        self.put(key, value, option)
    }

    /// Removes a section if it is present.
    pub fn without_section(&mut self, name: &str) {
        self.table.remove(name);
    }

    /// Removes the sensor and the end of episodes.
    pub fn make_bare(&mut self) {
        make_bare(&mut self.table);
    }

    /// Returns whether the scene has this effect or part of the actuator or the sensor.
    pub fn has(&self, name: &str) -> bool {
        let part = part_name(name);
        sections_of(name).any(|section| {
            self.table.get(section).is_some_and(|section| section.get(part).is_some())
        })
    }

    /// Removes an effect or a part of the actuator or the sensor. A name may begin with the section, as in
    /// `actuator.lag`.
    ///
    /// # Errors
    /// The scene has no such effect or part.
    pub fn without(&mut self, name: &str) -> Result<()> {
        self.remove(name, &format!("--without {name}"))
    }

    /// [`without`](Self::without) for a name from `option`.
    pub fn remove(&mut self, name: &str, option: &str) -> Result<()> {
        let part = part_name(name);
        let chosen: Vec<&str> = sections_of(name).collect();
        let parts = |section: &&str| {
            self.table.get(*section).and_then(Value::as_table).into_iter().flat_map(Table::keys)
        };
        let present: Vec<&str> = OPTIONAL.iter().flat_map(parts).map(String::as_str).collect();
        if !chosen.iter().flat_map(parts).any(|key| key == part) {
            let present = if present.is_empty() { "none".into() } else { present.join(", ") };
            bail!(
                "{option}: {} has no such effect or part of the actuator or the sensor; it has {present}",
                self.name
            );
        }
        let having: Vec<&str> = { chosen.iter().copied() }
            .filter(|section| parts(section).any(|key| key == part))
            .collect();
        if let [first, second, ..] = having[..] {
            bail!(
                "{option}: {} has {first}.{part} and {second}.{part}; write one of these",
                self.name
            );
        }
        for section in having {
            if let Some(section) = self.table.get_mut(section).and_then(Value::as_table_mut) {
                section.remove(part);
            }
        }
        Ok(())
    }

    /// Validates the scene. Absent settings get the task's defaults. Absent effects stay absent.
    ///
    /// # Errors
    /// A setting is invalid. The file of the initial policy cannot be read.
    pub fn scene(&self) -> Result<Scene> {
        self.starting_from(None)
    }

    /// Validates the scene as [`scene`](Self::scene) does. With the contents of an initial policy,
    /// does not read its file.
    pub fn starting_from(&self, policy: Option<&[u8]>) -> Result<Scene> {
        let scene = self.validate().map_err(|error| self.located(&error))?;
        let policy = policy.map(|policy| Ok(Some(policy.to_vec())));
        let policy = policy.unwrap_or_else(|| self.initial_policy())?;
        Ok(policy.into_iter().fold(scene, Scene::starting_from))
    }

    /// The error with the line or option of its setting.
    pub fn located(&self, error: &ConfigError) -> anyhow::Error {
        anyhow!("{}: {error}", self.origin(&error.key))
    }

    /// Contents of the file of the initial policy. None if the scene names no file.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn initial_policy(&self) -> Result<Option<Vec<u8>>> {
        let Some(file) = self.text(INITIAL_POLICY) else { return Ok(None) };
        let bytes = Folder::at(self.folder_of(INITIAL_POLICY)).read(file);
        bytes
            .map(Some)
            .with_context(|| format!("{}: `{INITIAL_POLICY}`", self.origin(INITIAL_POLICY)))
    }

    /// Error of a setting for which the scene is refused, if any. Does not read the file of an
    /// initial policy.
    pub fn refusal(&self) -> Option<ConfigError> {
        self.validate().err()
    }

    /// [`refusal`](Self::refusal) with these values of numbers that vary, by key.
    ///
    /// # Errors
    /// A key is no setting.
    pub fn refusal_with<'a>(
        &self,
        numbers: impl Iterator<Item = (&'a str, f64)>,
    ) -> Result<Option<ConfigError>> {
        let mut fixed = self.clone();
        for (key, value) in numbers {
            fixed.fix(key, value)?;
        }
        Ok(fixed.refusal())
    }

    fn validate(&self) -> Result<Scene, ConfigError> {
        match self.table.get("scene") {
            None => {
                let what = format!(
                    "is missing; a scene begins with `scene = {VERSION}`, the version of the scene format"
                );
                return Err(ConfigError::new("scene", what));
            }
            Some(Value::Integer(VERSION)) => {}
            Some(other) => {
                let what = format!(
                    "is {other}; this version of physgrad reads scenes of version {VERSION}"
                );
                return Err(ConfigError::new("scene", what));
            }
        }
        let names = || tasks::all().iter().map(|task| task.name()).collect::<Vec<_>>().join(", ");
        let task = match self.table.get("task") {
            None => {
                return Err(ConfigError::new("task", format!("is missing; allowed: {}", names())));
            }
            Some(task) => task,
        };
        let spec = tasks::all().iter().copied().find(|spec| task.as_str() == Some(spec.name()));
        let spec = spec.ok_or_else(|| {
            ConfigError::new(
                "task",
                format!("is {task}; allowed: {}, or a task of your own in its program", names()),
            )
        })?;
        let table = self.with_file(spec)?;
        let settings = || {
            let mut settings = spec.defaults(&table);
            overlay(&mut settings, &table);
            if settings.get("physgrad").is_some_and(Value::is_str) {
                // Replaces the version in the settings of a saved run: this version creates the
                // scene.
                settings.insert("physgrad".into(), env!("CARGO_PKG_VERSION").into());
            }
            settings
        };
        let explained = |error| suggest(spec, &self.table, explain_foreign_effect(spec, error));
        let scene = spec.scene(settings()).map_err(|error| {
            let error =
                with_methods(spec, settings, with_numbers(spec, settings, explained(error)));
            self.with_distribution(with_range(spec, settings, error))
        })?;
        self.refuse_unused(&scene)?;
        Ok(scene)
    }

    /// The table with the contents of the file that a setting of the task names.
    fn with_file(&self, spec: &dyn AnyTaskSpec) -> Result<Table, ConfigError> {
        let mut table = self.table.clone();
        let Some(FileSetting { key, read }) = spec.file() else { return Ok(table) };
        let (section, name) = key.rsplit_once('.').unwrap_or(("", key));
        let value = table.get_mut(section).and_then(|section| section.get_mut(name));
        if let Some(Value::String(text)) = value {
            *text = read(text, self.folder_of(key)).map_err(|what| ConfigError::new(key, what))?;
        }
        Ok(table)
    }

    /// Folder to which the path in a setting is relative: that of the file, or the working folder
    /// for an option.
    fn folder_of(&self, key: &str) -> &Path {
        let is_option = self.options.contains_key(key);
        self.folder.as_deref().filter(|_| !is_option).unwrap_or(Path::new(""))
    }

    /// Refuses a name that a change has added and no expression uses: it is misspelt, and the
    /// change would have no effect.
    fn refuse_unused(&self, scene: &Scene) -> Result<(), ConfigError> {
        let unused = scene.unused();
        let Some(key) = self.added.iter().find(|key| unused.contains(key)) else { return Ok(()) };
        let (section, name) = key.rsplit_once('.').unwrap_or(("", key));
        let names = self.get(section).and_then(Value::as_table).into_iter().flat_map(Table::keys);
        let known: Vec<&str> = { names.map(String::as_str) }
            .filter(|name| !self.added.contains(&join(section, name)))
            .collect();
        let hint = did_you_mean(name, known.iter().copied());
        let what = format!("is a name that no expression uses; known: {}{hint}", one_of(&known));
        Err(ConfigError::new(key, what))
    }

    /// Adds the distribution of a number that varies to an error of one of its values.
    fn with_distribution(&self, mut error: ConfigError) -> ConfigError {
        let value = self.get(&error.key).filter(|value| value.as_table().is_some_and(is_drawn));
        if let (Some(value), Problem::Value { found, .. }) = (value, &mut error.problem) {
            let normal = value.get("normal").is_some();
            let reach = if normal { ", which reaches 3 standard deviations" } else { "" };
            *found = format!("{found} in {value}{reach}");
        }
        error
    }

    /// Option or line that set a key or, for an absent key, its section.
    fn origin(&self, key: &str) -> String {
        let sections =
            std::iter::successors(Some(key), |key| key.rfind(['.', '[']).map(|end| &key[..end]));
        // An option replaces everything that the file has below its key.
        if let Some(option) = sections.into_iter().find_map(|key| self.options.get(key)) {
            return option.clone();
        }
        place(&self.name, &self.text, key)
    }
}

/// Text of a file of settings.
pub(super) fn read_text(path: &Path) -> Result<String> {
    let name = path.display();
    let bytes = files::read(path, MAX_SETTINGS).with_context(|| format!("cannot read {name}"))?;
    let bytes = bytes.with_context(|| {
        format!("{name} has more than {MAX_SETTINGS} bytes, the limit of a file of settings")
    })?;
    String::from_utf8(bytes).with_context(|| format!("{name} is not UTF-8 text"))
}

/// Parses the text of the file with this name.
///
/// # Errors
/// The text is not TOML. The message has the line.
pub(super) fn parse_table(name: &str, text: &str) -> Result<Table> {
    let located = |error: toml::de::Error| match error.span() {
        Some(span) => {
            let start = text[..span.start].rfind('\n').map_or(0, |end| end + 1);
            let snippet = text[start..].lines().next().unwrap_or_default().trim();
            anyhow!("{name}:{}: {}: {}", line(text, span.start), error.message(), short(snippet))
        }
        None => anyhow!("{name} cannot be read: {}", error.message()),
    };
    let parsed = DeTable::parse(text).map_err(located)?;
    Table::deserialize(Deserializer::from(parsed)).map_err(located)
}

/// File and line of a key or, for an absent key, of its section. Without either in the text, only
/// the file.
pub(super) fn place(name: &str, text: &str, key: &str) -> String {
    let parsed = DeTable::parse(text).ok();
    match parsed.and_then(|parsed| offset(&DeValue::Table(parsed.into_inner()), key)) {
        Some(offset) => format!("{name}:{}", line(text, offset)),
        None => name.to_owned(),
    }
}

/// Replaces the error if the unknown key is an effect of another task.
fn explain_foreign_effect(spec: &dyn AnyTaskSpec, error: ConfigError) -> ConfigError {
    let has = |spec: &dyn AnyTaskSpec| {
        spec.effects().iter().any(|info| error.key == format!("effects.{}", info.name))
    };
    match tasks::all().iter().find(|other| has(**other)) {
        Some(other) if !has(spec) => {
            let effects = spec.effects();
            let names: Vec<&str> = effects.iter().map(|info| info.name).collect();
            let allowed = if names.is_empty() { "none".into() } else { names.join(", ") };
            let what = format!(
                "is an effect of {}, not of {}; allowed here: {allowed}",
                other.name(),
                spec.name()
            );
            ConfigError::new(error.key, what)
        }
        _ => error,
    }
}

/// Adds the most similar key to the error of an unknown key.
fn suggest(spec: &dyn AnyTaskSpec, table: &Table, mut error: ConfigError) -> ConfigError {
    if let Problem::Unknown { allowed, hint } = &mut error.problem {
        let (section, name) = error.key.rsplit_once('.').unwrap_or(("", &error.key));
        let siblings = allowed.iter().map(|sibling| join(section, sibling));
        let settings = flat(&spec.defaults(table)).into_iter().map(|(key, _)| key);
        let effects = spec.effects().into_iter().map(|info| format!("effects.{}", info.name));
        let is_other = |key: &String| !error.key.starts_with(&format!("{key}."));
        let keys: Vec<String> = siblings.chain(settings).chain(effects).filter(is_other).collect();
        // Prefers a key of this name in another section, as in `training.learning_rate` for
        // `learning_rate`, to a key with a similar name.
        let same = keys.iter().find(|key| key.rsplit('.').next() == Some(name));
        let parameters = find(table, "system.parameters").and_then(Value::as_table);
        let parameters: Vec<&str> = parameters
            .filter(|_| section == "system")
            .into_iter()
            .flat_map(Table::keys)
            .map(String::as_str)
            .collect();
        let similar = did_you_mean(name, parameters.iter().copied());
        *hint = match same {
            Some(key) => format!("; did you mean `{key}`?"),
            None if !similar.is_empty() => {
                let what = format!("is unknown; parameters: {}{similar}", one_of(&parameters));
                return ConfigError::new(error.key, what);
            }
            None => did_you_mean(&error.key, keys.iter().map(String::as_str)),
        };
        if !parameters.is_empty() {
            *hint = format!("; parameters: {}{hint}", one_of(&parameters));
        }
    }
    error
}

/// Byte offset of the key at this dotted path or, for an absent key, of its section.
fn offset(value: &DeValue, path: &str) -> Option<usize> {
    match value {
        DeValue::Table(table) => table.iter().find_map(|(key, inner)| {
            let rest = path.strip_prefix('.').unwrap_or(path).strip_prefix(&**key.get_ref())?;
            let is_whole = rest.is_empty() || rest.starts_with(['.', '[']);
            is_whole.then(|| offset(inner.get_ref(), rest).unwrap_or(key.span().start))
        }),
        DeValue::Array(items) => {
            let (index, rest) = path.strip_prefix('[')?.split_once(']')?;
            let item = items.get(index.parse::<usize>().ok()?)?;
            Some(offset(item.get_ref(), rest).unwrap_or(item.span().start))
        }
        _ => None,
    }
}

/// Truncates a text for messages.
pub fn short(text: &str) -> String {
    const MAX_CHARS: usize = 100;
    match text.char_indices().nth(MAX_CHARS) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.into(),
    }
}

/// Line number of a byte offset in the text.
fn line(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|&byte| byte == b'\n').count()
}

/// Strips the section: `effects.bumpers` and `bumpers` name the same part.
fn part_name(name: &str) -> &str {
    OPTIONAL
        .iter()
        .find_map(|section| name.strip_prefix(section)?.strip_prefix('.'))
        .unwrap_or(name)
}

/// Sections that may contain this part: the section that the name begins with, or all.
fn sections_of(name: &str) -> impl Iterator<Item = &'static str> {
    OPTIONAL.into_iter().filter(move |section| part_name(name) == name || name.starts_with(section))
}

/// Value of a dotted key.
pub fn find<'a>(table: &'a Table, key: &str) -> Option<&'a Value> {
    let (first, rest) = key.split_once('.').unwrap_or((key, ""));
    rest.split('.').filter(|part| !part.is_empty()).try_fold(table.get(first)?, |value, part| {
        match element(part) {
            Some((list, index)) => value.get(list)?.get(index),
            None => value.get(part),
        }
    })
}

/// List and index of a part of a key, as in `arms[0]`.
fn element(part: &str) -> Option<(&str, usize)> {
    let (list, index) = part.strip_suffix(']')?.split_once('[')?;
    Some((list, index.parse().ok()?))
}

fn join(path: &str, key: &str) -> String {
    if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WINDY: &str = "scene = 1\n[effects.wind]\nspeed = 3\n[actuator]\nlag = { time = 1 }\n[[effects.walls]]\nx = 1\n";

    #[test]
    fn the_origin_of_a_key_is_its_line_or_the_line_of_its_section() {
        let source = SceneSource::parse("a.toml", WINDY).expect("TOML");
        for (key, line) in [
            ("scene", 1),
            ("effects.wind", 2),
            ("effects.wind.speed", 3),
            ("effects.wind.of_the_default", 2),
            ("actuator.lag.time", 5),
            ("effects.walls[0].x", 7),
        ] {
            assert_eq!(source.origin(key), format!("a.toml:{line}"), "{key}");
        }
        assert_eq!(source.origin("task"), "a.toml");
    }

    #[test]
    fn without_removes_and_put_adds_effects_and_actuators() {
        let mut source = SceneSource::parse("a.toml", WINDY).expect("TOML");
        let error = source.without("rain").expect_err("no effect rain").to_string();
        assert!(error.ends_with("it has wind, walls, lag"), "{error}");
        source.without("effects.wind").expect("an effect");
        source.without("lag").expect("a part of the actuator");
        assert!(source.without("wind").is_err(), "an effect is removed only once");
        source
            .put("actuator.lag.time", Value::Integer(1), "--set")
            .expect("a part of the actuator");
        assert!(source.has("lag") && source.has("actuator.lag") && !source.has("effects.lag"));
        source.without("actuator.lag").expect("a part of the actuator");
        source.put("effects.rain.rate", Value::Integer(2), "--set").expect("a new effect");
        assert_eq!(source.table["effects"]["rain"]["rate"].as_integer(), Some(2));
        assert_eq!(
            [source.origin("effects.rain"), source.origin("effects.rain.rate")],
            ["--set"; 2]
        );
        source.put("effects.walls", Value::Integer(2), "--set walls").expect("a list is a value");
        assert_eq!(
            source.origin("effects.walls[0].x"),
            "--set walls",
            "the option replaces the line in the file"
        );
        let error = source
            .put("effects.rain", Value::Integer(2), "--set")
            .expect_err("a section")
            .to_string();
        assert!(error.ends_with("set one of its keys: effects.rain.rate"), "{error}");
    }
}

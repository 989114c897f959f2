//! Kinds of damaged inputs.

use crate::commands::animate::{self, Animate};
use crate::commands::report::{self, Report};
use crate::damaged_inputs::{Kind, Outcomes, numbers_of};
use crate::platform::folder::{CHECKPOINT, Folder, METRICS, SETTINGS};
use crate::runs::run::{self, Unobserved};
use crate::runs::saved::resumed;
use crate::scenes::overrides::Overrides;
use crate::scenes::presets;
use crate::scenes::source::SceneSource;
use crate::settings::reading::flat;
use crate::settings::{ACTUATORS, SENSORS};
use crate::tasks::{self, Scene};
use anyhow::Result;
use physgrad::rng::Rng;
use physgrad::train::{OptimizerKind, Session};
use physgrad::{Trainer, Training, policy::Mlp, tasks::CartPole};
use rand::RngExt;
use std::borrow::Cow;
use std::fs;
use std::path::Path;
use std::sync::LazyLock;
use std::time::Duration;
use toml::{Table, Value};

pub(super) const KINDS: [Kind; 5] = [
    Kind { name: "scenes", share: 8, attempt: scene },
    Kind { name: "assignments (--set)", share: 5, attempt: assignments },
    Kind { name: "expressions", share: 6, attempt: expressions },
    Kind { name: "checkpoints", share: 12, attempt: checkpoint },
    Kind { name: "run folders", share: 1, attempt: folder },
];

/// Unexpected values.
const STRANGE: [&str; 18] = [
    "nan",
    "inf",
    "-inf",
    "-1",
    "0",
    "1e308",
    "-1e38",
    "1e-320",
    "9223372036854775807",
    "-9223372036854775808",
    "true",
    "\"\"",
    "[]",
    "{}",
    "[1, \"a\"]",
    "[[[[[[1]]]]]]",
    "1979-05-27",
    "\"\u{1F600}\"",
];

fn one_of<'a, T>(rng: &mut Rng, all: &'a [T]) -> &'a T {
    &all[rng.random_range(0..all.len())]
}

/// Text of a random preset.
fn preset(rng: &mut Rng) -> Cow<'static, str> {
    let names: Vec<&str> = presets::all().map(|(name, _)| name).collect();
    presets::text(names[rng.random_range(0..names.len())]).expect("a preset")
}

/// Truncates a text, inserts a byte, flips a bit, removes or repeats a line, replaces a value, or
/// inserts an entry.
fn damage_text(rng: &mut Rng, text: &mut Vec<u8>) {
    let at = rng.random_range(0..=text.len());
    let lines: Vec<Vec<u8>> = text.split(|&byte| byte == b'\n').map(<[u8]>::to_vec).collect();
    let line = rng.random_range(0..lines.len());
    let mut changed = lines.clone();
    match rng.random_range(0..7) {
        0 => return text.truncate(at),
        1 => return text.insert(at, rng.random()),
        2 if at < text.len() => {
            text[at] ^= 1 << rng.random_range(0..8);
            return;
        }
        3 => drop(changed.remove(line)),
        4 => changed.insert(rng.random_range(0..lines.len()), lines[line].clone()),
        5 => {
            if let Some(equals) = changed[line].iter().position(|&byte| byte == b'=') {
                changed[line].truncate(equals + 1);
                changed[line].extend(one_of(rng, &STRANGE).as_bytes());
            }
        }
        _ => {
            let keys = [
                "horizon",
                "effects.walls",
                "system.poles",
                "training",
                "a",
                "integrator.substeps",
                "[loss]",
            ];
            let entry = format!("{} = {}", one_of(rng, &keys), one_of(rng, &STRANGE));
            changed.insert(line, entry.into_bytes());
        }
    }
    *text = changed.join(&b'\n');
}

/// Truncates bytes, inserts bytes, or replaces a byte.
fn damage_bytes(rng: &mut Rng, bytes: &mut Vec<u8>) {
    let at = rng.random_range(0..bytes.len());
    match rng.random_range(0..5) {
        0 => bytes.truncate(at.max(1)),
        1 => bytes.insert(at, rng.random()),
        // Inserts part of a huge length: in an encoded length, all bytes but the last have the
        // highest bit set.
        2 => bytes.splice(at..at, [0xff; 9]).for_each(drop),
        _ => bytes[at] = rng.random(),
    }
}

/// True if the scene is valid. Asserts that writing and reading preserve the identity of a valid
/// scene, and that an error has a message.
fn is_scene(read: Result<Scene>) -> bool {
    match read {
        Ok(scene) => {
            let again = SceneSource::parse("a run", &scene.table().to_string())
                .and_then(|source| source.scene());
            assert_eq!(again.expect("settings that are read back").identity(), scene.identity());
            true
        }
        Err(error) => {
            assert!(!format!("{error:#}").is_empty(), "the error has no message");
            false
        }
    }
}

/// Reads a damaged preset. If it is a valid scene, writes and reads its settings.
fn scene(number: u64, outcomes: &mut Outcomes) {
    let rng = &mut numbers_of(number);
    let mut text = preset(rng).as_bytes().to_vec();
    for _ in 0..rng.random_range(1..4) {
        damage_text(rng, &mut text);
    }
    let text = String::from_utf8_lossy(&text).into_owned();
    outcomes.record(number, 1_000_000 + 200 * (text.len() + model_size(&text)), || {
        is_scene(SceneSource::parse("a scene", &text).and_then(|source| source.scene()))
    });
}

/// Bytes of the largest model of the program that a scene of bodies names, or of the default one.
fn model_size(text: &str) -> usize {
    use physgrad_bodies::models;
    let is_read = |name: &&str| text.contains(name) || *name == "half_cheetah";
    let read = models::names().filter(|name| text.contains("bodies") && is_read(name));
    read.filter_map(models::text).map(str::len).max().unwrap_or(0)
}

/// Random assignment for `--set`, mostly to a key of this preset or its task.
fn assignment(rng: &mut Rng, preset: &Table) -> String {
    let matching = tasks::all()
        .iter()
        .copied()
        .find(|kind| preset.get("task").and_then(Value::as_str) == Some(kind.name()));
    let task =
        matching.filter(|_| rng.random_range(0..8) > 0).unwrap_or(*one_of(rng, tasks::all()));
    let mut keys: Vec<String> = flat(&task.defaults(&Table::new()))
        .into_iter()
        .chain(flat(preset))
        .map(|(key, _)| key)
        .collect();
    keys.extend(task.effects().iter().map(|info| format!("effects.{}", info.name)));
    keys.extend(ACTUATORS.iter().map(|info| format!("actuator.{}", info.name)));
    keys.extend(SENSORS.iter().map(|info| format!("sensor.{}", info.name)));
    let mut key = one_of(rng, &keys).clone();
    match rng.random_range(0..16) {
        0 => key += ".a",
        1 => key = vec!["a"; rng.random_range(1..2000)].join("."),
        2 => key = key.replace('.', ".."),
        _ => {}
    }
    let value = match rng.random_range(0..8) {
        0..3 => rng.random_range(0..100).to_string(),
        3 | 4 => rng.random_range(-2.0..4.0).to_string(),
        5 => format!("{:e}", f64::from_bits(rng.random())),
        6 => {
            let depth = rng.random_range(1..2000);
            let ends = *one_of(rng, &[["[", "]"], ["{a=", "}"], ["[1,", "]"]]);
            ends.map(|end| end.repeat(depth)).join("1")
        }
        _ => (*one_of(rng, &STRANGE)).to_owned(),
    };
    let mut text = format!("{key}={value}").into_bytes();
    if rng.random_range(0..8) == 0 {
        damage_text(rng, &mut text);
    }
    String::from_utf8_lossy(&text).into_owned()
}

/// Reads a preset with assignments.
fn assignments(number: u64, outcomes: &mut Outcomes) {
    let rng = &mut numbers_of(number);
    let text = preset(rng);
    let table: Table = text.parse().expect("TOML");
    let set: Vec<String> = (0..rng.random_range(1..4)).map(|_| assignment(rng, &table)).collect();
    let size = text.len() + model_size(&text) + set.iter().map(String::len).sum::<usize>();
    let overrides = Overrides { set, ..Overrides::default() };
    outcomes.record(number, 1_000_000 + 200 * size, || {
        is_scene(SceneSource::parse("a preset", &text).and_then(|mut source| {
            overrides.apply(&mut source)?;
            source.scene()
        }))
    });
}

/// Words of expressions, known and unknown.
const WORDS: [&str; 48] = [
    "x", "y", "u", "k", "d", "t", "dt", "w", "next.x", "ended", "m", "z", "x.y", "0", "1", "-2.5",
    "1e308", "1e-320", "1e999", "3.", ".5", "+", "-", "*", "/", "^", "**", "<", "<=", "==", "and",
    "or", "not", "(", ")", "(", ")", ",", "sin(", "sqrt(", "where(", "clip(", "max(", "atan2(",
    "log(", "tanh(", "if", "\u{3c0}",
];

/// A few words, a usual form with random words, a long chain, or deep nesting.
fn expression(rng: &mut Rng) -> String {
    let word = |rng: &mut Rng| *one_of(rng, &WORDS);
    let long = rng.random_range(1..3000);
    match rng.random_range(0..12) {
        0 => {
            let pairs = [["(", ")"], ["sin(", ")"], ["-", ""], ["x^", ""], ["not ", ""]];
            one_of(rng, &pairs).map(|part| part.repeat(long)).join("x")
        }
        1 => vec![word(rng); long].join(one_of::<&str>(rng, &["+", "*", "^", " "])),
        2..8 => {
            let (a, b, c) = (word(rng), word(rng), word(rng));
            let forms = [
                format!("{a} * {b} - {c}"),
                format!("where({a} < {b}, {c}, sqrt({a}))"),
                format!("({a} + {b})^2 / {c}"),
                format!("clip({a}, -1, 1) * atan2({b}, {c})"),
            ];
            one_of(rng, &forms).clone()
        }
        _ => (0..rng.random_range(1..12)).map(|_| word(rng)).collect::<Vec<_>>().join(" "),
    }
}

/// Reads equations of a system and its costs, or of the costs of a built-in task, with random
/// expressions, and trains a valid scene for an epoch. A number that is not finite is an error there.
fn expressions(number: u64, outcomes: &mut Outcomes) {
    let rng = &mut numbers_of(number);
    let mut chosen = |usual: &str| {
        let text = if rng.random_range(0..4) == 0 { expression(rng) } else { usual.to_owned() };
        Value::String(text).to_string()
    };
    let is_built_in = number.is_multiple_of(4);
    let [task, control] = if is_built_in { ["cart_pole", "force"] } else { ["equations", "u"] };
    let mut text = format!(
        "scene = 1\ntask = \"{task}\"\nepochs = 1\nhorizon = 4\n[policy]\nkind = \"equations\"\n\
         control.{control} = {}\nnext.m = {}\nparameters.k = {{ start = 0.5 }}\n\
         [training]\nbatch = 2\ntrain_samples = 2\ntest_samples = 2\n",
        chosen("k * x - m"),
        chosen("m + x"),
    );
    if is_built_in {
        text += &format!(
            "[equations]\nrunning = {}\nterminal = {}\ndefine.d = {}\n",
            chosen("x^2 + d"),
            chosen("x^2"),
            chosen("cos(theta_1)"),
        );
    } else {
        text += &format!(
            "[system]\nstates = [\"x\", \"y\"]\ncontrols = [\"u\"]\ndt = 0.1\nrate.x = {}\nrate.y = {}\n\
             define.d = {}\nparameters.k = {{ uniform = [1.0, 2.0] }}\ntables.w = [1.0, 2.0]\n\
             [loss]\nrunning = {}\nterminal = {}\nend = {}\n",
            chosen("y"),
            chosen("u - d + w"),
            chosen("k * sin(x)"),
            chosen("next.x^2 + u^2"),
            chosen("x^2"),
            chosen("x > 2"),
        );
    }
    outcomes.record(number, 20_000_000 + 4000 * text.len(), || {
        let read = SceneSource::parse("a scene", &text).and_then(|source| source.scene());
        if let Ok(scene) = &read
            && let Ok(mut run) = scene.open(1)
        {
            let _ = run.advance(&|| false);
        }
        is_scene(read)
    });
}

type Small = Session<CartPole, Mlp, f32>;

fn session(rule: OptimizerKind) -> Small {
    let task = CartPole { horizon: 3, ..CartPole::new(1) };
    let training =
        Training { rule, batch: 2, train_samples: 4, test_samples: 4, ..Training::default() };
    Trainer::new(task, Mlp::new([4, 8, 1])).training(training).session().expect("valid settings")
}

/// Checkpoints of one session per optimizer, after three epochs and within the fourth.
static CHECKPOINTS: LazyLock<Vec<(OptimizerKind, Vec<u8>)>> = LazyLock::new(|| {
    let rules = OptimizerKind::NAMES.map(|name| OptimizerKind::named(name).expect("a rule"));
    let checkpoints = rules.into_iter().flat_map(|rule| {
        let mut session = session(rule);
        (0..3).for_each(|_| drop(session.epoch().expect("finite").clone()));
        let between = session.checkpoint("a run");
        session.advance(&|| true).expect("finite");
        [(rule, between), (rule, session.checkpoint("a run"))]
    });
    checkpoints.collect()
});

/// Restores a damaged checkpoint with a valid checksum, and trains for an epoch. If the restore
/// fails, checks that it changed neither the parameters nor the records.
fn checkpoint(number: u64, outcomes: &mut Outcomes) {
    let rng = &mut numbers_of(number);
    let (rule, good) = one_of(rng, &CHECKPOINTS);
    let mut bytes = good.clone();
    for _ in 0..rng.random_range(1..5) {
        damage_bytes(rng, &mut bytes);
    }
    Small::seal(&mut bytes);
    let mut session = session(*rule);
    let theta = session.weights().theta().to_vec();
    outcomes.record(number, 1_000_000 + 20 * bytes.len(), || {
        if session.restore(&bytes, "a run").is_ok() {
            // A non-finite value is an error, not a panic.
            let _ = session.epoch();
            return true;
        }
        assert!(
            session.weights().theta() == theta && session.records().is_empty(),
            "a rejected checkpoint changed the session"
        );
        false
    });
}

/// Reports, animates and resumes a run folder whose scene and files may be damaged.
fn folder(number: u64, outcomes: &mut Outcomes) {
    let rng = &mut numbers_of(number);
    let path =
        std::env::temp_dir().join(format!("physgrad-damaged-{}-{number}", std::process::id()));
    outcomes.record(number, 1_000_000_000, || {
        let accepted = create(rng, &path).and_then(|()| use_folder(&path)).is_ok();
        let _ = fs::remove_dir_all(&path);
        accepted
    });
    // Removes the folder that a panic leaves behind.
    let _ = fs::remove_dir_all(&path);
}

/// Creates the folder of a small run of a preset. Damages the preset, settings or checkpoint in
/// most cases. The metrics are always random bytes.
fn create(rng: &mut Rng, path: &Path) -> Result<()> {
    let mut text = preset(rng).as_bytes().to_vec();
    for _ in 0..rng.random_range(0..3) {
        damage_text(rng, &mut text);
    }
    let mut source = SceneSource::parse("a scene", &String::from_utf8_lossy(&text))?;
    let quantum = source.text("task") == Some("quantum");
    let sizes = [
        "horizon=3",
        "epochs=2",
        "training.batch=2",
        "training.train_samples=3",
        "training.test_samples=3",
    ];
    let network: &[&str] =
        if quantum { &["policy.width=3", "system.grid=20"] } else { &["policy.widths=[4]"] };
    let set = sizes.iter().chain(network).map(ToString::to_string).collect();
    Overrides { set, ..Overrides::default() }.apply(&mut source)?;
    let scene = source.scene()?;
    let mut run = scene.open(1)?;
    // A divergence leaves the run unchanged.
    let _ = run.advance(&|| false);
    let mut checkpoint = run.checkpoint(&scene.identity());
    let mut settings = scene.table().to_string().into_bytes();
    match rng.random_range(0..8) {
        0 => damage_text(rng, &mut settings),
        1 => damage_bytes(rng, &mut checkpoint),
        2..5 => {
            damage_bytes(rng, &mut checkpoint);
            Small::seal(&mut checkpoint);
        }
        _ => {}
    }
    fs::create_dir_all(path)?;
    for (name, bytes) in [
        (SETTINGS, settings),
        (CHECKPOINT, checkpoint),
        (METRICS, rng.random::<[u8; 8]>().to_vec()),
    ] {
        fs::write(path.join(name), bytes)?;
    }
    Ok(())
}

/// Reports, animates and resumes the run in the folder.
fn use_folder(path: &Path) -> Result<()> {
    report::report(&Report { folder: path.to_owned(), out: None, quiet: true })?;
    animate::animate(&Animate { folder: path.to_owned(), sample: 0, out: None, quiet: true })?;
    let folder = Folder::existing(path)?.lock()?;
    let scene = resumed(&folder, &Overrides { epochs: Some(3), ..Overrides::default() })?;
    let mut opened = scene.open(1)?;
    run::run(&folder, &scene, &mut *opened, true, Duration::from_secs(60), None, &mut Unobserved)?;
    Ok(())
}

//! Commands of the documentation have existing options and settings.

use crate::markdown::{Page, pages};
use assert_cmd::Command;
use std::process::Output;

/// Returns the commands of a block of shell code, without comments, redirections and pipes.
pub fn commands(block: &str) -> Vec<Vec<String>> {
    let lines = block.replace("\\\n", " ");
    let words = lines
        .lines()
        .map(|line| shlex::split(line).unwrap_or_else(|| panic!("unfinished quotation: {line}")));
    words
        .filter(|words| !words.is_empty())
        .map(|words| words.into_iter().take_while(|word| word != ">" && word != "|").collect())
        .collect()
}

/// Returns the arguments of a call of `physgrad`, or of a program of the user. Returns `None` for
/// other commands.
pub fn arguments(command: &[String]) -> Option<&[String]> {
    match command {
        [program, arguments @ ..] if program == "physgrad" || program == "own" => Some(arguments),
        [cargo, run, release, dashes, arguments @ ..]
            if [cargo, run, release, dashes] == ["cargo", "run", "--release", "--"] =>
        {
            Some(arguments)
        }
        _ => None,
    }
}

fn physgrad(arguments: &[String]) -> Output {
    Command::cargo_bin("physgrad")
        .expect("the program is built")
        .args(arguments)
        .output()
        .expect("the command runs")
}

/// Replaces the placeholders N, E and P by example values. Returns other words unchanged.
fn value(word: String) -> String {
    match &*word {
        "N" | "E" => "1".into(),
        "P" => "f32".into(),
        _ => word,
    }
}

/// Returns the calls of the program in blocks and in inline code, with example values in place of
/// placeholders.
fn calls(page: &Page) -> Vec<Vec<String>> {
    let spans = page
        .spans
        .iter()
        .filter(|span| span.starts_with("physgrad ") && !span.starts_with("physgrad = "));
    let shown = page
        .blocks("sh")
        .flat_map(commands)
        .chain(spans.flat_map(|span| commands(&span.replace('\n', " "))));
    let calls = shown.filter_map(|command| arguments(&command).map(<[String]>::to_vec));
    calls.map(|call| call.into_iter().map(value).collect()).collect()
}

/// Returns the message of the program about a wrong argument, if there is one.
///
/// The parser reads arguments from left to right. `--help` at the end prevents the command from
/// running.
fn mistake(call: &[String]) -> Option<String> {
    let output = physgrad(&[call, &["--help".to_owned()]].concat());
    (!output.status.success()).then(|| String::from_utf8_lossy(&output.stderr).into_owned())
}

/// Returns the call of `explain` for the preset of `call`. Copies the options `--set` and
/// `--without`, except those with a value in capitals. Returns `None` if `call` names no preset.
fn explanation(call: &[String], presets: &[String]) -> Option<Vec<String>> {
    let scene = call.get(1).filter(|scene| presets.contains(scene))?;
    let mut explain = vec!["explain".to_owned(), scene.clone()];
    let in_capitals = |word: &str| {
        word.rsplit('=').next().is_some_and(|value| value.chars().all(|c| c.is_ascii_uppercase()))
    };
    let changes =
        |pair: &&[String]| ["--set", "--without"].contains(&&*pair[0]) && !in_capitals(&pair[1]);
    for pair in call.windows(2).filter(changes) {
        // Takes the first value of a sweep.
        let in_brackets = pair[1].contains(['[', '{']);
        let change =
            if in_brackets { &pair[1] } else { pair[1].split(',').next().expect("a value") };
        explain.extend([pair[0].clone(), change.to_owned()]);
    }
    Some(explain)
}

#[test]
fn every_command_has_existing_options_and_settings() {
    let list = physgrad(&["scene".to_owned()]).stdout;
    let presets: Vec<_> = String::from_utf8(list)
        .expect("text")
        .lines()
        .filter_map(|line| line.split(' ').next().map(String::from))
        .collect();
    let (mut parsed, mut explained) = (0, 0);
    for page in pages() {
        for call in calls(&page) {
            let mistake = mistake(&call);
            assert!(
                mistake.is_none(),
                "{}: physgrad {}: {}",
                page.path.display(),
                call.join(" "),
                mistake.unwrap_or_default()
            );
            parsed += 1;
            let Some(explain) = explanation(&call, &presets) else { continue };
            let output = physgrad(&explain);
            let message = String::from_utf8_lossy(&output.stderr);
            // Pages show one mistake with its message.
            let quoted = !message.trim().is_empty() && page.text.contains(&*message);
            // `explain` has validated all settings before it refuses those of trainings.
            let quoted = quoted || message.contains("has no effect on counts of operations");
            assert!(
                output.status.success() || quoted,
                "{}: physgrad {}: {message}",
                page.path.display(),
                call.join(" ")
            );
            explained += 1;
        }
    }
    assert!(parsed > 80 && explained > 20, "{parsed} commands, {explained} with a preset");
}

#[test]
fn wrong_subcommands_options_and_values_are_found() {
    let wrong = |line: &str| {
        commands(line)
            .iter()
            .filter_map(|command| arguments(command))
            .all(|call| mistake(call).is_some())
    };
    assert!(wrong("physgrad trian cart_pole # a comment"));
    assert!(wrong("cargo run --release -- train cart_pole --epoch 3"));
    assert!(wrong("physgrad compare cart_pole \\\n  --fields R,X"));
    assert!(wrong("own train ball_beam --precision f16 > out"));
    assert!(!wrong("physgrad scene cart_pole > my_scene.toml"));
    let call = &commands("physgrad train cart_pole --set system.pole=4 --out runs/x")[0][1..];
    let explain = explanation(call, &["cart_pole".into()]).expect("a preset");
    assert_eq!(explain, ["explain", "cart_pole", "--set", "system.pole=4"]);
    assert!(!physgrad(&explain).status.success());
}

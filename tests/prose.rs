//! Pages and comments follow the mechanical rules of prose. A sentence has at most 25 words and no
//! "what" clause, and does not open with "Of", "Its" or "The same". A line has at most 100 columns.
//!
//! The test reads files in Markdown and Rust. Tables, headings, images, code, comments behind code,
//! and the folder `examples/data` are exempt. Inline code counts as one word.

use std::fs;
use std::path::{Path, PathBuf};

const MAX_WORDS: usize = 25;
const MAX_COLUMNS: usize = 100;

/// Paragraph or list item, with the numbers of its first and last line.
struct Paragraph {
    line: usize,
    last: usize,
    text: String,
}

/// Returns the prose of a line of a source file: the text of a comment. None for all other lines.
fn comment(line: &str) -> Option<&str> {
    let line = line.trim_start();
    ["///", "//!", "//"].iter().find_map(|marker| line.strip_prefix(marker)).map(|text| text.strip_prefix(' ').unwrap_or(text))
}

/// Splits numbered lines of Markdown into paragraphs. None ends a paragraph.
fn paragraphs<'a>(lines: impl Iterator<Item = (usize, Option<&'a str>)>) -> Vec<Paragraph> {
    let (mut found, mut is_open, mut is_code) = (Vec::<Paragraph>::new(), false, false);
    for (line, text) in lines {
        let text = text.map(|text| text.strip_prefix("> ").unwrap_or(text)).unwrap_or_default();
        let trimmed = text.trim_start();
        let is_fence = trimmed.starts_with("```");
        is_code ^= is_fence;
        let starts = |markers: &[&str]| markers.iter().any(|marker| trimmed.starts_with(marker));
        if is_code || is_fence || trimmed.is_empty() || starts(&["|", "#", "!["]) || text.starts_with("    ") {
            is_open = false;
            continue;
        }
        let number = trimmed.find(". ").is_some_and(|end| trimmed[..end].bytes().all(|byte| byte.is_ascii_digit()));
        if !is_open || number || starts(&["- ", "* "]) {
            found.push(Paragraph { line, last: line, text: String::new() });
        }
        is_open = true;
        if let Some(paragraph) = found.last_mut() {
            paragraph.last = line;
            paragraph.text += trimmed;
            paragraph.text.push(' ');
        }
    }
    found
}

/// Replaces each piece of inline code by one word. Removes brackets, asterisks, and the targets of
/// links.
fn plain(text: &str) -> String {
    let mut plain = String::new();
    for (i, part) in text.split('`').enumerate() {
        plain += if i % 2 == 1 { "Code" } else { part };
    }
    while let Some((start, end)) = plain.find("](").and_then(|start| Some((start, start + plain[start..].find(')')?))) {
        plain.replace_range(start..=end, "");
    }
    plain.replace(['[', ']', '*'], "")
}

/// Splits a paragraph into sentences.
fn sentences(text: &str) -> Vec<String> {
    let mut found = vec![String::new()];
    let marker = |word: &&str| *word == "-" || word.strip_suffix('.').is_some_and(|number| number.parse::<u32>().is_ok());
    for word in plain(text).split_whitespace().skip_while(marker) {
        let last = found.last_mut().expect("a sentence");
        if last.ends_with(['.', '?', '!']) {
            found.push(word.to_owned());
        } else {
            *last += if last.is_empty() { "" } else { " " };
            *last += word;
        }
    }
    found
}

/// Returns the first rule that a sentence breaks, if it breaks one.
fn broken_rule(sentence: &str) -> Option<String> {
    let words: Vec<&str> = sentence.split(' ').filter(|word| word.contains(char::is_alphanumeric)).collect();
    if words.len() > MAX_WORDS {
        return Some(format!("{} words", words.len()));
    }
    if ["Of ", "Its ", "The same "].iter().any(|opening| sentence.starts_with(opening)) {
        return Some("opening".into());
    }
    let is_what = |word: &&str| word.trim_end_matches([',', ';', ':', '.']).eq_ignore_ascii_case("what");
    (words.iter().any(is_what) && !sentence.ends_with('?')).then(|| "\"what\"".into())
}

/// Returns the faults of a page, or of the comments of a source file.
fn faults(path: &Path, text: &str) -> Vec<String> {
    let is_source = path.extension().is_some_and(|extension| extension == "rs");
    let lines = || text.lines().enumerate().map(|(i, line)| (i + 1, if is_source { comment(line) } else { Some(line) }));
    let prose = paragraphs(lines());
    let source: Vec<_> = text.lines().enumerate().collect();
    let wide = prose.iter().flat_map(|paragraph| &source[paragraph.line - 1..paragraph.last]);
    let wide = wide.filter(|(_, line)| line.chars().count() > MAX_COLUMNS && line.trim().contains(' '));
    let wide = wide.map(|(i, _)| format!("{}:{}: more than {MAX_COLUMNS} columns", path.display(), i + 1));
    let broken = prose.iter().flat_map(|paragraph| {
        let rules = sentences(&paragraph.text).into_iter().filter_map(|sentence| Some((broken_rule(&sentence)?, sentence)));
        rules.map(|(rule, sentence)| format!("{}:{}: {rule}: {sentence}", path.display(), paragraph.line)).collect::<Vec<_>>()
    });
    broken.chain(wide).collect()
}

/// Returns all pages and source files below a folder, without those in folders named `target` or
/// `examples/data`.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    let (folders, texts): (Vec<_>, Vec<_>) = entries.partition(|path| path.is_dir());
    let is_text = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "md" || extension == "rs");
    let inner = folders
        .iter()
        .filter(|folder| !folder.ends_with("target") && !folder.ends_with("examples/data"))
        .flat_map(|folder| files(folder));
    texts.into_iter().filter(is_text).chain(inner).collect()
}

#[test]
fn pages_and_comments_follow_the_rules_of_prose() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folders = ["docs", "src", "tests", "examples", "benches", "python"].map(|folder| root.join(folder));
    let mut paths: Vec<PathBuf> = folders.iter().filter(|folder| folder.exists()).flat_map(|folder| files(folder)).collect();
    paths.extend(["README.md", "CHANGELOG.md"].map(|page| root.join(page)));
    let read = |path: &PathBuf| fs::read_to_string(path).expect("a text");
    let found: Vec<String> =
        paths.iter().flat_map(|path| faults(path.strip_prefix(root).expect("below the root"), &read(path))).collect();
    assert!(paths.len() > 100 && found.is_empty(), "{} files, {} faults:\n{}", paths.len(), found.len(), found.join("\n"));
}

#[test]
fn planted_faults_are_found() {
    let long = format!("It has{}.", " a".repeat(MAX_WORDS));
    let wide = format!("A line of {} columns.", "x".repeat(MAX_COLUMNS));
    let cases = [
        "Of two runs, one ends.",
        "Its end is near.",
        "The same holds here.",
        "This is what ends.",
        "What ends is here.",
        &long,
        &wide,
    ];
    for fault in cases {
        let found = |path: &str, text: &str| faults(Path::new(path), text).len();
        assert_eq!(found("a.md", &format!("# Title\n\nA sentence. {fault}\n")), 1, "{fault}");
        assert_eq!(found("a.rs", &format!("fn f() {{}}\n/// {fault}\nfn g() {{}}\n")), 1, "{fault}");
        assert_eq!(found("a.rs", &format!("/// ```\n/// {fault}\n/// ```\n")), 0, "{fault}");
        assert_eq!(found("a.md", &format!("| {fault} |\n\n```text\n{fault}\n```\n")), 0, "{fault}");
    }
    // A sentence may span lines. Items of a list are separate paragraphs. The target of a link does
    // not count.
    let text = "- One [link](page.md#a-very-long-target) and `inline code of several words`\n  end here.\n- Another item.\n";
    assert_eq!(faults(Path::new("a.md"), text), Vec::<String>::new());
    // The last line of a long comment counts too.
    let last = format!("{}/// One more line of {} columns.\n", "/// A short line.\n".repeat(20), "x".repeat(MAX_COLUMNS));
    assert_eq!(faults(Path::new("a.rs"), &last).len(), 1);
    let two = format!("It has{}\nand{}.", " a".repeat(15), " a".repeat(15));
    assert_eq!(faults(Path::new("a.md"), &two).len(), 1);
}

//! Pages of the documentation: blocks of code, inline code, links and anchors.

use pulldown_cmark::{CodeBlockKind, Event, Options, Parser, Tag, TagEnd};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::{fs, mem};

/// Page in Markdown.
pub struct Page {
    /// Path below the root of the repository.
    pub path: PathBuf,
    pub text: String,
    /// Language, as in ```` ```rust,ignore ````, and content of each block of code. Indented blocks
    /// have an empty language.
    pub blocks: Vec<(String, String)>,
    /// Inline code.
    pub spans: Vec<String>,
    /// Targets of links and images.
    pub links: Vec<String>,
    /// Anchors of the headings, as GitHub and mdBook form them.
    pub anchors: Vec<String>,
}

impl Page {
    /// Reads a page, from its path below the root of the repository.
    pub fn read(path: impl AsRef<Path>) -> Self {
        let path = path.as_ref().to_owned();
        let text = fs::read_to_string(root().join(&path)).expect("a page");
        let mut page =
            Self { path, text, blocks: vec![], spans: vec![], links: vec![], anchors: vec![] };
        page.parse();
        page
    }

    fn parse(&mut self) {
        let text = mem::take(&mut self.text);
        // Text of the current heading or block, language of the block, and number of earlier
        // headings by anchor.
        let (mut current, mut language, mut earlier) =
            (String::new(), String::new(), BTreeMap::<String, usize>::new());
        for event in Parser::new_ext(&text, Options::ENABLE_TABLES) {
            match event {
                Event::Start(Tag::Heading { .. }) => current.clear(),
                Event::Start(Tag::CodeBlock(kind)) => {
                    current.clear();
                    language = match kind {
                        CodeBlockKind::Fenced(language) => language.into_string(),
                        CodeBlockKind::Indented => String::new(),
                    };
                }
                Event::Start(Tag::Link { dest_url, .. } | Tag::Image { dest_url, .. }) => {
                    self.links.push(dest_url.into_string())
                }
                Event::Text(part) => current.push_str(&part),
                Event::Code(code) => {
                    current.push_str(&code);
                    self.spans.push(code.into_string());
                }
                Event::End(TagEnd::Heading(_)) => {
                    let anchor = anchor(&current);
                    let count = earlier.entry(anchor.clone()).or_default();
                    self.anchors.push(if *count == 0 {
                        anchor
                    } else {
                        format!("{anchor}-{count}")
                    });
                    *count += 1;
                }
                Event::End(TagEnd::CodeBlock) => {
                    self.blocks.push((mem::take(&mut language), mem::take(&mut current)))
                }
                _ => {}
            }
        }
        self.text = text;
    }

    /// Returns the contents of all blocks of a language.
    pub fn blocks<'a>(&'a self, language: &'a str) -> impl Iterator<Item = &'a str> {
        self.blocks.iter().filter(move |block| block.0 == language).map(|block| &*block.1)
    }
}

/// Returns the anchor of a heading, without the number of a repeated heading.
fn anchor(heading: &str) -> String {
    let lower = heading.trim().to_lowercase();
    let kept = lower.chars().filter(|c| c.is_alphanumeric() || [' ', '-', '_'].contains(c));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}

/// Returns the root of the repository.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the root of the repository")
}

/// Returns the README, CONTRIBUTING.md and all pages in `docs`.
pub fn pages() -> Vec<Page> {
    let mut paths = vec![PathBuf::from("README.md"), PathBuf::from("CONTRIBUTING.md")];
    let mut folders = vec![PathBuf::from("docs")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(root().join(&folder)).expect("a folder") {
            let path = folder.join(entry.expect("an entry").file_name());
            if root().join(&path).is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "md") {
                paths.push(path);
            }
        }
    }
    paths.sort();
    paths.into_iter().map(Page::read).collect()
}

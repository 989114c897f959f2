//! Links in the documentation lead to existing files, headings and pages of the book.

use crate::markdown::{Page, pages, root};
use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

/// Returns the file and the anchor that a link of `page` refers to, or `None` for a web page.
fn target<'a>(page: &Path, link: &'a str) -> Option<(PathBuf, Option<&'a str>)> {
    if link.contains("://") {
        return None;
    }
    let (file, anchor) =
        link.split_once('#').map_or((link, None), |(file, anchor)| (file, Some(anchor)));
    let mut path =
        if file.is_empty() { page.to_owned() } else { page.parent().expect("a folder").to_owned() };
    for part in Path::new(file).components() {
        match part {
            Component::ParentDir => assert!(path.pop(), "{link} leaves the repository"),
            part => path.push(part),
        }
    }
    Some((path, anchor))
}

/// Returns the broken links of `page`.
fn broken(page: &Page, anchors: &BTreeMap<PathBuf, Vec<String>>) -> Vec<String> {
    let resolves = |link: &str| {
        target(&page.path, link).is_none_or(|(file, anchor)| {
            let known = |anchor: &str| {
                anchors
                    .get(&file)
                    .is_some_and(|anchors| anchors.iter().any(|known| known == anchor))
            };
            root().join(&file).is_file() && anchor.is_none_or(known)
        })
    };
    page.links.iter().filter(|link| !resolves(link)).cloned().collect()
}

fn anchors(pages: &[Page]) -> BTreeMap<PathBuf, Vec<String>> {
    pages.iter().map(|page| (page.path.clone(), page.anchors.clone())).collect()
}

#[test]
fn every_relative_link_leads_to_a_file_and_a_heading() {
    let pages = pages();
    assert!(
        pages.iter().map(|page| page.links.len()).sum::<usize>() > 150,
        "the pages have 150 links or fewer"
    );
    let anchors = anchors(&pages);
    for page in &pages {
        let broken = broken(page, &anchors);
        assert!(broken.is_empty(), "{}: no such file or heading: {broken:?}", page.path.display());
    }
}

#[test]
fn broken_links_of_a_page_are_found() {
    let pages = pages();
    let anchors = anchors(&pages);
    let mut page = Page::read("docs/method.md");
    page.links = [
        "scenes.md#sections",
        "#recursion",
        "https://example.org/x",
        "../README.md",
        "images/rod.svg",
    ]
    .map(String::from)
    .into();
    assert!(broken(&page, &anchors).is_empty());
    page.links =
        ["scenes.md#section", "#Recursion", "scene.md", "docs/scenes.md", "images/rod.svg#a"]
            .map(String::from)
            .into();
    assert_eq!(broken(&page, &anchors), page.links);
}

#[test]
fn the_book_contains_every_page_once_and_its_pages_link_only_to_files_in_docs() {
    let summary = Page::read("docs/SUMMARY.md");
    let mut chapters: Vec<_> =
        summary.links.iter().map(|link| Path::new("docs").join(link)).collect();
    chapters.sort();
    let pages = pages();
    let in_docs: Vec<_> = pages
        .iter()
        .filter(|page| page.path.starts_with("docs") && page.path != summary.path)
        .collect();
    assert_eq!(
        chapters,
        in_docs.iter().map(|page| page.path.clone()).collect::<Vec<_>>(),
        "docs/SUMMARY.md does not list every page once"
    );
    for page in in_docs {
        for (file, _) in page.links.iter().filter_map(|link| target(&page.path, link)) {
            assert!(
                file.starts_with("docs"),
                "{}: {} is not part of the book",
                page.path.display(),
                file.display()
            );
        }
    }
}

//! The book that mdBook builds from `docs` has no broken link to its own pages and files, and no
//! missing image. The pages fit narrow and wide windows.
//!
//! Requires `mdbook` and `chromium`. Without them the test prints a message and passes.

use crate::markdown::root;
use std::fs;
use std::path::Path;
use std::process::Command;
use tempfile::TempDir;

/// Widths of the windows, in pixels.
const WIDTHS: [u32; 2] = [400, 1200];

/// Returns the paths of all files in the folder, relative to the folder `book`.
fn files(book: &Path, folder: &Path) -> Vec<String> {
    let paths =
        fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    let nested = paths.map(|path| {
        if path.is_dir() {
            files(book, &path)
        } else {
            vec![
                path.strip_prefix(book)
                    .expect("a file of the book")
                    .to_str()
                    .expect("a name in UTF-8")
                    .to_owned(),
            ]
        }
    });
    nested.flatten().collect()
}

/// Returns the lines that `book.js` writes about the book in `folder`.
fn examine(folder: &Path) -> Vec<String> {
    let book = folder.join("book");
    let files = files(&book, &book);
    let is_page = |file: &&String| {
        file.ends_with(".html") && !["print.html", "toc.html", "404.html"].contains(&&***file)
    };
    let pages: Vec<_> = files.iter().filter(is_page).collect();
    let frame = |width, page| {
        format!(
            "<iframe data-page='{page}' src='book/{page}' width={width} height=800 style='border:0'></iframe>\n"
        )
    };
    let frames: String =
        pages.iter().flat_map(|page| WIDTHS.map(|width| frame(width, page))).collect();
    let script = include_str!("book.js");
    let arguments = serde_json::to_string(&(&pages, &files, WIDTHS)).expect("JSON");
    let html = format!(
        "<meta charset=utf-8>\n<script>{script}\nonload = () => examine(...{arguments});</script>\n<body>{frames}"
    );
    fs::write(folder.join("frames.html"), html).expect("a file");
    let output = Command::new("chromium")
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--allow-file-access-from-files",
            "--dump-dom",
        ])
        .arg(format!("--user-data-dir={}", folder.join("profile").display()))
        .arg(format!("file://{}", folder.join("frames.html").display()))
        .output()
        .expect("chromium runs");
    let dom = String::from_utf8(output.stdout).expect("text");
    let body =
        dom.split("<body>").nth(1).and_then(|rest| rest.split("</body>").next()).expect("a body");
    body.trim().lines().map(String::from).collect()
}

/// Returns whether `mdbook` and `chromium` exist. Prints a message if not.
fn available() -> bool {
    let missing: Vec<_> = ["mdbook", "chromium"]
        .into_iter()
        .filter(|name| Command::new(name).arg("--version").output().is_err())
        .collect();
    if !missing.is_empty() {
        eprintln!("skipped: the test of the book needs {}", missing.join(" and "));
    }
    missing.is_empty()
}

fn build(folder: &Path) {
    let output = Command::new("mdbook")
        .args(["build", "docs", "--dest-dir"])
        .arg(folder.join("book"))
        .current_dir(root())
        .output();
    let output = output.expect("mdbook runs");
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && !message.contains("WARN"), "{message}");
}

#[test]
fn the_book_has_no_broken_link_and_fits_narrow_and_wide_windows() {
    if !available() {
        return;
    }
    let dir = TempDir::new().expect("a folder");
    build(dir.path());
    let lines = examine(dir.path());
    assert!(lines.len() == 1, "{}", lines.join("\n"));
    let [examined, all] = [1, 3].map(|word| {
        lines[0].split(' ').nth(word).expect("a count").parse::<usize>().expect("a number")
    });
    assert!(examined == all && all >= 30, "{}", lines[0]);

    // The script finds the faults of a page.
    let page = dir.path().join("book/when_not.html");
    let html = fs::read_to_string(&page).expect("a page");
    let faulty = "<main><a href='nowhere.html'>a</a><a href='method.html#nowhere'>b</a><img src='no.png'><p style='width:500px'>wide</p>";
    fs::write(&page, html.replace("<main>", faulty)).expect("a page");
    let lines = examine(dir.path());
    for fault in [
        "broken link nowhere.html",
        "broken link method.html#nowhere",
        "no image no.png",
        "at 400 px: P ",
    ] {
        assert!(lines.iter().any(|line| line.contains(fault)), "{fault} is not found: {lines:?}");
    }
}

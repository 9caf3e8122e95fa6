//! Pages tell the truth: their links lead somewhere, and the paths, functions and tests they name exist.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use crate::source_tree::{crate_sources, files, read, root, shown, texts};

/// Every page of the repository.
fn pages() -> Vec<(PathBuf, String)> {
    texts(&root(), "md")
}

/// Text outside fenced code.
fn prose(page: &str) -> String {
    page.split("```").step_by(2).collect()
}

/// Targets of `[text](target)`.
fn links(page: &str) -> Vec<String> {
    let prose = prose(page);
    prose
        .match_indices("](")
        .filter_map(|(position, _)| prose[position + 2..].split([')', ' ', '\n']).next().map(String::from))
        .collect()
}

/// Spans in `backticks`.
fn code_spans(text: &str) -> Vec<String> {
    prose(text)
        .lines()
        .flat_map(|line| line.split('`').skip(1).step_by(2).map(String::from).collect::<Vec<_>>())
        .collect()
}

/// Anchors of the headings of a page, as GitHub and mdBook make them.
fn anchors(page: &str) -> HashSet<String> {
    let headings =
        page.lines().filter(|line| line.starts_with('#')).map(|line| line.trim_start_matches('#').trim());
    headings
        .map(|heading| {
            let kept = heading.to_lowercase().replace(' ', "-");
            kept.chars().filter(|c| c.is_alphanumeric() || *c == '-' || *c == '_').collect()
        })
        .collect()
}

#[test]
fn relative_links_lead_somewhere() {
    let mut faults = Vec::new();
    for (path, text) in pages() {
        for link in links(&text) {
            let is_outside = link.contains("://") || link.starts_with("mailto:");
            if is_outside || link.is_empty() {
                continue;
            }
            let (file, anchor) = link.split_once('#').unwrap_or((&link, ""));
            let target = if file.is_empty() { path.clone() } else { path.parent().unwrap().join(file) };
            if !target.exists() {
                faults.push(format!("{}: no file at {link}", shown(&path)));
            } else if !anchor.is_empty()
                && target.extension().is_some_and(|e| e == "md")
                && !anchors(&read(&target)).contains(anchor)
            {
                faults.push(format!("{}: no heading for {link}", shown(&path)));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn paths_named_in_pages_exist() {
    // A part of the repository that is not there at all says nothing about the pages.
    let folders = ["crates/", "ci/", ".ci/", "book/", "configs/", "tools/"].into_iter();
    let folders: Vec<&str> = folders.filter(|folder| root().join(folder).exists()).collect();
    let mut faults = Vec::new();
    for (path, text) in pages() {
        for span in code_spans(&text) {
            let word =
                span.split([' ', ':']).find(|word| folders.iter().any(|folder| word.starts_with(folder)));
            let is_literal = |word: &&str| !word.contains(['*', '<', '{', '…']);
            if let Some(word) = word.filter(is_literal).filter(|word| !root().join(word).exists()) {
                faults.push(format!("{}: `{word}` does not exist", shown(&path)));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn every_page_of_the_book_is_in_its_table_of_contents() {
    let folder = root().join("book/src");
    let summary = folder.join("SUMMARY.md");
    if !summary.exists() {
        return;
    }
    let listed: HashSet<PathBuf> = links(&read(&summary)).iter().map(|link| folder.join(link)).collect();
    let missing: Vec<String> = files(&folder)
        .iter()
        .filter(|path| {
            path.extension().is_some_and(|e| e == "md") && **path != summary && !listed.contains(*path)
        })
        .map(|path| shown(path))
        .collect();
    assert!(missing.is_empty(), "not in book/src/SUMMARY.md: {missing:?}");
}

/// Names that the sources define: items, fields, variants, modules and tests.
fn defined_names() -> HashSet<String> {
    let mut names = HashSet::new();
    let sources = crate_sources().into_iter().flat_map(|(_, folder)| {
        let tests = folder.parent().map(|p| p.join("tests")).unwrap_or_default();
        [texts(&folder, "rs"), texts(&tests, "rs")].concat()
    });
    for (path, text) in sources {
        names.extend(path.file_stem().map(|stem| stem.to_string_lossy().into_owned()));
        names.extend(path.parent().and_then(Path::file_name).map(|name| name.to_string_lossy().into_owned()));
        for line in text.lines().map(str::trim_start).filter(|line| !line.starts_with("//")) {
            let words: Vec<&str> = line.split(|c: char| !(c.is_alphanumeric() || c == '_')).collect();
            let keywords = ["fn", "struct", "enum", "trait", "type", "const", "static", "mod"];
            names.extend(words.windows(2).filter(|w| keywords.contains(&w[0])).map(|w| w[1].to_string()));
            // A field or a variant begins its line.
            let first = words.iter().find(|word| !word.is_empty() && **word != "pub" && **word != "crate");
            names.extend(first.map(|word| word.to_string()));
        }
    }
    names
}

#[test]
fn the_paper_map_names_what_exists() {
    let page = root().join("book/src/paper_map.md");
    if !page.exists() {
        return;
    }
    let names = defined_names();
    let library = root().join("crates/habitus");
    let mut faults = Vec::new();
    let mut found_names = 0;
    for span in code_spans(&read(&page)) {
        let is_path = span.contains('/') || span.ends_with(".rs");
        if is_path {
            let places =
                [root().join(&span), library.join("src").join(&span), library.join("tests").join(&span)];
            if !places.iter().any(|place| place.exists()) {
                faults.push(format!("no file `{span}`"));
            }
            continue;
        }
        let name = span.trim_end_matches("()").rsplit("::").next().unwrap_or_default();
        let is_identifier = !name.is_empty() && name.chars().all(|c| c.is_alphanumeric() || c == '_');
        if is_identifier && span.chars().all(|c| c.is_alphanumeric() || "_:()".contains(c)) {
            found_names += 1;
            if !names.contains(name) {
                faults.push(format!("nothing is called `{span}`"));
            }
        }
    }
    assert!(faults.is_empty(), "book/src/paper_map.md: {}", faults.join("\n"));
    assert!(found_names > 0, "book/src/paper_map.md names no function");
}

//! Habits that every source file keeps.

use std::path::Path;

use crate::source_tree::{code, crate_sources, files, is_unit_test, read, root, shown, texts};

/// Source files of all library crates: everything but the command line.
fn library_sources() -> Vec<(std::path::PathBuf, String)> {
    crate_sources()
        .into_iter()
        .filter(|(name, _)| name != "habitus-cli")
        .flat_map(|(_, folder)| texts(&folder, "rs"))
        .filter(|(path, _)| !is_unit_test(path))
        .collect()
}

/// Whether `word` occurs in `code` and is not the end of a longer word.
fn has_word(code: &str, word: &str) -> bool {
    code.match_indices(word).any(|(position, _)| {
        !code[..position].chars().next_back().is_some_and(|before| before.is_alphanumeric() || before == '_')
    })
}

#[test]
fn libraries_do_not_print_read_the_environment_or_start_threads() {
    let forbidden = [
        ("println!", "return it, or tell the observer"),
        ("eprintln!", "return it, or tell the observer"),
        ("print!", "return it, or tell the observer"),
        ("eprint!", "return it, or tell the observer"),
        ("dbg!", "remove it"),
        ("todo!", "finish it"),
        ("unimplemented!", "finish it"),
        ("std::env", "take it as an argument; the command line reads the environment"),
        ("std::process", "return an error; the command line chooses the exit code"),
        ("ThreadPoolBuilder", "use the pool of the caller"),
        ("thread::spawn", "use the pool of the caller, or a scoped thread"),
    ];
    let mut faults = Vec::new();
    for (path, text) in library_sources() {
        for (line_index, line) in code(&text).lines().enumerate() {
            for (word, remedy) in forbidden {
                if has_word(line, word) {
                    faults.push(format!("{}:{}: {word} — {remedy}", shown(&path), line_index + 1));
                }
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn no_work_is_left_marked() {
    let marks = ["TO", "FIX", "XX"].map(|start| {
        [
            start,
            if start == "TO" {
                "DO"
            } else if start == "XX" {
                "X"
            } else {
                "ME"
            },
        ]
        .concat()
    });
    let mut faults = Vec::new();
    for (path, text) in crate_sources().iter().flat_map(|(_, folder)| texts(folder, "rs")) {
        for (line_index, line) in text.lines().enumerate() {
            if marks.iter().any(|mark| has_word(line, mark)) {
                faults.push(format!("{}:{}: {}", shown(&path), line_index + 1, line.trim()));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

const TEXT_EXTENSIONS: [&str; 15] =
    ["rs", "md", "toml", "json", "py", "sh", "js", "mjs", "html", "css", "txt", "yml", "yaml", "svg", ""];

#[test]
fn no_machine_path_is_in_the_tree() {
    // Spelled in halves, or this file would be its own finding.
    let folders =
        ["wo rk", "tm p", "ro ot", "ho me", "Use rs"].map(|halves| format!("/{}/", halves.replace(' ', "")));
    let mut faults = Vec::new();
    for path in files(&root()) {
        let extension = path.extension().unwrap_or_default().to_string_lossy().into_owned();
        if !TEXT_EXTENSIONS.contains(&extension.as_str()) {
            continue;
        }
        for (line_index, line) in read(&path).lines().enumerate() {
            let found = folders.iter().find(|folder| {
                line.match_indices(folder.as_str()).any(|(position, _)| {
                    // Preceded by a name, it is a folder of ours or of a web address.
                    !line[..position].ends_with(|c: char| c.is_alphanumeric() || "._-/}>*".contains(c))
                })
            });
            if let Some(folder) = found {
                faults.push(format!("{}:{}: {folder}", shown(&path), line_index + 1));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn packages_come_from_the_public_registry() {
    let Ok(lock) = std::fs::read_to_string(root().join("Cargo.lock")) else { return };
    let public = "source = \"registry+https://github.com/rust-lang/crates.io-index\"";
    let other: Vec<&str> =
        lock.lines().filter(|line| line.starts_with("source") && *line != public).collect();
    assert!(other.is_empty(), "{other:?}");
    assert!(
        !root().join(".cargo/config.toml").exists(),
        "a registry or flag set here would differ from a fresh checkout"
    );
}

#[test]
fn every_deviation_from_the_papers_is_recorded() {
    let page = root().join("book/src/deviations.md");
    if !page.exists() {
        return;
    }
    let page = read(&page);
    let library = root().join("crates/habitus/src");
    let mut faults = Vec::new();
    for (path, text) in crate_sources().iter().flat_map(|(_, folder)| texts(folder, "rs")) {
        // Inside the library, `stages/register/mod.rs` is name enough.
        let short =
            path.strip_prefix(&library).map(Path::to_path_buf).unwrap_or_else(|_| shown(&path).into());
        let has_marker =
            text.lines().any(|line| line.trim_start().starts_with("//") && line.contains("Deviation:"));
        if has_marker && !page.contains(&short.display().to_string()) {
            faults.push(format!(
                "{}: marked as a deviation, but book/src/deviations.md does not name `{}`",
                shown(&path),
                short.display()
            ));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

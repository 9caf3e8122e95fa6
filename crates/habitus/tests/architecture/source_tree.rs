//! Files of the repository, Rust code without its comments, and the paths that code names.

use std::path::{Path, PathBuf};

/// Folder of the workspace.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).unwrap().to_path_buf()
}

/// Every file below `folder`, in order of name; none if the folder does not exist. Left out are build output, results that
/// `.gitignore` names, and hidden folders other than `.ci`.
pub fn files(folder: &Path) -> Vec<PathBuf> {
    let root = root();
    let ignored = std::fs::read_to_string(root.join(".gitignore")).unwrap_or_default();
    let ignored = ignored
        .lines()
        .filter_map(|line| line.strip_prefix('/'))
        .map(|name| root.join(name))
        .collect::<Vec<_>>();
    files_except(folder, &ignored)
}

fn files_except(folder: &Path, ignored: &[PathBuf]) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    let is_ours = |path: &PathBuf| {
        let name = path.file_name().unwrap().to_string_lossy();
        let is_hidden = name.starts_with('.') && name != ".ci";
        let is_built = ["target", "node_modules", "__pycache__"].contains(&name.as_ref());
        !(is_hidden || is_built || ignored.contains(path))
    };
    let (folders, files): (Vec<_>, Vec<_>) =
        paths.into_iter().filter(is_ours).partition(|path| path.is_dir());
    files.into_iter().chain(folders.iter().flat_map(|folder| files_except(folder, ignored))).collect()
}

/// Files below `folder` whose extension is `extension`, with their text.
pub fn texts(folder: &Path, extension: &str) -> Vec<(PathBuf, String)> {
    let has_extension = |path: &PathBuf| path.extension().is_some_and(|found| found == extension);
    files(folder).into_iter().filter(has_extension).map(|path| (path.clone(), read(&path))).collect()
}

pub fn read(path: &Path) -> String {
    String::from_utf8_lossy(&std::fs::read(path).unwrap()).into_owned()
}

/// A path as the reader of a message knows it, from the workspace folder.
pub fn shown(path: &Path) -> String {
    path.strip_prefix(root()).unwrap_or(path).display().to_string()
}

/// Source folders of all crates, with the crate's name.
pub fn crate_sources() -> Vec<(String, PathBuf)> {
    let Ok(entries) = std::fs::read_dir(root().join("crates")) else { return Vec::new() };
    let mut crates: Vec<(String, PathBuf)> = entries
        .map(|entry| entry.unwrap())
        .map(|entry| (entry.file_name().to_string_lossy().into_owned(), entry.path().join("src")))
        .collect();
    crates.sort();
    crates
}

/// Code without line comments and without a trailing module of unit tests, which may look anywhere.
pub fn code(text: &str) -> String {
    let body = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or(text);
    body.lines().map(|line| line.split("//").next().unwrap_or(line)).collect::<Vec<_>>().join("\n")
}

/// Whether a file holds unit tests only.
pub fn is_unit_test(path: &Path) -> bool {
    path.ends_with("tests.rs") || path.iter().any(|part| part == "tests")
}

/// Module path of a source file: `src/fitting/terms/landmarks.rs` is `fitting::terms::landmarks`.
pub fn module_of(source_folder: &Path, file: &Path) -> Vec<String> {
    let relative = file.strip_prefix(source_folder).unwrap().with_extension("");
    let mut parts: Vec<String> = relative.iter().map(|part| part.to_string_lossy().into_owned()).collect();
    if parts.last().is_some_and(|last| ["mod", "lib", "main"].contains(&last.as_str())) {
        parts.pop();
    }
    parts
}

/// Absolute paths inside the crate that `code` of `module` names through `crate::` and `super::`.
pub fn paths_named(code: &str, module: &[String]) -> Vec<Vec<String>> {
    let mut found = Vec::new();
    for (root_word, is_crate) in [("crate::", true), ("super::", false)] {
        for (position, _) in code.match_indices(root_word) {
            let before = code[..position].chars().next_back();
            let is_continued =
                before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':' || c == '$');
            if is_continued {
                continue;
            }
            let mut base = if is_crate { Vec::new() } else { module.to_vec() };
            let mut rest = &code[position..];
            if is_crate {
                rest = &rest[root_word.len()..];
            }
            while let Some(after) = rest.strip_prefix("super::") {
                base.pop();
                rest = after;
            }
            expand(rest, &base, &mut found);
        }
    }
    found
}

/// Paths named by external code: `krate::fitting::Fit` gives `["fitting", "Fit"]`.
pub fn paths_into(code: &str, krate: &str) -> Vec<Vec<String>> {
    let mut found = Vec::new();
    let prefix = format!("{krate}::");
    for (position, _) in code.match_indices(&prefix) {
        let before = code[..position].chars().next_back();
        if !before.is_some_and(|c| c.is_alphanumeric() || c == '_') {
            expand(&code[position + prefix.len()..], &[], &mut found);
        }
    }
    found
}

/// Follows one use tree, `a::{b, c::{d, e}}`, and returns what is left of the text after it.
fn expand<'a>(text: &'a str, base: &[String], found: &mut Vec<Vec<String>>) -> &'a str {
    let text = text.trim_start();
    if let Some(mut rest) = text.strip_prefix('{') {
        loop {
            rest = rest.trim_start();
            if let Some(after) = rest.strip_prefix('}') {
                return after;
            }
            if rest.is_empty() {
                return rest;
            }
            rest = expand(rest, base, found).trim_start();
            // Skips renames and commas.
            let stop = rest.find([',', '}']).unwrap_or(rest.len());
            rest = rest[stop..].strip_prefix(',').unwrap_or(&rest[stop..]);
        }
    }
    let end = text.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(text.len());
    let mut path = base.to_vec();
    if end > 0 && &text[..end] != "self" {
        path.push(text[..end].to_string());
    }
    match text[end..].strip_prefix("::") {
        Some(after) => expand(after, &path, found),
        None => {
            found.push(path);
            &text[end..]
        }
    }
}

#[test]
fn use_trees_are_followed_to_their_leaves() {
    let module = ["stages", "register"].map(String::from);
    let code = "use crate::{body::{Pose, model::{self, A as B}}, fitting};\nlet x = super::super::measure::girth(y);";
    let named: Vec<String> = paths_named(code, &module).iter().map(|path| path.join("::")).collect();
    assert_eq!(named, ["body::Pose", "body::model", "body::model::A", "fitting", "measure::girth"]);
}

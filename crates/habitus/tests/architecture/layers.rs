//! Module edges of the library: arrows go down only, and no stage knows another.

use crate::source_tree::{
    code, crate_sources, is_unit_test, module_of, paths_into, paths_named, root, shown, texts,
};

/// What each module of the library may use of the others, from the bottom up. Every module may use itself and the two
/// foundation crates; a row for a part of a module, such as `artifacts::npz`, stands for that part alone.
const ALLOWED: [(&str, &[&str]); 8] = [
    // Layer 1: the file container, the body, and what stages hand to one another.
    ("artifacts::npz", &["artifacts::write_atomically"]),
    ("statistics", &["artifacts::npz"]),
    ("body", &["artifacts::npz", "statistics"]),
    ("artifacts", &["artifacts::npz", "body", "statistics"]),
    // Layer 2: the one loop with exchangeable terms.
    ("fitting", &["artifacts", "body", "statistics"]),
    // Layer 3: recipes, and what measures their results.
    ("evaluation", &["artifacts", "body", "statistics"]),
    ("stages", &["artifacts", "body", "evaluation", "fitting", "statistics"]),
    // Layer 4: the only place that puts stages in order.
    ("pipeline", &["artifacts", "body", "evaluation", "fitting", "stages", "statistics"]),
];

/// What the report may use of the library: it shows what is on disk and computes no fit.
const ALLOWED_IN_REPORT: [&str; 5] = ["artifacts", "body", "evaluation", "geometry", "statistics"];

/// Root names that are the foundation crates, not modules.
const FOUNDATIONS: [&str; 2] = ["geometry", "optimize"];

fn library_folder() -> std::path::PathBuf {
    root().join("crates/habitus/src")
}

/// Whether `path` is `prefix` or lies in it.
fn lies_in(path: &str, prefix: &str) -> bool {
    path.strip_prefix(prefix).is_some_and(|rest| rest.is_empty() || rest.starts_with("::"))
}

#[test]
fn library_modules_use_only_what_lies_below_them() {
    let folder = library_folder();
    let mut faults = Vec::new();
    for (path, text) in texts(&folder, "rs") {
        let module = module_of(&folder, &path);
        if module.is_empty() || is_unit_test(&path) {
            continue;
        }
        let own_path = module.join("::");
        let row = ALLOWED.iter().filter(|(row, _)| lies_in(&own_path, row)).max_by_key(|(row, _)| row.len());
        let Some((own, allowed)) = row else {
            faults.push(format!(
                "{}: module `{own_path}` has no row in the table of {}",
                shown(&path),
                file!()
            ));
            continue;
        };
        for named in paths_named(&code(&text), &module) {
            let named = named.join("::");
            let is_allowed =
                allowed.iter().chain(&FOUNDATIONS).chain([own]).any(|allowed| lies_in(&named, allowed));
            if !(named.is_empty() || is_allowed) {
                faults.push(format!("{}: `{own}` must not use `{named}`", shown(&path)));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn the_table_of_layers_has_no_cycle() {
    for (index, (name, allowed)) in ALLOWED.iter().enumerate() {
        for target in *allowed {
            let is_above = ALLOWED.iter().skip(index).any(|(row, _)| row == target);
            assert!(!is_above, "`{name}` names `{target}`, which is not below it");
        }
    }
}

#[test]
fn a_stage_never_uses_another_stage() {
    let folder = library_folder();
    let mut faults = Vec::new();
    for (path, text) in texts(&folder.join("stages"), "rs") {
        let module = module_of(&folder, &path);
        let Some(own) = module.get(1) else { continue };
        for named in paths_named(&code(&text), &module) {
            if named.first().is_some_and(|first| first == "stages")
                && named.get(1).is_some_and(|stage| stage != own)
            {
                faults.push(format!("{}: stage `{own}` must not use `{}`", shown(&path), named.join("::")));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn the_report_computes_no_fit() {
    let mut faults = Vec::new();
    for (path, text) in texts(&root().join("crates/habitus-report/src"), "rs") {
        if is_unit_test(&path) {
            continue;
        }
        let code = code(&text);
        for named in paths_into(&code, "habitus") {
            if !named.first().is_some_and(|target| ALLOWED_IN_REPORT.contains(&target.as_str())) {
                faults.push(format!(
                    "{}: the report must not use habitus::{}",
                    shown(&path),
                    named.join("::")
                ));
            }
        }
        if !paths_into(&code, "habitus_optimize").is_empty() {
            faults.push(format!("{}: the report must not use habitus_optimize", shown(&path)));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn foundations_know_no_body_and_not_each_other() {
    let mut faults = Vec::new();
    for (own, other) in [("habitus-geometry", "habitus_optimize"), ("habitus-optimize", "habitus_geometry")] {
        for (path, text) in
            crate_sources().iter().filter(|(name, _)| name == own).flat_map(|(_, s)| texts(s, "rs"))
        {
            for stranger in [other, "habitus"] {
                if !paths_into(&code(&text), stranger).is_empty() {
                    faults.push(format!("{}: must not use {stranger}", shown(&path)));
                }
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

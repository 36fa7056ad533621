//! The house is in order: no file and no function is too long, and the modules at the top of each
//! crate form no circle.
//!
//! A circle that has to be is named in the header of the file that closes it, with its reason:
//! ``//! Circle with `other`: why.`` The lists of exceptions below only ever get shorter: one that
//! is no longer needed fails the test, too.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Longest file, lines.
const FILE_LINES: usize = 500;
/// Longest function, lines.
const FUNCTION_LINES: usize = 80;

/// Longer files that are still to be split.
const LONG_FILES: &[&str] = &[];
/// Longer functions that are still to be split.
const LONG_FUNCTIONS: &[&str] = &[];
/// Crates whose circles are still to be broken.
const CIRCLES: &[&str] = &[];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_owned()
}

/// The folders of all crates.
fn crates() -> Vec<String> {
    let manifest = fs::read_to_string(root().join("Cargo.toml")).unwrap();
    let (_, members) = manifest.split_once("\nmembers = [").unwrap();
    let (members, _) = members.split_once(']').unwrap();
    members.split(',').map(|name| name.trim().trim_matches('"').to_owned()).collect()
}

/// All Rust files below a folder of the project: names from the project's root, and their texts.
fn sources(folder: &str) -> Vec<(String, String)> {
    let mut found = Vec::new();
    let mut folders = vec![root().join(folder)];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() && !path.ends_with("target") {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let name = path.strip_prefix(root()).unwrap().to_str().unwrap().to_owned();
                found.push((name, fs::read_to_string(&path).unwrap()));
            }
        }
    }
    found.sort();
    found
}

/// What is too long, against what may be.
fn compare(found: BTreeMap<String, usize>, exceptions: &[&str], most: usize) {
    let is_known = |name: &String| exceptions.contains(&name.as_str());
    let too_long: Vec<_> = found.iter().filter(|(name, lines)| **lines > most && !is_known(name)).collect();
    assert!(too_long.is_empty(), "more than {most} lines: {too_long:?}");
    let is_needed = |name: &&&str| found.get(**name).is_some_and(|lines| *lines > most);
    let needless: Vec<_> = exceptions.iter().filter(|name| !is_needed(name)).collect();
    assert!(needless.is_empty(), "no longer too long: take them off the list: {needless:?}");
}

#[test]
fn no_file_is_too_long() {
    let files = crates().into_iter().flat_map(|name| sources(&name));
    let lines: BTreeMap<String, usize> = files.map(|(name, text)| (name, text.lines().count())).collect();
    assert!(lines.len() > 200, "{} files", lines.len());
    compare(lines, LONG_FILES, FILE_LINES);
}

#[test]
fn no_function_is_too_long() {
    let mut lines = BTreeMap::new();
    for (file, text) in crates().into_iter().flat_map(|name| sources(&name)) {
        for (function, count) in functions(&text) {
            let longest = lines.entry(format!("{file}: {function}")).or_insert(0);
            *longest = count.max(*longest);
        }
    }
    assert!(lines.len() > 2000, "{} functions", lines.len());
    compare(lines, LONG_FUNCTIONS, FUNCTION_LINES);
}

/// Names and lengths of functions, in a text that is formatted: the last line of each is a brace
/// below its first word.
fn functions(text: &str) -> Vec<(String, usize)> {
    let lines: Vec<&str> = text.lines().collect();
    let mut found = Vec::new();
    for (at, line) in lines.iter().enumerate() {
        let words = line.trim_start();
        let indent = &line[..line.len() - words.len()];
        let Some(name) = name_of_function(words) else { continue };
        let is_end = |line: &&str| {
            line.strip_prefix(indent).is_some_and(|rest| rest == "}" || (rest.ends_with(';') && !rest.starts_with(' ')))
        };
        // One in a line ends there.
        let length = if words.ends_with('}') { 0 } else { lines[at..].iter().position(is_end).unwrap() };
        found.push((name.to_owned(), length + 1));
    }
    found
}

/// The name, in the first line of a function.
fn name_of_function(line: &str) -> Option<&str> {
    let (before, after) = line.split_once("fn ")?;
    let is_qualifier = |word: &str| {
        matches!(word, "pub" | "const" | "async" | "unsafe" | "extern" | "\"C\"" | "in")
            || word.starts_with("pub(")
            || word.ends_with(')')
    };
    let name = after.split(['(', '<']).next()?;
    (before.split_whitespace().all(is_qualifier) && !name.is_empty()).then_some(name)
}

/// Loom sees only the atomics of `common::sync`: an algorithm that took others would be checked by
/// no model.
#[test]
fn atomics_of_shared_memory_come_from_one_door() {
    // It numbers the runs of one process.
    const EXCEPTIONS: [&str; 1] = ["common/src/shm/run_id.rs"];
    let is_test = |name: &str| name.contains("tests/") || name.ends_with("tests.rs");
    let files = sources("common/src/shm");
    let has_own = |(name, text): &&(String, String)| {
        let words = ["sync::atomic", "core::sync", "loom::sync", "UnsafeCell"];
        !is_test(name) && words.iter().any(|word| code_of(text).contains(word))
    };
    let found: Vec<&str> = files.iter().filter(has_own).map(|(name, _)| name.as_str()).collect();
    assert!(files.len() > 30, "{} files", files.len());
    assert_eq!(found, EXCEPTIONS, "take atomics from common::sync");
}

#[test]
fn modules_at_the_top_of_a_crate_form_no_circle() {
    let mut circles = BTreeMap::new();
    for name in crates() {
        let uses = uses(&name);
        let reached = reached(&uses);
        let is_in_circle = |module: &&String| reached[*module].contains(*module);
        let modules: Vec<String> = uses.keys().filter(is_in_circle).cloned().collect();
        if !modules.is_empty() {
            let between = |module: &String| -> Vec<String> {
                uses[module].iter().filter(|other| modules.contains(other)).cloned().collect()
            };
            let edges: Vec<_> = modules.iter().map(|module| (module.clone(), between(module))).collect();
            circles.insert(name, edges);
        }
    }
    for (name, edges) in &circles {
        assert!(CIRCLES.contains(&name.as_str()), "{name} has a circle among its modules: {edges:#?}");
    }
    let needless: Vec<_> = CIRCLES.iter().filter(|name| !circles.contains_key(**name)).collect();
    assert!(needless.is_empty(), "without circles now: take them off the list: {needless:?}");
}

/// Of each module at the top of a crate, the others that it uses.
fn uses(name: &str) -> BTreeMap<String, BTreeSet<String>> {
    let source = format!("{name}/src/");
    let files = sources(&source);
    let place_of = |file: &str| -> Vec<String> {
        let place = file.strip_prefix(&source).unwrap().trim_end_matches(".rs").split('/');
        place.filter(|part| *part != "mod").map(str::to_owned).collect()
    };
    let is_module = |place: &[String]| !matches!(place[0].as_str(), "lib" | "main" | "bin");
    let modules: BTreeSet<String> =
        files.iter().map(|(file, _)| place_of(file)).filter(|place| is_module(place)).map(|p| p[0].clone()).collect();
    // What stands at the crate's root may be another module's.
    let roots = files.iter().find(|(file, _)| place_of(file) == ["lib"]);
    let mut exported: BTreeMap<String, String> = BTreeMap::new();
    for line in roots.iter().flat_map(|(_, text)| text.split(';')) {
        if let Some((_, path)) = line.rsplit_once("pub use ") {
            let module = first_word(path);
            path.split(|c: char| !c.is_alphanumeric() && c != '_').for_each(|word| {
                exported.entry(word.to_owned()).or_insert(module.to_owned());
            });
        }
    }
    let mut uses: BTreeMap<String, BTreeSet<String>> =
        modules.iter().map(|module| (module.clone(), BTreeSet::new())).collect();
    for (file, text) in &files {
        let place = place_of(file);
        if !is_module(&place) || place.last().is_some_and(|last| last.ends_with("tests")) {
            continue;
        }
        let used = names_at_root(&code_of(text), place.len());
        let used = used
            .into_iter()
            .map(|name| exported.get(&name).filter(|_| !modules.contains(&name)).cloned().unwrap_or(name));
        let excused =
            |other: &String| text.lines().any(|line| line.starts_with(&format!("//! Circle with `{other}`:")));
        let used = used.filter(|other| *other != place[0] && modules.contains(other) && !excused(other));
        uses.get_mut(&place[0]).unwrap().extend(used);
    }
    uses
}

/// A text without comments, and without the tests at its end.
fn code_of(text: &str) -> String {
    let lines: Vec<&str> = text.lines().collect();
    let is_tests =
        |pair: &[&str]| pair[0].trim() == "#[cfg(test)]" && pair[1].contains("mod ") && pair[1].ends_with('{');
    let end = lines.windows(2).position(is_tests).unwrap_or(lines.len());
    lines[..end].iter().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n")
}

/// What a file so deep in the crate names at the crate's root: by `crate::`, or by `super::` as
/// often as it is deep.
fn names_at_root(code: &str, depth: usize) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for start in ["crate::".to_owned(), "super::".repeat(depth)] {
        for (at, _) in code.match_indices(&start) {
            // Not a part of a longer path, or of a longer word.
            if code[..at].ends_with(|c: char| c == ':' || c == '_' || c == '$' || c.is_alphanumeric()) {
                continue;
            }
            let rest = &code[at + start.len()..];
            match rest.strip_prefix('{') {
                Some(list) => names.extend(first_words(list)),
                None => drop(names.insert(first_word(rest).to_owned())),
            }
        }
    }
    names
}

fn first_word(text: &str) -> &str {
    let text = text.trim_start();
    text.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or_default()
}

/// The first words of the paths in a list, up to the brace that closes it.
fn first_words(list: &str) -> Vec<String> {
    let (mut depth, mut words, mut start) = (0, Vec::new(), 0);
    for (at, c) in list.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth > 0 => depth -= 1,
            ',' | '}' if depth == 0 => {
                words.push(first_word(&list[start..at]).to_owned());
                start = at + 1;
                if c == '}' {
                    break;
                }
            }
            _ => {}
        }
    }
    words
}

/// Of each module, all that it uses, itself or by way of others.
fn reached(uses: &BTreeMap<String, BTreeSet<String>>) -> BTreeMap<String, BTreeSet<String>> {
    let mut reached = uses.clone();
    loop {
        let mut has_grown = false;
        for module in uses.keys() {
            let more: BTreeSet<String> =
                reached[module].iter().flat_map(|other| reached[other].iter().cloned()).collect();
            let known = reached.get_mut(module).unwrap();
            let before = known.len();
            known.extend(more);
            has_grown |= known.len() > before;
        }
        if !has_grown {
            return reached;
        }
    }
}

/// The tools of these tests see what they are to see.
#[test]
fn lengths_and_circles_are_noticed() {
    let text = "impl A {\n    pub(crate) fn long(\n        a: u8,\n    ) -> u8 {\n        a\n    }\n    fn short() {}\n    fn declared();\n}\n";
    let found = functions(text);
    assert_eq!(found, [("long".to_owned(), 5), ("short".to_owned(), 1), ("declared".to_owned(), 1)]);
    let code =
        code_of("use crate::{a::B, c};\n// crate::d\nuse super::super::e;\n#[cfg(test)]\nmod tests {\nuse crate::f;\n");
    assert_eq!(names_at_root(&code, 2), ["a", "c", "e"].map(str::to_owned).into());
    let edges = |pairs: &[(&str, &str)]| -> BTreeMap<String, BTreeSet<String>> {
        let mut uses = BTreeMap::new();
        for (from, to) in pairs {
            uses.entry((*from).to_owned()).or_insert_with(BTreeSet::new).insert((*to).to_owned());
            uses.entry((*to).to_owned()).or_insert_with(BTreeSet::new);
        }
        reached(&uses)
    };
    assert!(edges(&[("a", "b"), ("b", "c"), ("c", "a")])["a"].contains("a"));
    assert!(!edges(&[("a", "b"), ("a", "c"), ("b", "c")])["a"].contains("a"));
}

//! Documents say what is there: ARCHITECTURE.md has a row for every crate and every segment and no
//! others, links lead somewhere.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use terravision_common::shm::SegmentKind;
use terravision_tests::folder::TestFolder;
use terravision_tests::process::Terravision;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_owned()
}

fn read(name: &str) -> String {
    std::fs::read_to_string(root().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// What stands first in the rows of the first table behind a heading: the word between the first
/// backquotes.
fn rows(heading: &str) -> BTreeSet<String> {
    let text = read("ARCHITECTURE.md");
    let (_, section) = text.split_once(&format!("## {heading}\n")).unwrap_or_else(|| panic!("no section {heading}"));
    let table = section.lines().skip_while(|line| !line.starts_with('|')).take_while(|line| line.starts_with('|'));
    table.filter_map(|line| Some(line.strip_prefix("| `")?.split_once('`')?.0.to_owned())).collect()
}

#[test]
fn every_crate_has_a_row_and_every_row_a_folder() {
    let manifest = read("Cargo.toml");
    let (_, members) = manifest.split_once("members = [").unwrap();
    let (members, _) = members.split_once(']').unwrap();
    let members: BTreeSet<String> = members.split(',').map(|name| name.trim().trim_matches('"').to_owned()).collect();
    let rows = rows("Crates");
    let missing: Vec<_> = members.difference(&rows).collect();
    assert!(members.len() > 5 && missing.is_empty(), "crates without a row: {missing:?}");
    let gone: Vec<_> = rows.iter().filter(|row| !root().join(row).is_dir()).collect();
    assert!(gone.is_empty(), "rows without a folder: {gone:?}");
}

#[test]
fn every_segment_has_a_row_and_every_row_a_segment() {
    let segments: BTreeSet<String> = SegmentKind::ALL.iter().map(|kind| kind.name().to_owned()).collect();
    assert_eq!(rows("Shared-memory segments"), segments);
}

#[test]
fn every_bound_that_is_listed_exists_where_it_is_said_to_be() {
    let text = read("ARCHITECTURE.md");
    let (_, section) = text.split_once("## Bounds\n").unwrap();
    let table = section.lines().skip_while(|line| !line.starts_with('|')).take_while(|line| line.starts_with('|'));
    let mut bounds = 0;
    for row in table.filter(|row| row.starts_with("| `")) {
        let cells: Vec<&str> = row.trim_matches('|').split(" | ").map(str::trim).collect();
        let [constant, _input, bound, place] = cells[..] else { panic!("{row}: expected four cells") };
        let quoted = |cell: &'_ str| cell.split('`').nth(1).unwrap().to_owned();
        let code = read(&quoted(place));
        // A bound may name a second constant in the same file.
        let second = bound.split('`').nth(1).filter(|name| name.chars().all(|c| c.is_ascii_uppercase() || c == '_'));
        for name in [Some(quoted(constant)), second.map(str::to_owned)].into_iter().flatten() {
            let is_there = match name.chars().all(|c| c.is_ascii_uppercase() || c == '_') {
                true => code.contains(&format!("const {name}: ")),
                false => code.contains(&format!("{name}(")) || code.contains(&format!("{name}: ")),
            };
            assert!(is_there, "{name} is not in {place}");
            bounds += 1;
        }
        assert!(bound.chars().any(|c| c.is_ascii_digit()) || !constant.contains("MOST_"), "{row}: no number");
    }
    assert!(bounds > 25, "{bounds} bounds");
}

/// The targets of links in Markdown.
fn links(text: &str) -> impl Iterator<Item = &str> {
    text.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(target, _)| target)
}

#[test]
fn links_within_the_project_lead_somewhere() {
    let documents = std::fs::read_dir(root().join("docs")).unwrap().map(|entry| entry.unwrap().path());
    let top = ["README.md", "ARCHITECTURE.md", "CHANGELOG.md"].map(|name| root().join(name));
    let mut looked_at = 0;
    for document in documents.chain(top).filter(|path| path.extension().is_some_and(|e| e == "md")) {
        let text = std::fs::read_to_string(&document).unwrap();
        for link in links(&text).filter(|link| !link.contains("://") && !link.starts_with('#')) {
            let path = link.split('#').next().unwrap();
            let target = document.parent().unwrap().join(path);
            assert!(target.exists(), "{}: {link} leads nowhere", document.display());
            looked_at += 1;
        }
    }
    assert!(looked_at > 20, "{looked_at} links");
}

/// Names that were replaced by those that a graphics or GIS engineer knows.
const REPLACED_NAMES: &[(&str, &str)] = &[
    ("Accounts", "usage"),
    ("Books", "request table"),
    ("CrewError", "ExecutorError"),
    ("Doubts", "Unproven"),
    ("FrameFigures", "FrameStats"),
    ("PrefetchFigures", "PrefetchStats"),
    ("RunFigures", "RunStats"),
    ("Wish", "Priority"),
    ("become_program", "exec_program"),
    ("is_unavailable", "a name that says what it returns"),
    ("limited_server", "fault_server"),
    ("nearest_proof", "find_witness"),
    ("passed_on", "exec subcommand"),
    ("strange_events", "malformed_events"),
    ("take_what_is_there", "pin_resident"),
];

/// Files and folders of crates that were renamed.
const REPLACED_FILES: &[(&str, &str)] = &[
    ("crew", "executor"),
    ("desk", "scheduler"),
    ("limited-server", "testkit/src/fault_server"),
    ("resting", "negative_cache"),
    ("sharpness", "detail_coverage"),
    ("there", "resident_tiles"),
    ("thinning", "decimation"),
    ("trim", "block_culling"),
];

/// Phrases that only their authors understand at once, in comments, messages and documents.
const REPLACED_PHRASES: &[(&str, &str)] = &[
    ("all the same to", "regardless of"),
    ("are no text", "are not text"),
    ("is none.", "`None`, or what is missing"),
    ("it is no", "it is not a"),
    ("so many-th", "frame number n"),
    ("so many ", "this many"),
    ("so so ", "limited"),
    ("that cannot be.", "what was expected, and what was found"),
    ("whoever ", "the one that"),
    ("without a word", "without a message"),
];

/// All sources, documents, scripts and shaders that the project's folders have, with their texts.
fn texts() -> Vec<(String, String)> {
    let mut found = Vec::new();
    let mut folders = vec![root()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.strip_prefix(root()).unwrap().to_str().unwrap().to_owned();
            if path.is_dir() && name != "target" && !name.starts_with('.') && !name.ends_with("node_modules") {
                folders.push(path);
            } else if path.extension().is_some_and(|e| ["rs", "md", "sh", "py", "wgsl"].iter().any(|kind| e == *kind)) {
                found.push((name, std::fs::read_to_string(&path).unwrap()));
            }
        }
    }
    // The list itself, and what was once said of earlier versions.
    found.retain(|(name, _)| name != "tests/tests/documents.rs" && name != "CHANGELOG.md");
    found.sort();
    found
}

#[test]
fn words_that_were_replaced_do_not_come_back() {
    let texts = texts();
    assert!(texts.len() > 500, "{} files", texts.len());
    for (file, text) in &texts {
        for (part, replacement) in REPLACED_FILES {
            let is_part = |name: &str| name.strip_suffix(".rs").unwrap_or(name) == *part;
            assert!(!file.split('/').any(is_part), "{file}: {part} is called {replacement} now");
        }
        let words: BTreeSet<&str> = text.split(|c: char| !c.is_alphanumeric() && c != '_').collect();
        for (name, replacement) in REPLACED_NAMES {
            assert!(!words.contains(name), "{file}: {name} is called {replacement} now");
        }
        for (number, line) in text.lines().enumerate() {
            let line = line.to_lowercase();
            let found = REPLACED_PHRASES.iter().find(|(phrase, _)| has_phrase(&line, phrase));
            if let Some((phrase, replacement)) = found {
                panic!("{file}:{}: say \"{replacement}\" for \"{phrase}\"", number + 1);
            }
        }
    }
}

/// Whether a line has a phrase, from the beginning of a word to the end of one.
fn has_phrase(line: &str, phrase: &str) -> bool {
    let is_letter = |c: Option<char>| c.is_some_and(char::is_alphanumeric);
    line.match_indices(phrase).any(|(at, _)| {
        let behind = &line[at + phrase.len()..];
        let ends = !phrase.ends_with(char::is_alphanumeric) || !is_letter(behind.chars().next());
        ends && !is_letter(line[..at].chars().next_back())
    })
}

/// With modules in place of NumPy and Pillow that are not there.
#[test]
fn examples_without_their_modules_say_so_in_a_sentence() {
    let folder = TestFolder::new("no-numpy");
    let modules = [("numpy.py", "numpy"), ("PIL.py", "PIL")];
    for (file, name) in modules {
        std::fs::write(folder.join(file), format!("raise ImportError('not here', name='{name}')\n")).unwrap();
    }
    for script in ["fly_circle.py", "read_frames.py"] {
        let command = Terravision::program("python3").arg(root().join("examples").join(script)).arg("nothing");
        let finished = command.env("PYTHONPATH", folder.path()).env("PYTHONDONTWRITEBYTECODE", "1").run();
        finished.assert_code(1);
        assert_eq!(finished.stderr.lines().count(), 1, "{}", finished.stderr);
        assert!(finished.stderr.contains("is missing: apt-get install python3-numpy"), "{}", finished.stderr);
    }
}

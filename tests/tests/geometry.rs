//! Geometry has one home, `common/src/surface`: no other code of a stage adds a height to an x and
//! a y, compares an eye with the world's borders, steps to the node beside another one, or knows
//! the formula of a facet. Found by what such code looks like.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs;
use std::path::{Path, PathBuf};

/// Folders of the code that asks the surface, and of the shaders that have a home of their own.
const FOLDERS: &[&str] = &[
    "common/src",
    "generator/src",
    "preparer/src",
    "prefetcher/src",
    "launcher/src",
    "renderer/src",
    "renderer/shaders",
    "raycast/src",
];
/// The home, and its counterpart for graphics devices.
const HOMES: &[&str] = &[
    "common/src/surface/",
    "renderer/shaders/surface.wgsl",
    "renderer/shaders/plane.wgsl",
    "renderer/shaders/globe.wgsl",
];

/// What code looks like that should have asked.
struct Pattern {
    /// A line of code that it is found in.
    example: &'static str,
    /// Parts that follow each other in such a line.
    parts: &'static [&'static str],
    /// What to ask instead.
    ask: &'static str,
    /// Where it may stand, and why.
    allowed: &'static [(&'static str, &'static str)],
}

const DESCRIBES: &str = "says how large a database is, not where something lies";
const PLACE: &str = "a place in the CRS, which is easting, northing and height";

const PATTERNS: &[Pattern] = &[
    Pattern {
        example: "let x = f64::from(column) * world.lattice_unit_m();",
        parts: &[".lattice_unit_m()"],
        ask: "Plane::column, row, foot_of_lattice",
        allowed: &[],
    },
    Pattern {
        example: "let [width, height] = world.extent_m();",
        parts: &[".extent_m()"],
        ask: "Plane::end, holds, is_over",
        allowed: &[("launcher/src/command/info.rs", DESCRIBES), ("launcher/src/command/places.rs", DESCRIBES)],
    },
    Pattern {
        example: "(0.0..=extent_m[axis]).contains(&eye[axis])",
        parts: &["0.0..=", "extent"],
        ask: "Plane::is_over",
        allowed: &[],
    },
    Pattern {
        example: "let east = camera.eye_in_world[0] - x;",
        parts: &["eye_in_world["],
        ask: "Plane::foot, height_m, eye_cell, lattice_under",
        allowed: &[("common/src/camera.rs", "poses between two poses, number by number")],
    },
    Pattern {
        example: "let above = camera.eye().z - ground;",
        parts: &["eye().z"],
        ask: "Plane::height_m, height_above",
        allowed: &[],
    },
    Pattern {
        example: "let above = eye.z - self.datum_m;",
        parts: &["eye.z"],
        ask: "Plane::height_m, height_above",
        allowed: &[("launcher/src/data_set/listing.rs", "the third number of a place in the CRS")],
    },
    Pattern {
        example: "let from_eye = corner - eye.truncate();",
        parts: &["eye", ".truncate()"],
        ask: "Plane::foot, lattice_from_eye",
        allowed: &[],
    },
    Pattern {
        example: "DVec3::new(x as f64 * unit, y as f64 * unit, height) - eye",
        parts: &["Vec3::new(", "unit", "height"],
        ask: "Plane::vertex, position",
        allowed: &[],
    },
    Pattern {
        example: "let point = foot.extend(height_m);",
        parts: &["foot", ".extend("],
        ask: "Plane::position",
        allowed: &[],
    },
    Pattern {
        example: "let point = place.extend(height);",
        parts: &[".extend(height)"],
        ask: "Plane::position",
        allowed: &[
            ("launcher/src/path/orbit.rs", PLACE),
            ("launcher/src/path/kml/view.rs", PLACE),
            ("launcher/src/plan/pose.rs", PLACE),
        ],
    },
    Pattern {
        example: "let corner = world.node_origin(node).map(|v| v as f64 * unit);",
        parts: &["node_origin(", "as f64 *"],
        ask: "Plane::foot_of_lattice, node_bounds, place_in_node",
        allowed: &[],
    },
    Pattern {
        example: "let m = node.m().checked_add_signed(east)?;",
        parts: &[".m()", "checked_add_signed("],
        ask: "World::neighbor",
        allowed: &[],
    },
    Pattern {
        example: "for (east, north) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {",
        parts: &["(-1, 0)", "(1, 0)"],
        ask: "SIDES",
        allowed: &[],
    },
    Pattern {
        example: "let z = if u >= v { z00 + u * (z10 - z00) + v * (z11 - z10) } else { 0.0 };",
        parts: &["(z10 - z00)"],
        ask: "facet_linear",
        allowed: &[],
    },
    Pattern {
        example: "sw + (se - sw) * u + (ne - se) * v",
        parts: &["(se - sw) *"],
        ask: "facet_linear",
        allowed: &[],
    },
    Pattern {
        example: "let slope = Vec2::new(se - sw, ne - se);",
        parts: &["(se - sw, ne - se)"],
        ask: "facet_slope",
        allowed: &[],
    },
    Pattern {
        example: "var slope = vec2(corners.w - corners.z, corners.z - corners.x);",
        parts: &["corners.w - corners.z"],
        ask: "facet_slope of surface.wgsl",
        allowed: &[],
    },
    Pattern {
        example: "let ground = vec2<f32>(lattice) * frame.unit_m - frame.eye_in_cell_m;",
        parts: &["* frame.unit_m"],
        ask: "vertex_from_eye of surface.wgsl",
        allowed: &[],
    },
];

impl Pattern {
    fn is_in(&self, line: &str) -> bool {
        let mut rest = line;
        self.parts.iter().all(|part| {
            let Some((_, after)) = rest.split_once(part) else { return false };
            rest = after;
            true
        })
    }

    /// Lines of a file in which it is found: "name:line: the line".
    fn found_in(&self, name: &str, text: &str) -> Vec<String> {
        let is_allowed =
            HOMES.iter().any(|home| name.starts_with(home)) || self.allowed.iter().any(|(file, _)| name == *file);
        let lines = code(text).enumerate().filter(|(_, line)| !is_allowed && self.is_in(line));
        lines.map(|(at, line)| format!("{name}:{}: {}", at + 1, line.trim())).collect()
    }
}

/// Lines without comments, up to the tests at a file's end.
fn code(text: &str) -> impl Iterator<Item = &str> {
    let lines = text.lines().take_while(|line| *line != "#[cfg(test)]");
    lines.map(|line| line.split_once("//").map_or(line, |(code, _)| code))
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_owned()
}

/// Sources, without those of tests: names from the project's root, and texts.
fn sources() -> Vec<(String, String)> {
    let mut found = Vec::new();
    let mut folders: Vec<PathBuf> = FOLDERS.iter().map(|folder| root().join(folder)).collect();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let is_test = path.file_stem().unwrap().to_str().unwrap().ends_with("tests");
            if path.is_dir() && !is_test {
                folders.push(path);
            } else if !is_test && path.extension().is_some_and(|extension| extension == "rs" || extension == "wgsl") {
                let name = path.strip_prefix(root()).unwrap().to_str().unwrap().to_owned();
                found.push((name, fs::read_to_string(&path).unwrap()));
            }
        }
    }
    found
}

#[test]
fn geometry_is_done_in_its_home_alone() {
    let sources = sources();
    assert!(sources.len() > 250, "{} files", sources.len());
    let mut found = Vec::new();
    for pattern in PATTERNS {
        let lines = sources.iter().flat_map(|(name, text)| pattern.found_in(name, text));
        found.extend(lines.map(|line| format!("{line}\n    ask {}", pattern.ask)));
    }
    assert!(found.is_empty(), "geometry beside common/src/surface:\n{}", found.join("\n"));
}

#[test]
fn every_exception_is_needed() {
    for (file, pattern) in PATTERNS.iter().flat_map(|p| p.allowed.iter().map(move |(file, _)| (*file, p))) {
        let text = fs::read_to_string(root().join(file)).unwrap_or_else(|error| panic!("{file}: {error}"));
        assert!(code(&text).any(|line| pattern.is_in(line)), "{file} no longer has {:?}", pattern.parts);
    }
    let is_home = |(name, _): &(String, String)| HOMES.iter().any(|home| name.starts_with(home));
    assert!(sources().iter().filter(|source| is_home(source)).count() > 8, "the home is elsewhere");
}

#[test]
fn each_pattern_is_found_where_it_is_and_not_in_comments_tests_and_the_home() {
    for pattern in PATTERNS {
        let line = pattern.example;
        assert_eq!(pattern.found_in("a/src/b.rs", &format!("fn f() {{\n    {line}\n}}\n")).len(), 1, "{line}");
        assert!(pattern.found_in(&format!("{}plane/mod.rs", HOMES[0]), line).is_empty(), "{line}");
        let hidden = format!("// {line}\n#[cfg(test)]\nmod tests {{\n    {line}\n}}\n");
        assert!(pattern.found_in("a/src/b.rs", &hidden).is_empty(), "{line}");
    }
}

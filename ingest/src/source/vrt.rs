//! A VRT's sources, before GDAL opens it: they have to lie under the folder of the VRT that was named.
//!
//! GDAL opens sources by content, with all its drivers, and a VRT may name any file, archive or address in many of its
//! elements. So its XML is read here: names of sources are followed (a source that is a VRT too), everything else that
//! looks like a name is refused.

use super::access::{check_neighbours, leads_elsewhere};
use roxmltree::{Document, Node};
use std::fs;
use std::path::{Path, PathBuf};

/// No VRT is larger: it has a few hundred bytes for each source.
const MAX_BYTES: u64 = 16 << 20;
/// No tag is longer, and no more namespaces are named: what a parser does with them costs their square.
const MAX_TAG_BYTES: usize = 8 << 10;
const MAX_NAMESPACES: usize = 1000;
/// VRTs in VRTs.
const MAX_DEPTH: usize = 8;
/// How the user allows what is refused.
const ALLOW: &str = "--trust-vrt allows it";
/// Elements that name a dataset.
const NAMES: [&str; 2] = ["SourceFilename", "SourceDataset"];
/// Elements whose text is for people or describes a CRS.
const WORDS: [&str; 8] =
    ["SRS", "SourceSRS", "TargetSRS", "Description", "UnitType", "Category", "ColorInterp", "PixelFunctionType"];
/// Domains of metadata that name datasets.
const NAMING_DOMAINS: [&str; 3] = ["OVERVIEWS", "ProxyOverviewRequest", "GEOLOCATION"];

/// Checks the VRT at `path`, which exists. The message continues the sentence that begins with its name.
pub(super) fn check(path: &Path) -> Result<(), String> {
    let folder = folder_of(path).and_then(|f| f.canonicalize()).map_err(|e| format!("cannot be read: {e}"))?;
    check_file(path, &folder, 0)
}

fn folder_of(path: &Path) -> std::io::Result<PathBuf> {
    let absolute = std::path::absolute(path)?;
    Ok(absolute.parent().map_or_else(|| absolute.clone(), Path::to_owned))
}

fn check_file(path: &Path, root: &Path, depth: usize) -> Result<(), String> {
    if depth > MAX_DEPTH {
        return Err(format!("has VRTs within VRTs, more than {MAX_DEPTH} deep"));
    }
    let unreadable = |e: &dyn std::fmt::Display| format!("has a list of files that cannot be read ({e}); {ALLOW}");
    if path.metadata().map_err(|e| unreadable(&e))?.len() > MAX_BYTES {
        return Err(format!("has a list of files of more than {} MiB; {ALLOW}", MAX_BYTES >> 20));
    }
    let text = fs::read_to_string(path).map_err(|e| unreadable(&e))?;
    if text.split('<').any(|tag| tag.split('>').next().is_some_and(|tag| tag.len() > MAX_TAG_BYTES))
        || text.matches("xmlns").count() > MAX_NAMESPACES
    {
        return Err(format!("has a list of files with tags of a length that none has; {ALLOW}"));
    }
    // The parser knows no entities of the file's own, which could say what the text does not show.
    let document = Document::parse(text.trim_start_matches('\u{feff}')).map_err(|e| unreadable(&e))?;
    let folder = folder_of(path).map_err(|e| unreadable(&e))?;
    for node in document.descendants().filter(Node::is_element) {
        check_node(node, &folder, root, depth)?;
    }
    Ok(())
}

fn check_node(node: Node<'_, '_>, folder: &Path, root: &Path, depth: usize) -> Result<(), String> {
    let name = node.tag_name().name();
    let is = |list: &[&str]| list.iter().any(|n| n.eq_ignore_ascii_case(name));
    let text: String = node.children().filter(Node::is_text).filter_map(|n| n.text()).collect();
    let text = text.trim();
    if is(&NAMES) {
        let relative = node.attributes().find(|a| a.name().eq_ignore_ascii_case("relativeToVRT"));
        let is_relative = relative.is_some_and(|a| a.value().trim().starts_with('1'));
        return check_source(text, is_relative.then_some(folder), root, depth);
    }
    if is(&["Metadata"]) && node.attribute("domain").is_some_and(|d| NAMING_DOMAINS.contains(&d)) {
        return Err(format!("has metadata that name other files; {ALLOW}"));
    }
    if is(&["PixelFunctionCode"]) {
        return Err(format!("has a program in it (PixelFunctionCode); {ALLOW}"));
    }
    // Metadata are for people; elements within elements are looked at one by one.
    if is(&WORDS) || is(&["MDI"]) {
        return Ok(());
    }
    let values = node.attributes().map(|a| a.value()).filter(|v| *v != text);
    for value in values.chain([text]) {
        if looks_like_a_name(value) {
            return Err(format!("names {value} in <{name}>, which cannot be checked; {ALLOW}"));
        }
    }
    Ok(())
}

fn looks_like_a_name(text: &str) -> bool {
    let text = text.trim();
    let is_number = |c: char| c.is_ascii_digit() || " +-.,:eE\n\t".contains(c);
    !text.chars().all(is_number)
        && (text.starts_with(['/', '<'])
            || ["/vsi", "://", "../", ".."].iter().any(|sign| text.contains(sign))
            || Path::new(text).exists())
}

/// A source, named absolutely, or against the folder of its VRT (or, if `folder` is none, of the process).
fn check_source(text: &str, folder: Option<&Path>, root: &Path, depth: usize) -> Result<(), String> {
    let path = folder.map_or_else(|| PathBuf::from(text), |folder| folder.join(text));
    let beyond = || format!("has the source {text}, which is not under {}; {ALLOW}", root.display());
    if text.starts_with('<') || text.starts_with("/vsi") {
        return Err(beyond());
    }
    let Ok(real) = path.canonicalize() else {
        // A subdataset, an address, or nothing that is there.
        let what = if text.contains(':') { ", which is no file under" } else { ", which does not exist under" };
        return Err(format!("has the source {text}{what} {}; {ALLOW}", root.display()));
    };
    if !real.starts_with(root) {
        return Err(beyond());
    }
    if !real.is_file() {
        return Err(format!("has the source {text}, which is no file; {ALLOW}"));
    }
    let is_vrt = |p: &Path| p.extension().is_some_and(|e| e.eq_ignore_ascii_case("vrt"));
    match leads_elsewhere(&real) {
        Some(what) if !what.starts_with("a VRT") || !is_vrt(&path) => {
            Err(format!("has the source {text}, which is {what}, though its name does not say so; {ALLOW}"))
        }
        Some(_) => check_file(&path, root, depth + 1),
        None => check_neighbours(&path).map_err(|reason| format!("has the source {text}, which {reason}")),
    }
}

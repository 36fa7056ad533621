//! Checks the sources of a VRT before GDAL opens it: they have to lie under the folder of the named
//! VRT.
//!
//! GDAL opens sources by content, with all its drivers, and a VRT may name any file, archive or
//! address in many of its elements. So its XML is read here: names of sources are followed (a
//! source that is a VRT too), everything else that looks like a name is refused.

use super::access::{check_neighbors, leads_elsewhere};
use quick_xml::escape::unescape;
use quick_xml::events::{BytesRef, BytesStart, Event};
use quick_xml::reader::Reader;
use std::fs;
use std::path::{Path, PathBuf};

/// Upper bound of the size of a VRT, which has a few hundred bytes for each source.
const MAX_BYTES: u64 = 16 << 20;
/// Upper bound of the length of a tag, because finding duplicate attributes takes quadratic time.
const MAX_TAG_BYTES: usize = 8 << 10;
/// Maximum depth of nested elements.
const MAX_NESTED: usize = 256;
/// Maximum depth of nested VRTs.
const MAX_DEPTH: usize = 8;
/// How the user can allow it.
const ALLOW: &str = "--trust-vrt allows it";
/// Elements that name a dataset.
const NAMES: [&str; 2] = ["SourceFilename", "SourceDataset"];
/// Elements whose text is for display or describes a CRS.
const WORDS: [&str; 8] =
    ["SRS", "SourceSRS", "TargetSRS", "Description", "UnitType", "Category", "ColorInterp", "PixelFunctionType"];
/// Domains of metadata that name datasets.
const NAMING_DOMAINS: [&str; 3] = ["OVERVIEWS", "ProxyOverviewRequest", "GEOLOCATION"];

/// Checks the VRT at `path`, which exists. The message continues the sentence that begins with its
/// name.
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
    let folder = folder_of(path).map_err(|e| unreadable(&e))?;
    let mut reader = Reader::from_str(text.trim_start_matches('\u{feff}'));
    let mut open: Vec<Element> = Vec::new();
    loop {
        match reader.read_event().map_err(|e| unreadable(&e))? {
            Event::Start(tag) => {
                // An element with children has no text of its own.
                open.last_mut().into_iter().for_each(|parent| parent.is_split = true);
                open.push(Element::of(&tag)?);
                if open.len() > MAX_NESTED {
                    return Err(format!("has elements nested more than {MAX_NESTED} deep; {ALLOW}"));
                }
            }
            Event::Empty(tag) => {
                open.last_mut().into_iter().for_each(|parent| parent.is_split = true);
                check_element(&Element::of(&tag)?, &folder, root, depth)?;
            }
            Event::End(_) => {
                let Some(element) = open.pop() else { return Err(unreadable(&"an end without a beginning")) };
                check_element(&element, &folder, root, depth)?;
            }
            Event::Text(part) => {
                let part = part.decode().map_err(|e| unreadable(&e))?;
                open.last_mut().into_iter().for_each(|element| element.text.push_str(&part));
            }
            Event::GeneralRef(name) => {
                let c = referred(&name).ok_or_else(|| unreadable(&"a reference to an unknown entity"))?;
                open.last_mut().into_iter().for_each(|element| element.text.push(c));
            }
            Event::CData(part) => {
                let part = part.decode().map_err(|e| unreadable(&e))?;
                if let Some(element) = open.last_mut() {
                    element.is_split = true;
                    element.text.push_str(&part);
                }
            }
            Event::Comment(_) | Event::PI(_) => {
                open.last_mut().into_iter().for_each(|element| element.is_split = true);
            }
            Event::Decl(_) => {}
            // It could have content that the text does not show.
            Event::DocType(_) => return Err(unreadable(&"it has a document type")),
            Event::Eof if open.is_empty() => return Ok(()),
            Event::Eof => return Err(unreadable(&"it is cut short")),
        }
    }
}

/// An element with its own text, without that of its children.
struct Element {
    /// Without prefix.
    name: String,
    /// Without prefixes.
    attributes: Vec<(String, String)>,
    text: String,
    /// Whether its text is interrupted by other nodes: parsers differ in how they handle this.
    is_split: bool,
}

impl Element {
    fn of(tag: &BytesStart<'_>) -> Result<Self, String> {
        let unreadable = |reason: String| format!("has a list of files that cannot be read ({reason}); {ALLOW}");
        if tag.len() > MAX_TAG_BYTES {
            return Err(unreadable("a tag of a length that none has".to_owned()));
        }
        let text_of = |bytes: &[u8]| String::from_utf8(bytes.to_owned()).map_err(|e| unreadable(e.to_string()));
        let mut attributes = Vec::new();
        for attribute in tag.attributes() {
            let attribute = attribute.map_err(|e| unreadable(e.to_string()))?;
            let value = text_of(&attribute.value)?;
            if value.contains('<') {
                return Err(unreadable("< within an attribute".to_owned()));
            }
            let value = unescape(&value).map_err(|e| unreadable(e.to_string()))?.into_owned();
            attributes.push((text_of(attribute.key.local_name().as_ref())?, value));
        }
        let name = text_of(tag.local_name().as_ref())?;
        Ok(Self { name, attributes, text: String::new(), is_split: false })
    }
}

/// The character of a reference: a number, or one of the five predefined entities of XML.
fn referred(name: &BytesRef<'_>) -> Option<char> {
    if let Some(c) = name.resolve_char_ref().ok()? {
        return Some(c);
    }
    let names = [("amp", '&'), ("lt", '<'), ("gt", '>'), ("quot", '"'), ("apos", '\'')];
    let name = name.decode().ok()?;
    names.into_iter().find(|(known, _)| *known == name).map(|(_, c)| c)
}

fn check_element(element: &Element, folder: &Path, root: &Path, depth: usize) -> Result<(), String> {
    let name = &element.name;
    let is = |list: &[&str]| list.iter().any(|n| n.eq_ignore_ascii_case(name));
    let text = element.text.trim();
    if is(&NAMES) {
        if element.is_split {
            return Err(format!("has a source whose name, {text}, is cut by a comment or another element; {ALLOW}"));
        }
        let relative = element.attributes.iter().find(|(name, _)| name.eq_ignore_ascii_case("relativeToVRT"));
        let is_relative = relative.is_some_and(|(_, value)| value.trim().starts_with('1'));
        return check_source(text, is_relative.then_some(folder), root, depth);
    }
    let is_naming = |(name, value): &(String, String)| name == "domain" && NAMING_DOMAINS.contains(&value.as_str());
    if is(&["Metadata"]) && element.attributes.iter().any(is_naming) {
        return Err(format!("has metadata that name other files; {ALLOW}"));
    }
    if is(&["PixelFunctionCode"]) {
        return Err(format!("has a program in it (PixelFunctionCode); {ALLOW}"));
    }
    // Metadata are for display; nested elements are checked one by one.
    if is(&WORDS) || is(&["MDI"]) {
        return Ok(());
    }
    let values = element.attributes.iter().map(|(_, value)| value.as_str()).filter(|v| *v != text);
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

/// A source, named absolutely, or against the folder of its VRT (or, without a `folder`, of the
/// process).
fn check_source(text: &str, folder: Option<&Path>, root: &Path, depth: usize) -> Result<(), String> {
    let path = folder.map_or_else(|| PathBuf::from(text), |folder| folder.join(text));
    let beyond = || format!("has the source {text}, which is not under {}; {ALLOW}", root.display());
    if text.starts_with('<') || text.starts_with("/vsi") {
        return Err(beyond());
    }
    let Ok(real) = path.canonicalize() else {
        // A subdataset, an address, or a missing file.
        let what = if text.contains(':') { ", which is not a file under" } else { ", which does not exist under" };
        return Err(format!("has the source {text}{what} {}; {ALLOW}", root.display()));
    };
    if !real.starts_with(root) {
        return Err(beyond());
    }
    if !real.is_file() {
        return Err(format!("has the source {text}, which is not a file; {ALLOW}"));
    }
    let is_vrt = |p: &Path| p.extension().is_some_and(|e| e.eq_ignore_ascii_case("vrt"));
    match leads_elsewhere(&real) {
        Some(what) if !what.starts_with("a VRT") || !is_vrt(&path) => {
            Err(format!("has the source {text}, which is {what}, though its name does not say so; {ALLOW}"))
        }
        Some(_) => check_file(&path, root, depth + 1),
        None => check_neighbors(&path).map_err(|reason| format!("has the source {text}, which {reason}")),
    }
}

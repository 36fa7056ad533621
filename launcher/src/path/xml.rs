//! XML as programs write it, as a tree of elements.
//!
//! Prefixes are not looked at, declared or not, as Google Earth does. A document type is passed
//! over; one that declares entities is refused, as these could read files or grow without bound.
//! The work grows with the length of the text alone: lines are counted on the way, attributes other
//! than those of a point or an option are not looked at, and what no path needs is not kept.

use super::{PathError, printable};
use quick_xml::errors::{Error, IllFormedError, SyntaxError};
use quick_xml::escape::unescape;
use quick_xml::events::{BytesRef, BytesStart, Event};
use quick_xml::reader::Reader;
use std::path::Path;

/// Most elements that are kept.
const MAX_ELEMENTS: usize = 4_000_000;
/// Most elements within each other: no program nests folders so deep.
const MAX_DEPTH: usize = 1000;
/// The attributes that are kept: all that a path needs.
const ATTRIBUTES: [&str; 4] = ["lat", "lon", "name", "enabled"];
/// Elements that no path needs with all that is in them. Views in an update are changes of a
/// feature, none of their own.
const PASSED_OVER: [&str; 8] =
    ["extensions", "ExtendedData", "Style", "StyleMap", "Schema", "description", "Update", "metadata"];

#[derive(Debug)]
struct Element<'t> {
    /// Without prefix.
    name: &'t str,
    line: u32,
    /// Of its attributes in the document's list.
    attributes: [u32; 2],
    /// Of its text in the document's texts: what stands before its first child.
    text: [u32; 2],
    /// The element after all that is in it.
    end: u32,
}

/// A document: elements in the order in which they begin.
#[derive(Debug)]
pub(super) struct Document<'t> {
    elements: Vec<Element<'t>>,
    /// Name (its place in [`ATTRIBUTES`]) and value (its range in `texts`).
    attributes: Vec<(usize, [u32; 2])>,
    texts: String,
}

/// An element of a document.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node<'d> {
    document: &'d Document<'d>,
    index: usize,
}

impl<'t> Document<'t> {
    /// Reads a text whose root is one of `roots`; `path` is for messages.
    pub(super) fn parse(path: &Path, text: &'t str, roots: &[&str]) -> Result<Self, PathError> {
        let mut reader = Reader::from_str(text);
        // A lone & in a name is common; what it stands for is not looked at.
        reader.config_mut().allow_dangling_amp = true;
        let document = Self { elements: Vec::new(), attributes: Vec::new(), texts: String::new() };
        let mut builder = Builder { path, text, roots, document, open: Vec::new(), passed: 0, counted: 0, line: 1 };
        loop {
            let event = reader.read_event();
            let end = usize::try_from(reader.buffer_position()).unwrap_or(usize::MAX);
            match event {
                Ok(Event::Start(tag)) => builder.open(&tag, end.saturating_sub(tag.len() + 2))?,
                Ok(Event::Empty(tag)) => {
                    builder.open(&tag, end.saturating_sub(tag.len() + 3))?;
                    builder.close();
                }
                Ok(Event::End(_)) => builder.close(),
                Ok(Event::Text(part)) => builder.add(part.decode().as_deref().unwrap_or_default()),
                Ok(Event::CData(part)) => builder.add(part.decode().as_deref().unwrap_or_default()),
                Ok(Event::GeneralRef(name)) => builder.add_reference(&name),
                Ok(Event::DocType(content)) => builder.check_document_type(&content, end)?,
                Ok(Event::Comment(_) | Event::Decl(_) | Event::PI(_)) => {}
                Ok(Event::Eof) => return builder.finish(),
                Err(error) => {
                    let at = usize::try_from(reader.error_position()).unwrap_or(usize::MAX);
                    return Err(builder.malformed(at, words(&error)));
                }
            }
        }
    }

    /// The root.
    pub(super) fn root(&self) -> Node<'_> {
        Node { document: self, index: 0 }
    }
}

/// What is wrong, for people. The names in it come from outside.
fn words(error: &Error) -> String {
    let cut_short = |within: &str| format!("the file ends within {within}: it is cut short");
    match error {
        Error::IllFormed(IllFormedError::MismatchedEndTag { expected, found }) => {
            format!("expected </{}>, found </{}>", printable(expected), printable(found))
        }
        Error::IllFormed(IllFormedError::UnmatchedEndTag(found)) => {
            format!("</{}> ends what has not begun", printable(found))
        }
        Error::Syntax(SyntaxError::UnclosedComment) => cut_short("a comment"),
        Error::Syntax(SyntaxError::UnclosedCData) => cut_short("a CDATA section"),
        Error::Syntax(SyntaxError::InvalidBangMarkup) => "expected a comment, CDATA or DOCTYPE after <!".into(),
        Error::Syntax(_) => cut_short("a tag"),
        other => printable(&other.to_string()),
    }
}

/// A document in the making.
struct Builder<'a, 't> {
    path: &'a Path,
    text: &'t str,
    roots: &'a [&'a str],
    document: Document<'t>,
    /// Elements that have not ended.
    open: Vec<usize>,
    /// How many elements that are passed over have not ended.
    passed: usize,
    /// Lines are counted up to here.
    counted: usize,
    line: u32,
}

impl<'t> Builder<'_, 't> {
    /// The line of a place that is not before the one asked for last.
    fn line_at(&mut self, at: usize) -> u32 {
        if let Some(between) = self.text.as_bytes().get(self.counted..at.min(self.text.len())) {
            self.line += between.iter().filter(|&&byte| byte == b'\n').count() as u32;
            self.counted += between.len();
        }
        self.line
    }

    fn malformed(&mut self, at: usize, reason: String) -> PathError {
        PathError::Xml { path: self.path.to_owned(), line: self.line_at(at), reason }
    }

    fn open(&mut self, tag: &BytesStart<'_>, at: usize) -> Result<(), PathError> {
        if self.open.len() + self.passed >= MAX_DEPTH {
            return Err(self.malformed(at, format!("elements are nested more than {MAX_DEPTH} deep")));
        }
        if self.passed > 0 {
            self.passed += 1;
            return Ok(());
        }
        let name = self.text.get(at + 1..at + 1 + tag.name().as_ref().len()).unwrap_or_default();
        let name = name.rsplit(':').next().unwrap_or(name);
        let parent = self.open.last().map(|&parent| self.document.elements[parent].name);
        if parent.is_none() && !self.document.elements.is_empty() {
            let reason = "a second document begins here: several files were pasted together; fly them one by one";
            return Err(self.malformed(at, reason.into()));
        }
        if parent.is_none() && !self.roots.contains(&name) {
            return Err(PathError::UnknownFormat { path: self.path.to_owned(), found: what_is(name) });
        }
        // A planner's route has its way between the points that were set in their extensions
        // (Garmin's rpt).
        if PASSED_OVER.contains(&name) && !(name == "extensions" && parent == Some("rtept")) {
            self.passed = 1;
            return Ok(());
        }
        if self.document.elements.len() >= MAX_ELEMENTS {
            return Err(self.malformed(at, format!("more than {MAX_ELEMENTS} elements: cut it into several paths")));
        }
        let line = self.line_at(at);
        let first_attribute = self.document.attributes.len() as u32;
        for attribute in tag.attributes().with_checks(false).flatten() {
            let local = attribute.key.local_name();
            if let Some(known) = ATTRIBUTES.iter().position(|known| known.as_bytes() == local.as_ref()) {
                let from = self.document.texts.len() as u32;
                let value = std::str::from_utf8(&attribute.value).unwrap_or_default();
                self.document.texts.push_str(&unescape(value).unwrap_or_default());
                self.document.attributes.push((known, [from, self.document.texts.len() as u32]));
            }
        }
        let index = self.document.elements.len();
        self.open.push(index);
        self.document.elements.push(Element {
            name,
            line,
            attributes: [first_attribute, self.document.attributes.len() as u32],
            text: [self.document.texts.len() as u32; 2],
            end: 0,
        });
        Ok(())
    }

    fn close(&mut self) {
        if self.passed > 0 {
            self.passed -= 1;
        } else if let Some(index) = self.open.pop() {
            self.document.elements[index].end = self.document.elements.len() as u32;
        }
    }

    /// A piece of text; kept when it stands before the first child of its element.
    fn add(&mut self, text: &str) {
        let last = self.document.elements.len().wrapping_sub(1);
        if self.passed > 0 || self.open.last() != Some(&last) {
            return;
        }
        let element = &mut self.document.elements[last];
        let is_first = element.text[0] == element.text[1];
        self.document.texts.push_str(if is_first { text.trim_start() } else { text });
        element.text[1] = self.document.texts.len() as u32;
    }

    fn add_reference(&mut self, name: &BytesRef<'_>) {
        let mut buffer = [0; 4];
        match (name.resolve_char_ref(), name.decode().as_deref()) {
            (Ok(Some(c)), _) => self.add(c.encode_utf8(&mut buffer)),
            (_, Ok("amp")) => self.add("&"),
            (_, Ok("lt")) => self.add("<"),
            (_, Ok("gt")) => self.add(">"),
            (_, Ok("quot")) => self.add("\""),
            (_, Ok("apos")) => self.add("'"),
            // An unknown entity stays as it is written; a number with it is not read.
            (_, other) => self.add(&format!("&{};", printable(other.unwrap_or_default()))),
        }
    }

    fn check_document_type(&mut self, content: &[u8], at: usize) -> Result<(), PathError> {
        if content.windows(8).any(|word| word.eq_ignore_ascii_case(b"<!ENTITY")) {
            let reason = "its <!DOCTYPE> declares entities, which could read files or grow without bound: remove it";
            return Err(self.malformed(at, reason.into()));
        }
        Ok(())
    }

    fn finish(mut self) -> Result<Document<'t>, PathError> {
        if let Some(&index) = self.open.last() {
            let (name, line) = (printable(self.document.elements[index].name), self.document.elements[index].line);
            let reason = format!("the file ends within <{name}>, which begins in line {line}: it is cut short");
            return Err(self.malformed(usize::MAX, reason));
        }
        if self.passed > 0 {
            return Err(self.malformed(usize::MAX, "the file ends within an element: it is cut short".into()));
        }
        if self.document.elements.is_empty() {
            return Err(self.malformed(usize::MAX, "there is no element in it".into()));
        }
        Ok(self.document)
    }
}

/// XML that is not a path, and what to do.
fn what_is(root: &str) -> String {
    let root = printable(root);
    match root.as_str() {
        "TrainingCenterDatabase" => {
            "a Garmin TCX file; gpsbabel -i gtrnctr -f FILE -o gpx -F FILE.gpx makes a GPX of it".into()
        }
        "html" | "HTML" => "a web page; download the file itself".into(),
        _ => format!("XML of the kind <{root}>"),
    }
}

impl<'d> Node<'d> {
    fn element(self) -> &'d Element<'d> {
        &self.document.elements[self.index]
    }

    /// Its name without prefix.
    pub(super) fn name(self) -> &'d str {
        self.element().name
    }

    /// The line in which it begins, from 1.
    pub(super) fn line(self) -> u32 {
        self.element().line
    }

    /// The text before its first child, without space around it.
    pub(super) fn text(self) -> &'d str {
        self.range(self.element().text).trim()
    }

    /// An attribute that is kept.
    pub(super) fn attribute(self, name: &str) -> Option<&'d str> {
        let [from, to] = self.element().attributes;
        let own = self.document.attributes.get(from as usize..to as usize)?;
        own.iter().find(|(known, _)| ATTRIBUTES[*known] == name).map(|(_, range)| self.range(*range).trim())
    }

    fn range(self, [from, to]: [u32; 2]) -> &'d str {
        self.document.texts.get(from as usize..to as usize).unwrap_or_default()
    }

    /// Its children.
    pub(super) fn children(self) -> impl Iterator<Item = Node<'d>> {
        let mut next = self.index + 1;
        std::iter::from_fn(move || {
            let child = Node { document: self.document, index: next };
            (next < self.element().end as usize).then(|| {
                next = child.element().end as usize;
                child
            })
        })
    }

    /// Its first child of that name.
    pub(super) fn child(self, name: &str) -> Option<Node<'d>> {
        self.children().find(|child| child.name() == name)
    }

    /// All that is in it, in the order of the file; also itself.
    pub(super) fn with_descendants(self) -> impl Iterator<Item = Node<'d>> {
        (self.index..self.element().end as usize).map(move |index| Node { document: self.document, index })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parse(text: &str) -> Result<Document<'_>, PathError> {
        Document::parse(Path::new("p"), text, &["a", "gpx"])
    }

    #[test]
    fn a_tree_has_names_texts_attributes_and_lines() {
        let text = "\n<!-- x --><?xml version='1.0'?>\n<x:a xmlns='u' q:r='1'>\n <b lat=' 1&#46;5 ' m='n' lon=\"2\"/><c>t&amp;<![CDATA[<u>]]>&nope;<!-- v --> w<d>1</d>2</c>\n\
             <description><b>no</b></description><e>R & D</e>\n</x:a>\u{0}";
        let document = parse(text).unwrap();
        let root = document.root();
        let names: Vec<_> = root.with_descendants().map(|node| (node.name(), node.line(), node.text())).collect();
        let expected = [("a", 3, ""), ("b", 4, ""), ("c", 4, "t&<u>&nope; w"), ("d", 4, "1"), ("e", 5, "R & D")];
        assert_eq!(names, expected);
        assert_eq!(root.children().map(Node::name).collect::<Vec<_>>(), ["b", "c", "e"]);
        let b = root.child("b").unwrap();
        assert_eq!((b.attribute("lat"), b.attribute("lon"), b.attribute("m")), (Some("1.5"), Some("2"), None));
    }

    #[test]
    fn what_is_malformed_is_told_with_its_line() {
        let deep = "<a>".repeat(2000);
        let pasted = "<a/>\n<a/>".to_owned();
        for (text, expected) in [
            ("<a>\n<b>\n</a>", "line 3: expected </b>, found </a>"),
            ("<a>\n<b>x", "line 2: the file ends within <b>, which begins in line 2: it is cut short"),
            ("<a>\n<b lat=\"1", "line 2: the file ends within a tag"),
            ("<a><description>", "cut short"),
            ("</a>", "</a> ends what has not begun"),
            ("<!-- x", "within a comment"),
            ("<a/>\n<a/>", "line 2: a second document"),
            (pasted.as_str(), "pasted together"),
            ("<!DOCTYPE a [<!ENTITY x SYSTEM \"file:///etc/passwd\">]><a>&x;</a>", "declares entities"),
            ("<html><p></html>", "a web page"),
            ("<TrainingCenterDatabase>", "gpsbabel"),
            ("<\u{1b}[31m/>", "kind <\\u{1b}[31m>"),
            ("<?xml?>", "no element"),
            (deep.as_str(), "more than 1000 deep"),
        ] {
            let message = parse(text).unwrap_err().to_string();
            assert!(message.contains(expected) && !message.contains(['\n', '\u{1b}']), "{text:.60}\n  {message}");
        }
        // A document type alone does nothing.
        assert!(parse("<!DOCTYPE a SYSTEM \"http://x/y.dtd\"><a/>").is_ok());
    }

    #[test]
    fn many_attributes_and_namespaces_cost_what_they_are_long() {
        let attributes: String = (0..50_000).map(|i| format!(" xmlns:n{i}='u' a{i}='b'")).collect();
        let nested = format!("<a{attributes}>{}{}</a>", "<n:b xmlns:n='v'>".repeat(900), "</n:b>".repeat(900));
        let document = parse(&nested).unwrap();
        assert_eq!((document.elements.len(), document.attributes.len(), document.texts.len()), (901, 0, 0));
    }

    #[test]
    fn what_is_kept_has_a_bound() {
        let text = format!("<a>{}</a>", "<b/>".repeat(MAX_ELEMENTS));
        assert!(parse(&text).unwrap_err().to_string().contains("more than 4000000 elements"));
        let passed = format!("<a>{}</a>", "<extensions><b/></extensions>".repeat(1000));
        assert_eq!(parse(&passed).unwrap().elements.len(), 1);
    }

    proptest! {
        #[test]
        fn any_text_gives_no_more_than_it_has(text in "(<a>)?([<>/!?a&;='\"\\[\\]-]|<!--|-->|<!\\[CDATA\\[|\\]\\]>|<a|lat=|\\PC|\n){0,40}") {
            if let Ok(document) = parse(&text) {
                prop_assert!(document.texts.len() <= 12 * text.len() + 12);
                prop_assert!(document.elements.len() <= text.len());
                for node in document.root().with_descendants() {
                    prop_assert!(node.children().count() < document.elements.len());
                    prop_assert!(node.line() as usize <= 1 + text.matches('\n').count());
                }
            }
        }
    }
}

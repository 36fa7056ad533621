//! The objects of a document: packets of one `id` are one object. Which of them is flown, and what
//! is said about the rest.

use super::super::geojson::list;
use super::super::{PathError, printable};
use super::{Extent, ORIENTATION, POSITION, fields, number, raw_json, samples::extent};
use serde_json::value::RawValue;
use std::collections::HashMap;
use std::path::Path;

/// What an object is drawn as, and its name in messages.
const DRAWN: [(&str, &str); 6] = [
    ("model", "model"),
    ("label", "label"),
    ("path", "trail"),
    ("billboard", "picture"),
    ("point", "point"),
    ("viewFrom", "place to watch it from (viewFrom)"),
];

/// An object, as it is written.
#[derive(Default)]
pub(super) struct Object<'a> {
    id: Option<String>,
    /// Number of its first packet, from 0.
    packet: usize,
    pub(super) positions: Vec<&'a RawValue>,
    pub(super) orientations: Vec<&'a RawValue>,
    pub(super) availability: Option<&'a RawValue>,
    /// How many values its position has.
    extent: Option<Extent>,
    is_inertial: bool,
    /// What of [`DRAWN`] it has, the last of each.
    drawn: [Option<&'a RawValue>; DRAWN.len()],
}

/// All objects that have a position, and what else is of interest.
pub(super) struct Objects<'a> {
    objects: Vec<Object<'a>>,
    /// How many times as fast the clock of the document runs.
    multiplier: Option<f64>,
    /// Packets without a position, but for that of the document.
    others: usize,
}

impl<'a> Object<'a> {
    /// What it is drawn as, by the name of CZML.
    pub(super) fn drawn_as(&self, name: &str) -> Option<&'a RawValue> {
        DRAWN.iter().position(|(key, _)| *key == name).and_then(|at| self.drawn[at])
    }

    /// Whether it has a place in a frame that turns with the ground.
    pub(super) fn is_placed(&self) -> bool {
        self.extent() != Extent::None && !self.is_inertial
    }

    /// The object, for messages.
    pub(super) fn place(&self) -> String {
        match &self.id {
            Some(id) => format!("packet \"{}\"", printable(id)),
            None => format!("packet {}", self.packet),
        }
    }

    fn extent(&self) -> Extent {
        self.extent.unwrap_or(Extent::None)
    }
}

impl<'a> Objects<'a> {
    /// # Errors
    /// [`PathError`] when it is not a list of objects.
    pub(super) fn read(path: &Path, text: &'a str) -> Result<Self, PathError> {
        let mut found = Objects { objects: Vec::new(), multiplier: None, others: 0 };
        let mut of_id: HashMap<String, usize> = HashMap::new();
        let each = |i: usize, raw: &'a RawValue| found.packet(path, i, raw, &mut of_id);
        raw_json::each(text, each).map_err(|source| PathError::Json { path: path.to_owned(), source })??;
        Ok(found)
    }

    fn packet(
        &mut self,
        path: &Path,
        i: usize,
        raw: &'a RawValue,
        of_id: &mut HashMap<String, usize>,
    ) -> Result<(), PathError> {
        const KEYS: [&str; 6] = ["id", "delete", "position", "orientation", "availability", "clock"];
        let Ok([id, delete, position, orientation, availability, clock]) = fields(raw.get(), &KEYS) else {
            return Err(PathError::BadValue {
                path: path.to_owned(),
                place: format!("packet {i}"),
                key: "the entry".into(),
                expected: "a packet of CZML, an object",
                found: printable(raw.get()),
            });
        };
        if delete.is_some_and(|delete| delete.get() == "true") {
            return Ok(());
        }
        let id = id.and_then(raw_json::text);
        if id.as_deref() == Some("document") {
            let multiplier = clock.and_then(|clock| fields(clock.get(), &["multiplier"]).ok()?[0]);
            self.multiplier = multiplier.and_then(number).filter(|factor| (1e-3..=1e4).contains(factor));
            return Ok(());
        }
        let known = id.as_ref().and_then(|id| of_id.get(id)).copied();
        if known.is_none() && position.is_none() && orientation.is_none() {
            self.others += 1;
            return Ok(());
        }
        let at = known.unwrap_or_else(|| {
            self.objects.push(Object { id: id.clone(), packet: i, ..Object::default() });
            self.objects.len() - 1
        });
        if let Some(id) = id {
            of_id.insert(id, at);
        }
        let object = &mut self.objects[at];
        if let Some(position) = position {
            object.is_inertial |= is_inertial(position);
            let known = object.extent();
            let found = extent(position, &POSITION);
            // Two packets of one position are two samples of it, or two intervals.
            let both = if known == Extent::Constant { Extent::Varying } else { known };
            object.extent = Some(if found == Extent::None { known } else { both.max(found) });
            object.positions.push(position);
        }
        object.orientations.extend(orientation);
        object.availability = availability.or(object.availability);
        let drawn = fields(raw.get(), &DRAWN.map(|(key, _)| key)).unwrap_or_default();
        object.drawn.iter_mut().zip(drawn).for_each(|(has, found)| *has = found.or(*has));
        Ok(())
    }

    /// All that have a position or an orientation, in the order of the file.
    pub(super) fn all(&self) -> &[Object<'a>] {
        &self.objects
    }

    /// The object that is flown: the first that moves against the ground, else one that looks.
    ///
    /// # Errors
    /// [`PathError::Empty`] when no object can be flown.
    pub(super) fn flown(&self, path: &Path) -> Result<&Object<'a>, PathError> {
        let looks =
            |object: &Object<'_>| object.orientations.iter().any(|raw| extent(raw, &ORIENTATION) != Extent::None);
        let first = |is_wanted: &dyn Fn(&&Object<'a>) -> bool| self.objects.iter().find(is_wanted);
        let moves = |object: &Object<'_>| object.extent() == Extent::Varying;
        first(&|object| moves(object) && !object.is_inertial)
            .or_else(|| first(&|object| object.extent() == Extent::Constant && !object.is_inertial && looks(object)))
            .or_else(|| first(&|object| moves(object)))
            .ok_or_else(|| {
                let still = self.objects.iter().filter(|object| object.extent() == Extent::Constant).count();
                let rest = self.objects.len() - still + self.others;
                let found = list(&[
                    (still, ["packet that stands still", "packets that stand still"]),
                    (rest, ["packet without a position of numbers", "packets without a position of numbers"]),
                ]);
                PathError::Empty {
                    path: path.to_owned(),
                    expected: "CZML with a packet whose position has samples with times, or that has a position and an \
                               orientation (a camera path of poses is an object with \"frames\" or \"keyframes\")",
                    found: found.unwrap_or("no packets but the document's".into()),
                }
            })
    }

    /// What a document has beside what is flown of it.
    pub(super) fn note(&self, flown: &Object<'a>, notes: &mut Vec<String>) {
        let has_place = |object: &&Object<'a>| object.extent() != Extent::None && object.packet != flown.packet;
        let others = self.objects.iter().filter(has_place);
        let (moving, still): (Vec<_>, Vec<_>) = others.partition(|object| object.extent() == Extent::Varying);
        let others = list(&[
            (moving.len(), ["packet that moves", "packets that move"]),
            (still.len(), ["packet that stands still", "packets that stand still"]),
        ]);
        notes.extend(others.map(|others| format!("beside {} the file has {others}, not flown", flown.place())));
        let drawn: Vec<&str> =
            DRAWN.iter().zip(flown.drawn).filter(|(_, has)| has.is_some()).map(|((_, name), _)| *name).collect();
        if let Some((last, before)) = drawn.split_last() {
            let names = if before.is_empty() { (*last).into() } else { format!("{} and {last}", before.join(", ")) };
            notes.push(format!("of {} the way is flown, without its {names}", flown.place()));
        }
        let refers = flown
            .orientations
            .iter()
            .any(|raw| fields(raw.get(), &["reference"]).is_ok_and(|[reference]| reference.is_some()));
        if refers {
            notes.push(format!(
                "the orientation of {} is a reference, which is not followed: the camera looks ahead along the way",
                flown.place()
            ));
        }
        if let Some(factor) = self.multiplier.filter(|factor| *factor != 1.0) {
            notes.push(format!(
                "the clock of the document runs {factor} times as fast; here --speed {factor} does that"
            ));
        }
    }
}

/// Whether a position is given in a frame that does not turn with the Earth.
pub(super) fn is_inertial(position: &RawValue) -> bool {
    let of = |piece: &RawValue| {
        let frame = fields(piece.get(), &["referenceFrame"]).ok().and_then(|found| found[0]);
        frame.and_then(raw_json::text).is_some_and(|frame| frame == "INERTIAL")
    };
    if !raw_json::is_list(position) {
        return of(position);
    }
    let each = |_, piece: &RawValue| if of(piece) { Err(()) } else { Ok(()) };
    matches!(raw_json::each(position.get(), each), Ok(Err(())))
}

//! What a file has that is not flown, a sentence each: nobody shall look for it in the film.

use super::super::times::seconds_from_iso8601;
use super::super::xml::Node;
use super::super::{Remarks, printable};
use super::{is_view, tour};

/// What of a file is flown.
#[derive(Clone, Copy)]
pub(super) enum Flown<'d> {
    Tour(Node<'d>),
    Tracks,
    Lines,
    Views,
}

/// Says what is left out of a file of which `flown` is flown.
pub(super) fn note(root: Node<'_>, flown: Flown<'_>, remarks: &mut Remarks) {
    remarks.notes.extend(match flown {
        Flown::Tour(tour) => steps(tour),
        Flown::Tracks => angles(root),
        Flown::Lines | Flown::Views => None,
    });
    remarks.notes.extend(beside(root, flown));
    remarks.notes.extend(match flown {
        Flown::Tour(tour) => sunlight(tour),
        Flown::Views => sunlight(root),
        Flown::Tracks | Flown::Lines => None,
    });
}

/// Steps of a tour that show nothing of the terrain.
fn steps(tour: Node<'_>) -> Option<String> {
    let count = |name: &str| tour::steps(tour).filter(|step| step.name() == name).count();
    let left_out = list(&[
        (count("SoundCue"), "sound"),
        (count("TourControl"), "pause"),
        (count("AnimatedUpdate"), "animated change"),
    ])?;
    Some(format!("of the tour only the camera's way is flown, without its {left_out}"))
}

/// Directions in a track.
fn angles(root: Node<'_>) -> Option<String> {
    let is_angle = |node: Node<'_>| node.name() == "angles" && !node.text().is_empty();
    root.with_descendants().any(is_angle).then(|| {
        "the directions in its track (gx:angles) are those of a model: the camera looks ahead along the way".into()
    })
}

/// What else there would be to fly, and links.
fn beside(root: Node<'_>, flown: Flown<'_>) -> Option<String> {
    let count = |name: &str| root.with_descendants().filter(|node| node.name() == name).count();
    let is_way = |node: Node<'_>| matches!(node.name(), "Track" | "LineString");
    let has_only_a_view = |place: Node<'_>| place.children().any(is_view) && !place.with_descendants().any(is_way);
    let places = || root.with_descendants().filter(|node| node.name() == "Placemark");
    let views = || places().filter(|place| has_only_a_view(*place)).count();
    let (tracks, lines) = ((count("Track"), "track"), (count("LineString"), "line"));
    let (kind, mut left_out) = match flown {
        Flown::Tour(_) => ("tour", vec![tracks, lines, (views(), "other view")]),
        Flown::Tracks => ("track", vec![lines, (views(), "other view")]),
        Flown::Lines => ("line", vec![(views(), "other view")]),
        Flown::Views => {
            let without = places().filter(|place| !place.children().any(is_view)).count();
            ("views", vec![(without, "other placemark")])
        }
    };
    left_out.push((count("NetworkLink"), "network link"));
    let left_out = list(&left_out)?;
    Some(format!("beside the {kind} the file has {left_out}, not flown"))
}

/// The sun that Google Earth shows, of the first view that has it.
fn sunlight(views: Node<'_>) -> Option<String> {
    let is_on = |option: &Node<'_>| {
        option.name() == "option"
            && option.attribute("name") == Some("sunlight")
            && !matches!(option.attribute("enabled"), Some("0" | "false"))
    };
    let view = views.with_descendants().find(|node| {
        is_view(*node) && node.child("ViewerOptions").is_some_and(|options| options.children().any(|node| is_on(&node)))
    })?;
    let time = view.child("TimeStamp").and_then(|stamp| stamp.child("when")).map_or("", |when| when.text());
    Some(match seconds_from_iso8601(time) {
        Some(_) => {
            let time = printable(time);
            format!("Google Earth shows its first view by the sun of {time}; here --sun {time} does")
        }
        None => "Google Earth shows its views by the sun; here --sun DATE-TIME does".into(),
    })
}

/// "2 sounds, 1 pause and 1 link", of what there is.
fn list(counted: &[(usize, &str)]) -> Option<String> {
    let said = |(count, what): &(usize, &str)| format!("{count} {what}{}", if *count == 1 { "" } else { "s" });
    let mut parts: Vec<String> = counted.iter().filter(|(count, _)| *count > 0).map(said).collect();
    let last = parts.pop()?;
    Some(if parts.is_empty() { last } else { format!("{} and {last}", parts.join(", ")) })
}

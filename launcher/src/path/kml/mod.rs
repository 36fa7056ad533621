//! KML (OGC KML 2.3, 12-007r2, and Google's `gx` extension, which it took over): what there is to
//! fly in a file, the first of these that it has: a tour ([`tour`]), tracks or lines ([`lines`]),
//! or placemarks with a view each.

mod lines;
mod tour;
mod unflown;
mod view;

use super::crs::Georeference;
use super::spline::{Key, Spline};
use super::xml::{Document, Node};
use super::{CameraPath, Course, CourseOptions, Ground, PathError, Remarks, shorten, track};
use std::path::Path;
use unflown::Flown;
use view::ViewReader;

/// Between two views that are flown one after the other without a tour, seconds.
const SECONDS_BETWEEN_VIEWS: f64 = 5.0;

/// Reads a KML file.
///
/// # Errors
/// [`PathError`] with the line in it.
pub(super) fn parse(
    path: &Path,
    document: &Document<'_>,
    world: &Georeference,
    ground: &dyn Ground,
    options: CourseOptions,
    remarks: &mut Remarks,
) -> Result<CameraPath, PathError> {
    let crs_error =
        |source| PathError::Crs { path: path.to_owned(), place: "the file".into(), source: Box::new(source) };
    let lonlat = world.from_lonlat().map_err(crs_error)?;
    let root = document.root();
    let mut reader = ViewReader::new(path, &lonlat, ground);

    let tours: Vec<Node<'_>> = root.with_descendants().filter(|node| node.name() == "Tour").collect();
    let mut flown = tours.iter().filter(|tour| tour::has_view(**tour));
    let course = if let Some(tour) = flown.next() {
        let others = flown.count();
        if others > 0 {
            remarks.notes.push(format!(
                "the file has {} tours: the first, in line {}, is flown",
                others + 1,
                tour.line()
            ));
        }
        unflown::note(root, Flown::Tour(*tour), remarks);
        tour::course(*tour, &mut reader)?
    } else {
        if let Some((flown, segments)) = lines::segments(path, root, &lonlat, ground, remarks)? {
            unflown::note(root, flown, remarks);
            return track::course(path, segments, ground, options, remarks);
        }
        let course = views(path, root, &mut reader, remarks)?;
        unflown::note(root, Flown::Views, remarks);
        course
    };
    if options.agl_m.is_some() {
        return Err(PathError::HasHeights { path: path.to_owned(), kind: "views of KML" });
    }
    let settings = reader.finish(remarks);
    Ok(CameraPath { settings, course })
}

fn is_view(node: Node<'_>) -> bool {
    matches!(node.name(), "Camera" | "LookAt")
}

/// From view to view of the placemarks, in the order of the file.
fn views(path: &Path, root: Node<'_>, reader: &mut ViewReader<'_>, remarks: &mut Remarks) -> Result<Course, PathError> {
    let of = |name: &'static str| {
        root.with_descendants()
            .filter(move |node| node.name() == name)
            .filter_map(move |node| node.children().find(|node| is_view(*node)))
    };
    let mut views: Vec<Node<'_>> = of("Placemark").collect();
    // Only where no placemark has one: the view of an overlay, or with which the file opens.
    for container in ["PhotoOverlay", "GroundOverlay", "ScreenOverlay", "Folder", "Document", "kml"] {
        if views.is_empty() {
            views = of(container).take(1).collect();
        }
    }
    let mut keys: Vec<Key> = Vec::with_capacity(views.len());
    for view in views {
        let pose = reader.pose(view)?;
        keys.push(Key { is_stop: true, ..Key::passing(keys.len() as f64 * SECONDS_BETWEEN_VIEWS, pose) });
    }
    let Some(spline) = Spline::new(&keys) else {
        return Err(PathError::Empty {
            path: path.to_owned(),
            expected: "a tour (gx:Tour) with views, a track (gx:Track), a line (LineString), or placemarks with a view \
                       (Camera or LookAt)",
            found: what_is_there(root),
        });
    };
    if keys.len() > 1 {
        remarks.notes.push(format!(
            "there is no tour in it: its {} views are flown one after the other, {SECONDS_BETWEEN_VIEWS} s from each to the next",
            keys.len()
        ));
    }
    Ok(Course::Timed(vec![spline]))
}

/// What a file has in place of something to fly, and what to do.
fn what_is_there(root: Node<'_>) -> String {
    let count = |name: &str| root.with_descendants().filter(|node| node.name() == name).count();
    let plural = |count: usize, what: &str| format!("{count} {what}{}", if count == 1 { "" } else { "s" });
    if count("Tour") > 0 {
        return "a tour without any view: record it again".into();
    }
    if count("NetworkLink") > 0 {
        return "links to other files alone (NetworkLink): open it in Google Earth, save the place that is meant as KMZ, and \
                fly that"
            .into();
    }
    match count("Placemark") {
        0 => "no placemarks either".into(),
        places => format!(
            "{} without: give each a view (in Google Earth: Properties, View, Snapshot current view), record a tour, or draw \
             a path",
            plural(places, "placemark")
        ),
    }
}

fn bad(path: &Path, node: Node<'_>, key: &str, expected: &'static str, found: &str) -> PathError {
    PathError::BadValue {
        path: path.to_owned(),
        place: format!("line {}", node.line()),
        key: key.into(),
        expected,
        found: if found.is_empty() { "nothing".into() } else { format!("{:?}", shorten(found)) },
    }
}

#[cfg(test)]
mod tests;

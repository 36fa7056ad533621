//! A straight way against one facet, both relative to the way's start.

use glam::DVec3;

/// How far beyond its edges a facet is met, as a share of its sides: rounding leaves no gap between
/// neighbours.
const EDGE: f64 = 1e-9;

/// Where a way meets a facet: the share of the way, 0 to 1 (Möller and Trumbore, Fast, Minimum
/// Storage Ray/Triangle Intersection, 1997).
pub(super) fn crossing([a, b, c]: [DVec3; 3], way: DVec3) -> Option<f64> {
    let (ab, ac) = (b - a, c - a);
    let p = way.cross(ac);
    let determinant = ab.dot(p);
    // Along the facet: its neighbours are met where the way enters or leaves the ground.
    if determinant == 0.0 {
        return None;
    }
    let u = -a.dot(p) / determinant;
    let q = (-a).cross(ab);
    let v = way.dot(q) / determinant;
    let share = ac.dot(q) / determinant;
    let is_within = u >= -EDGE && v >= -EDGE && u + v <= 1.0 + EDGE;
    (is_within && (0.0..=1.0).contains(&share)).then_some(share)
}

/// Where a sphere that begins at the origin touches a facet first: the share of its way, 0 to 1, and
/// the point of the facet.
pub(super) fn touch(facet: [DVec3; 3], way: DVec3, radius: f64) -> Option<(f64, DVec3)> {
    let nearest = nearest_to_origin(facet);
    if nearest.length_squared() <= radius * radius {
        return Some((0.0, nearest));
    }
    let [a, b, c] = facet;
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let (distance, speed) = (-normal.dot(a), normal.dot(way));
    // The face is met before its edges, if it is met.
    let side = distance.signum();
    let share = (side * radius - distance) / speed;
    if (0.0..=1.0).contains(&share) {
        let contact = way * share - normal * (side * radius);
        if is_over(facet, normal, contact) {
            return Some((share, contact));
        }
    }
    let sides = [(a, b), (b, c), (c, a)];
    let met =
        sides.into_iter().flat_map(|(from, to)| [touch_edge(from, to, way, radius), touch_point(from, way, radius)]);
    met.flatten().min_by(|a, b| a.0.total_cmp(&b.0))
}

/// Whether a point of a facet's plane is in the facet.
fn is_over([a, b, c]: [DVec3; 3], normal: DVec3, point: DVec3) -> bool {
    [(a, b), (b, c), (c, a)].into_iter().all(|(from, to)| normal.dot((to - from).cross(point - from)) >= 0.0)
}

fn touch_edge(from: DVec3, to: DVec3, way: DVec3, radius: f64) -> Option<(f64, DVec3)> {
    let edge = to - from;
    let squared = edge.length_squared();
    let (along, way_along) = (-from.dot(edge) / squared, way.dot(edge) / squared);
    // What is across the edge.
    let (across, way_across) = (-from - edge * along, way - edge * way_along);
    let share = first_at_distance(across, way_across, radius)?;
    let along = along + way_along * share;
    (0.0..=1.0).contains(&along).then(|| (share, from + edge * along))
}

fn touch_point(point: DVec3, way: DVec3, radius: f64) -> Option<(f64, DVec3)> {
    Some((first_at_distance(-point, way, radius)?, point))
}

/// When `from + share * way` is first at this distance from the origin, coming nearer; 0 to 1.
fn first_at_distance(from: DVec3, way: DVec3, radius: f64) -> Option<f64> {
    let (a, b, c) = (way.length_squared(), from.dot(way), from.length_squared() - radius * radius);
    let discriminant = b * b - a * c;
    if !(a > 0.0 && discriminant >= 0.0) {
        return None;
    }
    let share = (-b - discriminant.sqrt()) / a;
    (0.0..=1.0).contains(&share).then_some(share)
}

/// The point of a facet that is nearest to the origin.
pub(super) fn nearest_to_origin(facet: [DVec3; 3]) -> DVec3 {
    let [a, b, c] = facet;
    let normal = (b - a).cross(c - a);
    if normal != DVec3::ZERO {
        let foot = normal * (normal.dot(a) / normal.length_squared());
        if is_over(facet, normal, foot) {
            return foot;
        }
    }
    let on_edge = |(from, to): (DVec3, DVec3)| {
        let edge = to - from;
        from + edge * (-from.dot(edge) / edge.length_squared()).clamp(0.0, 1.0)
    };
    let nearest = [(a, b), (b, c), (c, a)].map(on_edge);
    nearest.into_iter().min_by(|a, b| a.length_squared().total_cmp(&b.length_squared())).unwrap_or(a)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = DVec3> {
        [-20.0f64..20.0, -20.0..20.0, -20.0..20.0].prop_map(DVec3::from_array)
    }

    fn facet() -> impl Strategy<Value = [DVec3; 3]> {
        let is_wide = |f: &[DVec3; 3]| (f[1] - f[0]).cross(f[2] - f[0]).length() > 1.0;
        [point(), point(), point()].prop_filter("a facet has an area", is_wide)
    }

    proptest! {
        #[test]
        fn what_is_nearest_is_a_point_of_the_facet_and_none_is_nearer(facet in facet(), u in 0.0f64..1.0, v in 0.0f64..1.0) {
            let nearest = nearest_to_origin(facet);
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            let other = facet[0] + (facet[1] - facet[0]) * u + (facet[2] - facet[0]) * v;
            prop_assert!(nearest.length() <= other.length() + 1e-9);
            let normal = (facet[1] - facet[0]).cross(facet[2] - facet[0]).normalize();
            prop_assert!(normal.dot(nearest - facet[0]).abs() < 1e-9);
        }

        #[test]
        fn a_sphere_touches_first_where_it_is_first_as_near_as_its_radius(
            facet in facet(), way in point(), radius in 0.01f64..5.0,
        ) {
            let distance = |share: f64| nearest_to_origin(facet.map(|corner| corner - way * share)).length();
            let found = touch(facet, way, radius);
            let until = found.map_or(1.0, |(share, _)| share);
            for step in 0..200 {
                let share = until * f64::from(step) / 200.0;
                prop_assert!(share == until || distance(share) > radius - 1e-6, "{share} of {until}: {}", distance(share));
            }
            if let Some((share, contact)) = found {
                prop_assert!((contact - way * share).length() <= radius + 1e-6);
                prop_assert!(share == 0.0 || (distance(share) - radius).abs() < 1e-6);
            }
        }

        #[test]
        fn a_way_crosses_a_facet_where_it_is_on_both(facet in facet(), way in point()) {
            if let Some(share) = crossing(facet, way) {
                prop_assert!(nearest_to_origin(facet.map(|corner| corner - way * share)).length() < 1e-5);
            } else {
                let nearest = (0..=400).map(|k| nearest_to_origin(facet.map(|corner| corner - way * (f64::from(k) / 400.0))).length());
                // What is not met is never on both: a step is as long as the way's 400th part.
                prop_assert!(nearest.fold(f64::INFINITY, f64::min) > 0.0);
            }
        }
    }
}

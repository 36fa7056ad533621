#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use super::*;

fn world() -> Georeference {
    Georeference::new("UTM 10N".into(), Some(32610), Some("+proj=utm +zone=10 +datum=WGS84 +units=m +no_defs"))
}

fn read(text: &str) -> Result<Vec<Vehicle>, String> {
    let mut remarks = Remarks::default();
    parse(Path::new("in/fleet.czml"), text, &world(), &mut remarks).map_err(|error| error.to_string())
}

const CZML: &str = r##"[
  {"id": "document", "version": "1.0"},
  {"id": "truck", "model": {"gltf": "truck.gltf", "scale": 2, "heightReference": "CLAMP_TO_GROUND", "unknown": 7},
   "position": {"epoch": "2026-06-01T12:00:00Z", "cartographicDegrees": [0, -123, 44, 0, 10, -123, 44.001, 0]}},
  {"id": "plane", "point": {"pixelSize": 5, "color": {"rgba": [255, 0, 10, 255]}},
   "position": {"epoch": "2026-06-01T12:00:05Z", "interpolationAlgorithm": "LAGRANGE", "interpolationDegree": 2,
     "cartographicDegrees": [0, -123, 44, 3000, 10, -123, 44.01, 3000, 20, -122.99, 44.01, 3100]},
   "orientation": {"unitQuaternion": [0, 0, 0, 1]}},
  {"id": "mast", "position": {"cartographicDegrees": [-123, 44, 1200]}}
]"##;

#[test]
fn vehicles_of_czml_have_ways_looks_and_heights() {
    let vehicles = read(CZML).unwrap();
    let [truck, plane, mast] = vehicles.as_slice() else { panic!("{}", vehicles.len()) };
    assert_eq!(
        [truck, plane, mast].map(|v| v.height),
        [HeightReference::OnGround, HeightReference::Datum, HeightReference::Datum]
    );
    assert_eq!(truck.appearance.model.as_deref(), Some(Path::new("in/truck.gltf")));
    assert_eq!((truck.appearance.scale, plane.appearance.point_px), (Some(2.0), Some(5.0)));
    assert_eq!(plane.appearance.rgb, Some([255, 0, 10]));
    let noon = 1_780_315_200.0;
    assert_eq!(
        (truck.ways[0].start(), plane.ways[0].start(), mast.ways[0].start()),
        (Some(noon), Some(noon + 5.0), None)
    );
    let placed = truck.at(noon + 5.0).unwrap();
    assert!((placed.position.x - 500_000.0).abs() < 1e-3, "on the central meridian: {placed:?}");
    assert!(placed.ahead.unwrap().normalize().distance(DVec3::Y) < 1e-3 && placed.attitude.is_none());
    assert_eq!((truck.at(noon - 1.0), truck.at(noon + 11.0), mast.at(-5.0).is_some()), (None, None, true));
    // Along the earth's axes: at 123 degrees west the body's x axis is 57 degrees from north, down.
    let turn = plane.at(noon + 5.0).unwrap().attitude.unwrap();
    assert!((turn.length() - 1.0).abs() < 1e-9 && (turn * DVec3::Z).dot(DVec3::Z) > 0.69);
}

#[test]
fn vehicles_of_geojson_are_lines_and_points_with_times() {
    let text = r##"{"type": "FeatureCollection", "features": [
      {"type": "Feature", "properties": {"coordTimes": ["2026-06-01T12:00:00Z", "2026-06-01T12:00:10Z"], "model": "car.glb",
        "marker-color": "#0080ff"}, "geometry": {"type": "LineString", "coordinates": [[-123, 44], [-123, 44.001]]}},
      {"type": "Feature", "properties": {"name": "a", "time": 0}, "geometry": {"type": "Point", "coordinates": [-123, 44, 500]}},
      {"type": "Feature", "properties": {"name": "b", "time": 0}, "geometry": {"type": "Point", "coordinates": [-123, 44.1, 500]}},
      {"type": "Feature", "properties": {"name": "a", "time": 60}, "geometry": {"type": "Point", "coordinates": [-123, 44.01, 600]}},
      {"type": "Feature", "properties": {}, "geometry": {"type": "LineString", "coordinates": [[-123, 44], [-123, 44.001]]}}
    ]}"##;
    let vehicles = read(text).unwrap();
    assert_eq!(vehicles.len(), 3);
    assert_eq!(vehicles[0].height, HeightReference::OnGround);
    assert_eq!(vehicles[0].appearance.rgb, Some([0, 128, 255]));
    assert_eq!(vehicles[0].appearance.model.as_deref(), Some(Path::new("in/car.glb")));
    assert_eq!((vehicles[1].height, vehicles[1].ways[0].moments().len()), (HeightReference::Datum, 2));
    assert!((vehicles[1].at(30.0).unwrap().position.z - 550.0).abs() < 1e-9);
}

#[test]
fn what_is_wrong_is_told_in_a_sentence() {
    let refused = |from: &str, to: &str| read(&CZML.replace(from, to)).unwrap_err();
    let order = refused("0, -123, 44, 0, 10,", "0, -123, 44, 0, -10,");
    assert!(order.contains("packet \"truck\"") && order.contains("a time after that of the sample before"), "{order}");
    let nan = refused("44.001, 0]", "NaN, 0]");
    assert!(nan.contains("not valid JSON") || nan.contains("expected"), "{nan}");
    let height = refused("CLAMP_TO_GROUND", "FLOATING");
    assert!(height.contains("expected NONE, CLAMP_TO_GROUND or RELATIVE_TO_GROUND, found \"FLOATING\""), "{height}");
    let remote = refused("truck.gltf", "https://example.org/truck.gltf");
    assert!(remote.contains("a glTF file beside this one"), "{remote}");
    let scale = refused(r#""scale": 2"#, r#""scale": -2"#);
    assert!(scale.contains("model: scale"), "{scale}");
    for text in
        ["[]", r#"[{"id": "document"}]"#, "{}", "<kml/>", "", r#"{"type": "FeatureCollection", "features": []}"#]
    {
        let error = read(text).unwrap_err();
        assert!(error.contains("in/fleet.czml") && error.contains("expected CZML"), "{text}: {error}");
    }
    let missing = load(Path::new("/nothing/here.czml"), &world(), &mut Remarks::default()).unwrap_err().to_string();
    assert!(missing.contains("/nothing/here.czml"), "{missing}");
}

use super::*;
use proptest::prelude::*;

fn utm10() -> Georeference {
    Georeference::new("WGS 84 / UTM zone 10N".into(), Some(32610), None)
}

#[test]
fn utm_positions_agree_with_proj() {
    // echo -122 45 | proj +proj=utm +zone=10 +datum=WGS84 gives 578815.30 4983436.77
    let point = utm10().from_lonlat().unwrap().position(-122.0, 45.0).unwrap();
    assert!((point - DVec2::new(578_815.30, 4_983_436.77)).length() < 0.01, "{point}");
}

#[test]
fn north_turns_with_the_meridian() {
    // Convergence: (lon - central meridian) * sin(lat) = 1 * sin(45 deg) = 0.707 deg east of grid
    // north... to the first order; east of the central meridian true north lies to the west of grid
    // north.
    let heading = utm10().from_lonlat().unwrap().heading(-122.0, 45.0, 0.0).unwrap();
    assert!((heading.to_degrees() + 0.707).abs() < 0.001, "{}", heading.to_degrees());
    let polar = utm10().from_lonlat().unwrap().heading(-123.0, 90.0, 0.5).unwrap();
    assert!((polar - 0.5).abs() < 1e-6);
}

#[test]
fn the_own_crs_needs_no_transform_and_others_do() {
    let world = utm10();
    for own in ["EPSG:32610", "epsg:32610", "urn:ogc:def:crs:EPSG::32610", "WGS 84 / UTM zone 10N"] {
        assert!(world.from_crs(own).unwrap().is_none(), "{own}");
    }
    let zone11 = world.from_crs("EPSG:32611").unwrap().unwrap();
    let lonlat = world.from_lonlat().unwrap();
    let there = Georeference::new("11".into(), Some(32611), None).from_lonlat().unwrap();
    let p11 = there.position(-120.0, 40.0).unwrap();
    assert!((zone11.position(p11.x, p11.y).unwrap() - lonlat.position(-120.0, 40.0).unwrap()).length() < 1e-3);
}

#[test]
fn another_body_has_its_own_longitudes() {
    let text = "+proj=eqc +lat_ts=0 +lat_0=0 +lon_0=137 +x_0=0 +y_0=0 +R=3396190 +units=m +no_defs";
    let mars = Georeference::new("Mars".into(), None, Some(text));
    let point = mars.from_lonlat().unwrap().position(138.0, -1.0).unwrap();
    let degree_m = 3_396_190.0 * std::f64::consts::PI / 180.0;
    assert!((point - DVec2::new(degree_m, -degree_m)).length() < 0.01, "{point}");
}

#[test]
fn what_cannot_be_transformed_is_said_in_a_sentence() {
    let nameless = Georeference::new("local grid".into(), None, None);
    assert!(nameless.from_lonlat().unwrap_err().to_string().contains("has no PROJ string"));
    for crs in ["EPSG:1", "EPSG:99999999999", "EPSG:", "mars", "+proj=nonsense", ""] {
        assert!(utm10().from_crs(crs).unwrap_err().to_string().contains("not known here"), "{crs}");
    }
    assert!(utm10().from_lonlat().unwrap().position(10.0, 95.0).is_err());
    assert!(Georeference::new("x".into(), None, Some("+proj=rubbish")).from_lonlat().is_err());
}

/// `gdaltransform -s_srs EPSG:FROM -t_srs EPSG:TO` says where places are.
fn distance(transform: &Transform, from: [f64; 2], to: [f64; 2]) -> f64 {
    (transform.position(from[0], from[1]).unwrap() - DVec2::from_array(to)).length()
}

const SAME_DATUM: [f64; 2] = [727_575.014, 4_197_668.334];
const OSGB_LONLAT: [f64; 2] = [325_442.179, 506_691.182];
const BRITAIN_PLACE: [f64; 2] = [325_530.597, 506_676.247];
const BRITAIN_SHIFT: [f64; 2] = [BRITAIN_PLACE[0] - OSGB_LONLAT[0], BRITAIN_PLACE[1] - OSGB_LONLAT[1]];
const BRITAIN_IN_UTM: [f64; 2] = [489_738.831, 6_033_917.272];
const DUTCH_IN_UTM: [f64; 2] = [663_303.928, 5_780_984.300];
const NAD27_IN_UTM: [f64; 2] = [500_017.121, 4_200_211.736];
const NAD27_PLACE: [f64; 2] = [499_982.879, 4_205_603.250];
const ISRAEL_PLACE: [f64; 2] = [200_033.740, 600_894.611];

const NAD27_17: &str = "+proj=utm +zone=17 +datum=NAD27 +units=m +no_defs";
const BRITAIN: &str =
    "+proj=tmerc +lat_0=49 +lon_0=-2 +k=0.9996012717 +x_0=400000 +y_0=-100000 +ellps=airy +units=m +no_defs";

#[test]
fn another_zone_of_the_same_datum_needs_no_shift() {
    let world = Georeference::new("NAD27 / UTM zone 17N".into(), Some(26717), Some(NAD27_17));
    assert!(world.from_crs("EPSG:26717").unwrap().is_none());
    let transform = world.from_crs("EPSG:26718").unwrap().unwrap();
    assert!(distance(&transform, [200_000.0, 4_200_000.0], SAME_DATUM) < 0.01);
    let world = Georeference::new("OSGB36 / British National Grid".into(), Some(27700), Some(BRITAIN));
    let transform = world.from_crs("EPSG:4277").unwrap().unwrap();
    assert!(distance(&transform, [-3.15, 54.45], OSGB_LONLAT) < 0.01);
    assert!(world.take_doubts().is_empty());
}

#[test]
fn a_path_on_another_datum_is_shifted() {
    let world = Georeference::new("WGS 84 / UTM zone 30N".into(), Some(32630), Some("+proj=utm +zone=30 +datum=WGS84"));
    assert!(distance(&world.from_crs("EPSG:27700").unwrap().unwrap(), [325_000.0, 507_000.0], BRITAIN_IN_UTM) < 5.0);
    let world = Georeference::new("WGS 84 / UTM zone 31N".into(), Some(32631), Some("+proj=utm +zone=31 +datum=WGS84"));
    assert!(distance(&world.from_crs("EPSG:28992").unwrap().unwrap(), [155_000.0, 463_000.0], DUTCH_IN_UTM) < 5.0);
    assert!(world.take_doubts().is_empty());
    let world = Georeference::new("WGS 84 / UTM zone 17N".into(), Some(32617), Some("+proj=utm +zone=17 +datum=WGS84"));
    assert!(distance(&world.from_crs("EPSG:26717").unwrap().unwrap(), [500_000.0, 4_200_000.0], NAD27_IN_UTM) < 5.0);
    let doubts = world.take_doubts();
    assert!(
        doubts.len() == 1 && doubts[0].contains("EPSG:26717 is on NAD27") && doubts[0].contains("10 m"),
        "{doubts:?}"
    );
    assert!(world.take_doubts().is_empty());
}

#[test]
fn a_datum_that_nothing_tells_of_is_a_doubt() {
    let crs = "+proj=utm +zone=30 +ellps=intl +units=m";
    let world = Georeference::new("WGS 84 / UTM zone 30N".into(), Some(32630), Some("+proj=utm +zone=30 +datum=WGS84"));
    assert!(world.from_crs(crs).unwrap().is_some());
    let doubts = world.take_doubts().concat();
    assert!(doubts.contains("does not tell how its datum lies") && doubts.contains("some hundred metres"), "{doubts}");
    let own = Georeference::new("local".into(), None, Some("+proj=utm +zone=31 +ellps=intl +units=m"));
    assert!(own.from_crs(crs).unwrap().is_some());
    assert!(own.take_doubts().concat().contains("same ellipsoid"));
}

#[test]
fn what_proj_said_at_ingest_is_used() {
    let table = LonLatTable {
        lonlat: WGS84_LONLAT.into(),
        plane: BRITAIN.into(),
        first: [300_000.0, 400_000.0],
        step: [100_000.0, 200_000.0],
        size: [2, 2],
        // What gdaltransform adds at -3.15, 54.45.
        offsets_m: [BRITAIN_SHIFT; 4].concat(),
        shift_m: 90.0,
        error_m: 0.01,
    };
    let world = Georeference::new("OSGB36 / British National Grid".into(), Some(27700), Some(BRITAIN))
        .with_table(Some(table), [325_000.0, 507_000.0]);
    for transform in [world.from_lonlat().unwrap(), world.from_crs("EPSG:4326").unwrap().unwrap()] {
        assert!(distance(&transform, [-3.15, 54.45], BRITAIN_PLACE) < 0.01);
        // Convergence is that of the plane: 1.15 degrees times the sine of the latitude, west of
        // the meridian of -2.
        let heading = transform.heading(-3.15, 54.45, 0.0).unwrap().to_degrees();
        assert!((heading - 1.15 * 54.45f64.to_radians().sin()).abs() < 0.01, "{heading}");
    }
    assert!(world.take_doubts().is_empty());
    let transform = world.from_crs("EPSG:4277").unwrap().unwrap();
    assert!(distance(&transform, [-3.15, 54.45], OSGB_LONLAT) < 0.01);
}

#[test]
fn a_database_without_a_table_is_told_of_with_the_size_of_the_doubt() {
    let old = |name: &str, epsg, text: &str| {
        Georeference::new(name.into(), epsg, Some(text)).with_table(None, [325_000.0, 507_000.0])
    };
    let britain = old("OSGB36 / British National Grid", Some(27700), BRITAIN);
    assert!(distance(&britain.from_lonlat().unwrap(), [-3.15, 54.45], BRITAIN_PLACE) < 5.0);
    let doubts = britain.take_doubts().concat();
    assert!(doubts.contains("a mean shift of 9") && doubts.contains("ingest again"), "{doubts}");
    let nad27 = old("NAD27 / UTM zone 17N", Some(26717), NAD27_17);
    assert!(distance(&nad27.from_lonlat().unwrap(), [-81.0, 38.0], NAD27_PLACE) < 5.0);
    assert!(nad27.take_doubts().concat().contains("--crs EPSG:326NN"));
    let israel = "+proj=tmerc +lat_0=31.7343936111111 +lon_0=35.2045169444444 +k=1.0000067 +x_0=219529.584 \
                  +y_0=626907.39 +ellps=GRS80 +units=m +no_defs";
    let israel = old("Israel 1993 / Israeli TM Grid", Some(2039), israel);
    // The mean shift of the code's old definition; without any it would be 80 m.
    assert!(distance(&israel.from_lonlat().unwrap(), [35.0, 31.5], ISRAEL_PLACE) < 50.0);
    assert_eq!(israel.take_doubts().len(), 1);
    let nameless = old("local", None, "+proj=tmerc +lon_0=9 +ellps=bessel +units=m");
    assert!(nameless.from_lonlat().is_ok());
    assert!(nameless.take_doubts().concat().contains("up to 500 m"));
    for (epsg, text) in [
        (Some(25832), "+proj=utm +zone=32 +ellps=GRS80 +units=m +no_defs"),
        (Some(26910), "+proj=utm +zone=10 +datum=NAD83 +units=m +no_defs"),
        (
            Some(3857),
            "+proj=merc +a=6378137 +b=6378137 +lat_ts=0 +lon_0=0 +x_0=0 +y_0=0 +k=1 +units=m +nadgrids=@null +wktext",
        ),
        (None, "+proj=sinu +R=6371007.181 +units=m"),
        (None, "+proj=eqc +R=3396190 +units=m"),
        (None, "+proj=utm +zone=32 +ellps=bessel +towgs84=598.1,73.7,418.2,0.202,0.045,-2.455,6.7 +units=m"),
    ] {
        let world = old("fine", epsg, text);
        assert!(world.from_lonlat().is_ok() && world.take_doubts().is_empty(), "{text}");
    }
}

proptest! {
    #[test]
    fn foreign_positions_never_panic(x in proptest::num::f64::ANY, y in proptest::num::f64::ANY, crs in "\\PC{0,30}") {
        drop(utm10().from_lonlat().unwrap().position(x, y));
        drop(utm10().from_crs(&crs));
        drop(Georeference::new(String::new(), None, Some(&crs)).from_lonlat());
    }
}

#[test]
fn the_way_back_from_the_worlds_crs_is_found() {
    let world = Georeference::new("UTM 10N".into(), Some(32610), Some("+proj=utm +zone=10 +datum=WGS84 +units=m"));
    let transform = world.from_lonlat().unwrap();
    for [lon, lat] in [[-122.2, 46.2], [-125.9, 1.0], [-120.1, -33.0], [-123.0, 83.0]] {
        let place = transform.position(lon, lat).unwrap();
        let [x, y] = transform.source_of(place, [lon + 0.2, lat - 0.1]).unwrap();
        assert!((x - lon).abs() < 1e-8 && (y - lat).abs() < 1e-8, "{lon} {lat}: {x} {y}");
    }
    assert!(transform.source_of(DVec2::splat(f64::NAN), [0.0, 0.0]).is_none());
}

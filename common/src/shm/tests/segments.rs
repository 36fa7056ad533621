//! Segments in `/dev/shm`: made, opened, refused, removed.

use crate::shm::header::{Header, Segment};
use crate::shm::kind::SegmentKind;
use crate::shm::layout::Layout;
use crate::shm::process::ProcessId;
use crate::shm::region::Region;
use crate::shm::ring::{Consumer, Producer};
use crate::shm::run_id::RunId;
use crate::shm::segments::{RunSegments, open_before, open_segment, reap_dead_runs};
use crate::shm::{CameraRecord, Control, ElevationReader, ElevationWriter, PoolReader, PoolWriter, ShmError};
use crate::shm::{TreeReader, TreeWriter};
use crate::slot::Slot;
use crate::texels::TexelFormat;
use crate::world::{World, WorldFields};
use bytemuck::Zeroable;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::time::Duration;

fn path(run: &RunId, kind: SegmentKind) -> PathBuf {
    PathBuf::from("/dev/shm").join(run.segment_name(kind))
}

fn names_of(run: &RunId) -> Vec<String> {
    let prefix = format!("{run}-");
    let entries = std::fs::read_dir("/dev/shm").unwrap();
    let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    names.filter(|name| name.starts_with(&prefix)).collect()
}

#[test]
fn a_run_has_its_segments_for_as_long_as_the_launcher_holds_them() {
    let run = RunId::unique_for_tests();
    let layout = Layout::small();
    let segments = RunSegments::create(&run, &layout).unwrap();
    assert_eq!(segments.total_bytes(), layout.total_bytes());
    assert_eq!(names_of(&run).len(), SegmentKind::ALL.len());
    for kind in SegmentKind::ALL {
        let meta = std::fs::metadata(path(&run, kind)).unwrap();
        assert_eq!(meta.permissions().mode() & 0o777, 0o600, "{kind}");
        assert_eq!(meta.len() % 4096, 0, "{kind}");
        // All memory is there already, in 512 byte blocks: no page is missing when it is touched.
        assert_eq!(std::os::unix::fs::MetadataExt::blocks(&meta) * 512, meta.len(), "{kind}");
    }
    let control = Control::open(&run).unwrap();
    let mut ring = Producer::<Slot>::open(&run, SegmentKind::Ring).unwrap();
    let mut slots = Consumer::<Slot>::open(&run, SegmentKind::Ring).unwrap();
    ring.push(&Slot::zeroed(), &control).unwrap();
    assert_eq!(slots.pop(&control).unwrap(), Slot::zeroed());
    assert_eq!(ring.capacity(), layout.ring_slots);
    let mut cameras = Producer::<CameraRecord>::open(&run, SegmentKind::CameraRing).unwrap();
    cameras.push(&CameraRecord::zeroed(), &control).unwrap();
    assert_eq!(TreeWriter::open(&run).unwrap().capacity(), layout.tree_nodes);
    TreeReader::open(&run).unwrap();
    let elevation = ElevationReader::open(&run).unwrap();
    assert_eq!(
        (elevation.capacity(), elevation.array_len()),
        (layout.elevation_arrays, layout.elevation_array_f32.into())
    );
    assert_eq!(elevation.memory().as_ptr().addr() % 4096, 0);
    assert_eq!(elevation.memory().len() % 4096, 0);
    assert_eq!((elevation.data_offset() % 4096, elevation.stride_bytes() % 64), (0, 0));
    ElevationWriter::open(&run).unwrap();
    for kind in [SegmentKind::ColorPool, SegmentKind::ElevationPool] {
        let writer = PoolWriter::open(&run, kind).unwrap();
        assert_eq!(PoolReader::open(&run, kind).unwrap().slot_bytes(), writer.slot_bytes());
    }
    drop(segments);
    assert_eq!(names_of(&run), Vec::<String>::new());
    // The handles are still good, the names are gone.
    ring.push(&Slot::zeroed(), &control).unwrap();
    assert!(slots.try_pop().unwrap().is_some());
}

#[test]
fn a_run_is_made_once() {
    let run = RunId::unique_for_tests();
    let segments = RunSegments::create(&run, &Layout::small()).unwrap();
    let error = RunSegments::create(&run, &Layout::small()).unwrap_err();
    assert!(matches!(error, ShmError::AlreadyExists { .. }), "{error}");
    assert_eq!(names_of(&run).len(), SegmentKind::ALL.len());
    drop(segments);
}

#[test]
fn a_run_that_does_not_fit_says_what_it_needs_and_leaves_nothing() {
    let run = RunId::unique_for_tests();
    let layout = Layout { color_slots: 1 << 30, color_slot_bytes: 1 << 20, ..Layout::small() };
    match RunSegments::create(&run, &layout).unwrap_err() {
        ShmError::NotEnoughSpace { needed, available } => {
            assert_eq!(needed, layout.total_bytes());
            assert!(available < needed);
        }
        other => panic!("{other}"),
    }
    assert_eq!(names_of(&run), Vec::<String>::new());
    // Sizes that do not even fit into a number are too large as well.
    let layout = Layout { elevation_arrays: 3, ..Layout::small() };
    assert!(matches!(RunSegments::create(&run, &layout), Err(ShmError::NotEnoughSpace { .. })));
    assert_eq!(names_of(&run), Vec::<String>::new());
}

#[test]
fn what_cannot_be_opened_says_why() {
    let short = Duration::from_millis(20);
    let run = RunId::unique_for_tests();
    let kind = SegmentKind::Ring;
    let open = |run: &RunId| open_before(run, kind, short).unwrap_err();

    assert!(matches!(open(&run), ShmError::NotReady { waited_ms: 20, .. }));
    let own = ProcessId::own().unwrap();
    let dead = RunId::parse(&format!("tv-{}-{}", own.pid, own.start_time + 1)).unwrap();
    assert!(matches!(open(&dead), ShmError::PeerGone { .. }));

    // A file of someone else's, of any bytes and lengths.
    let file = path(&run, kind);
    for (bytes, is_late) in
        [(vec![], true), (vec![0; 4096], true), (vec![1; 100], false), (vec![0xff; 8192], true), (vec![0; 255], false)]
    {
        std::fs::write(&file, bytes).unwrap();
        let error = open(&run);
        assert_eq!(matches!(error, ShmError::NotReady { .. }), is_late, "{error}");
        assert!(is_late || matches!(error, ShmError::TooSmall { .. }), "{error}");
    }
    // A whole header before too little data.
    let segments = RunSegments::create(&RunId::unique_for_tests(), &Layout::small()).unwrap();
    let whole = std::fs::read(path(segments.run(), kind)).unwrap();
    std::fs::write(&file, &whole[..4096]).unwrap();
    assert!(matches!(open(&run), ShmError::TooSmall { needed, found: 4096, .. } if needed == whole.len() as u64));
    // The same of another build.
    let mut other = whole.clone();
    other[8] = 99;
    std::fs::write(&file, &other).unwrap();
    assert!(matches!(open(&run), ShmError::VersionMismatch { theirs: 99, .. }));
    std::fs::write(&file, &whole).unwrap();
    open_before(&run, kind, short).unwrap();
    std::fs::remove_file(&file).unwrap();
}

#[test]
fn an_opener_waits_for_a_segment_that_is_being_made() {
    let run = RunId::unique_for_tests();
    std::thread::scope(|scope| {
        let waiting = scope.spawn(|| open_segment(&run, SegmentKind::Control).map(|segment| segment.kind()));
        std::thread::sleep(Duration::from_millis(20));
        let segments = RunSegments::create(&run, &Layout::small()).unwrap();
        assert_eq!(waiting.join().unwrap().unwrap(), SegmentKind::Control);
        drop(segments);
    });
}

#[test]
fn segments_of_dead_runs_are_removed_and_nothing_else_is() {
    let own = ProcessId::own().unwrap();
    let live = RunSegments::create(&RunId::unique_for_tests(), &Layout::small()).unwrap();
    // Dead: our id, with the start time of a process that had it before.
    let dead = RunId::parse(&format!("tv-{}-{}", own.pid, own.start_time - 1)).unwrap();
    let foreign = PathBuf::from(format!("/dev/shm/tv-{}-{}-ring.bak", own.pid, own.start_time - 1));
    let orphans = [SegmentKind::Control, SegmentKind::ColorPool].map(|kind| path(&dead, kind));
    // One that was whole, and one whose maker died before it wrote anything.
    std::fs::write(&orphans[0], b"TVSHMSEG left behind").unwrap();
    std::fs::write(&orphans[1], vec![0; 8192]).unwrap();
    std::fs::write(&foreign, b"TVSHMSEG left behind").unwrap();
    // With the name of a segment: someone's notes, a link to a file that begins like a segment, and
    // a second name of one.
    let [notes, link, second] =
        [SegmentKind::PingPong, SegmentKind::WantList, SegmentKind::ElevationPool].map(|kind| path(&dead, kind));
    std::fs::write(&notes, b"someone's notes").unwrap();
    std::os::unix::fs::symlink(&foreign, &link).unwrap();
    let target = foreign.with_extension("target");
    std::fs::write(&target, b"TVSHMSEG").unwrap();
    std::fs::hard_link(&target, &second).unwrap();
    // A launcher in another container looks dead from here, but holds the lock of its segments.
    let elsewhere = path(&dead, SegmentKind::Ring);
    // Locked before it has its name: tests beside this one remove segments of dead runs as well.
    let unnamed = foreign.with_extension("new");
    let held = std::fs::File::create(&unnamed).unwrap();
    rustix::fs::flock(&held, rustix::fs::FlockOperation::LockExclusive).unwrap();
    std::fs::rename(&unnamed, &elsewhere).unwrap();

    // Another process may be at it at the same time, so the files tell, not the list.
    drop(reap_dead_runs());
    assert!(orphans.iter().all(|file| !file.exists()));
    assert!([&foreign, &elsewhere, &notes, &target, &second].into_iter().all(|file| file.exists()));
    assert!(link.symlink_metadata().is_ok(), "a link is not ours");
    assert_eq!(names_of(live.run()).len(), SegmentKind::ALL.len());
    drop(held);
    drop(reap_dead_runs());
    assert!(!elsewhere.exists());
    [notes, link, second, target, foreign].into_iter().for_each(|file| std::fs::remove_file(file).unwrap());
}

#[test]
fn the_layout_of_a_run_keeps_to_its_memory() {
    let fields = WorldFields {
        origin: [0.0, 0.0],
        lattice_unit_m: 10.0,
        extent: [4096, 4096],
        elevation_tile: 32,
        color_tile: 256,
        levels: 8,
        finest_elevation_level: 0,
        finest_color_level: 2,
        body: None,
    };
    let world = World::new(fields).unwrap();
    let gibibyte = 1 << 30;
    let layout = Layout::for_run(&world, gibibyte, TexelFormat::Rgba8).unwrap();
    assert_eq!(layout.elevation_array_f32, 33 * 33);
    assert_eq!(layout.color_slot_bytes, u64::from((264u32.pow(2) + 132 * 132 + 66 * 66) * 4).next_multiple_of(4096));
    assert_eq!(layout.elevation_arrays, 4096);
    let pools = 2 * u64::from(layout.color_slots) * layout.color_slot_bytes
        + u64::from(layout.elevation_slots) * layout.elevation_slot_bytes;
    assert!(pools <= gibibyte && pools > gibibyte * 99 / 100);
    assert!(layout.total_bytes() < gibibyte / 2 + (100 << 20));
    // Fine facets have room for their trees, within the same memory; usual ones change nothing.
    assert_eq!(layout.for_picture(&world, 1280 * 720, 3.0), layout);
    let fine = layout.for_picture(&world, 3840 * 2160, 1.0);
    assert_eq!((fine.elevation_arrays, fine.tree_nodes), (65_536, 262_144));
    assert!(fine.elevation_slots >= 131_072 && fine.color_slots > 64);
    let bytes = 2 * u64::from(fine.color_slots) * fine.color_slot_bytes
        + u64::from(fine.elevation_slots) * fine.elevation_slot_bytes;
    assert!(bytes <= gibibyte, "{bytes}");
    assert_eq!(Layout::finest_facet_px(&world, 1280 * 720), 1.0);
    let facet_px = Layout::finest_facet_px(&world, 16_384 * 8192);
    assert!(facet_px > 3.0 && facet_px < 4.0, "{facet_px}");
    // Image arrays end somewhere.
    assert_eq!(Layout::for_run(&world, 64 * gibibyte, TexelFormat::Rgba8).unwrap().color_slots, 2048);
    // Compressed tiles take an eighth, and there are as many elevation tiles for each as before.
    let (plain, compressed) =
        [TexelFormat::Rgba8, TexelFormat::Bc1].map(|texels| Layout::for_run(&world, 1 << 27, texels).unwrap()).into();
    assert_eq!(compressed.color_slot_bytes, 34_848 + 8_712 + 2_312 + 3_280);
    assert_eq!(compressed.elevation_slots / compressed.color_slots, plain.elevation_slots / plain.color_slots);
    assert!(compressed.color_slots > 5 * plain.color_slots, "{} {}", compressed.color_slots, plain.color_slots);
    match Layout::for_run(&world, 1 << 20, TexelFormat::Rgba8).unwrap_err() {
        ShmError::MemoryTooSmall { needed, available } => {
            assert_eq!(available, 1 << 20);
            assert_eq!(Layout::for_run(&world, needed, TexelFormat::Rgba8).unwrap().color_slots, 64);
            assert!(Layout::for_run(&world, needed - 1, TexelFormat::Rgba8).is_err());
        }
        other => panic!("{other}"),
    }
    // Large elevation tiles do not make the ring large.
    let world = World::new(WorldFields { elevation_tile: 256, levels: 5, finest_color_level: 0, ..fields }).unwrap();
    let layout = Layout::for_run(&world, gibibyte, TexelFormat::Rgba8).unwrap();
    assert_eq!(layout.elevation_arrays, 256);
    for kind in SegmentKind::ALL {
        let geometry = layout.geometry(kind);
        assert_eq!((geometry.total_bytes % 4096, geometry.data_offset % 4096), (0, 0));
        assert!(geometry.data_offset + geometry.capacity * geometry.stride <= geometry.total_bytes);
    }
}

#[test]
fn a_region_refuses_addresses_outside_of_it() {
    let region = Region::heap(4096).unwrap();
    for offset in [4096 - 80, 4096, u64::MAX - 3] {
        let outside = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            region.words::<Header>(offset);
        }));
        assert!(outside.is_err(), "{offset}");
    }
    let geometry = Layout::small().geometry(SegmentKind::Ring);
    assert!(matches!(Segment::create(region, geometry), Err(ShmError::TooSmall { .. })));
}

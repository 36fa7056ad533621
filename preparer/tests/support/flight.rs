//! A whole flight through a preparer, over memory of this process: the test writes trees as the
//! generator does, and reads the rings as the renderer does.

use super::server::{Gate, Server, TileServer};
use bytemuck::Zeroable;
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::Duration;
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::database::{Layer, TileError, TileScratch, TileSource};
use terravision_common::event::Event;
use terravision_common::ids::{RingPosition, Sequence};
use terravision_common::level::{LevelFunction, Measure};
use terravision_common::node::NodeId;
use terravision_common::rig::Views;
use terravision_common::run::{RealtimeConfig, RunConfig};
use terravision_common::shm::{
    Consumer, Control, ElevationReader, PoolReader, RunState, TreeWriter, WaitError, memory,
};
use terravision_common::slot::{FrameEnd, FrameMarker, Slot, SlotContent, TileSlot};
use terravision_common::stage::Events;
use terravision_common::synthetic::{Relief, SyntheticTerrain};
use terravision_common::traversal::{Traversal, TreeLimits};
use terravision_common::tree::TreeHeader;
use terravision_common::world::World;
use terravision_preparer::PreparerError;
use terravision_preparer::frame_tree::Tile;
use terravision_preparer::loader::wanted::WantedTiles;
use terravision_preparer::ports::Ports;
use terravision_preparer::stage::Preparer;
use terravision_testkit::runs;

pub const NODES: u32 = 4096;
pub const ARRAYS: u32 = 512;
pub const R_PX: [f64; 2] = [24.0, 2.0];

pub fn small_world() -> World {
    super::world([300, 200], 8, [0, 0], 4)
}

/// A path low over the terrain: the tree is another one in every frame.
pub fn path(frames: u64) -> Vec<Camera> {
    let at = |k: u64| {
        Camera::new(CameraFields {
            eye_in_world: [300.0 + 8.0 * k as f64, 200.0 + 5.0 * k as f64, 500.0],
            heading_rad: 0.8 + 0.01 * k as f64,
            pitch_rad: -0.5,
            roll_rad: 0.0,
            vfov_rad: 1.0,
            width: 320,
            height: 200,
            timestamp_nanos: 0,
        })
        .expect("valid")
    };
    (0..frames).map(at).collect()
}

/// A terrain some tiles of which cannot be read, as a fixed share of the finer nodes of each layer.
#[derive(Debug, Clone)]
pub struct Source {
    pub terrain: SyntheticTerrain,
    /// Of 256.
    pub missing: u8,
    /// The root's colour tile, too.
    pub is_root_missing: bool,
}

impl Source {
    pub fn new(missing: u8) -> Self {
        let terrain = SyntheticTerrain::new(&small_world(), Relief::Mountains { height_m: 300.0 }, 5);
        Self { terrain, missing, is_root_missing: false }
    }

    pub fn is_missing(&self, tile: Tile) -> bool {
        if tile.node == self.terrain.world().root() {
            return self.is_root_missing && tile.layer == Layer::Color;
        }
        let hash = (tile.node.pack() ^ (tile.layer as u64) << 50).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 56;
        (hash as u8) < self.missing
    }

    fn check(&self, layer: Layer, node: NodeId) -> Result<(), TileError> {
        if self.is_missing(Tile { layer, node }) { Err(TileError::Missing { layer, node }) } else { Ok(()) }
    }
}

impl TileSource for Source {
    fn read_elevation(&self, node: NodeId, out: &mut [f32], scratch: &mut TileScratch) -> Result<(), TileError> {
        self.check(Layer::Elevation, node)?;
        self.terrain.read_elevation(node, out, scratch)
    }

    fn read_color(&self, node: NodeId, out: &mut [u8], scratch: &mut TileScratch) -> Result<(), TileError> {
        self.check(Layer::Color, node)?;
        self.terrain.read_color(node, out, scratch)
    }
}

/// One frame as the renderer got it, without what differs from run to run: pool slots and ring
/// positions.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    pub marker: FrameMarker,
    pub tiles: Vec<TileSlot>,
    pub arrays: Vec<Vec<u32>>,
    pub end: FrameEnd,
}

/// How a flight is flown.
#[derive(Debug, Clone)]
pub struct Flight {
    pub source: Source,
    /// See [`TileServer::rotation`].
    pub rotation: usize,
    pub color_slots: u32,
    pub elevation_slots: u32,
    /// Frames that the renderer keeps before it calls the oldest completed.
    pub in_flight: usize,
    pub frames: u64,
    pub first_frame: u64,
    /// Realtime mode; one in this many frames is made and the others are skipped.
    pub realtime: Option<u64>,
    /// This many frames have only the top levels; each later frame has all tiles that earlier
    /// frames lacked.
    pub held: Option<u64>,
}

impl Flight {
    pub fn new() -> Self {
        Self {
            source: Source::new(0),
            rotation: 0,
            color_slots: 1500,
            elevation_slots: 3000,
            in_flight: 2,
            frames: 40,
            first_frame: 100,
            realtime: None,
            held: None,
        }
    }

    /// Flies it. What the renderer saw, and what the preparer told.
    pub fn fly(&self) -> Result<(Vec<Frame>, Vec<Event>), PreparerError> {
        let flight = self.clone();
        #[expect(clippy::disallowed_methods, reason = "a test sends a few")]
        let (send, receive) = channel();
        let thread = std::thread::spawn(move || send.send(flight.fly_here()));
        let result = receive.recv_timeout(Duration::from_secs(120)).expect("the flight ends in time");
        thread.join().expect("no panic").expect("received");
        result
    }

    fn fly_here(&self) -> Result<(Vec<Frame>, Vec<Event>), PreparerError> {
        let parts = self.parts();
        let Parts { control, mut ports, mut trees, mut ring, mut elevation, colors, mut events, loader, server, gate } =
            parts;
        let world = small_world();
        std::thread::scope(|scope| {
            scope.spawn(|| self.generate(&control, &gate, &mut trees));
            let renderer = scope.spawn(|| self.render(&control, &mut ring, &mut elevation, &colors));
            let prepared = (|| {
                let mut preparer = Preparer::new(&world, &self.config(), loader, &mut ports)?;
                for _ in 0..self.frames {
                    preparer.frame(&mut ports)?;
                }
                Ok(())
            })();
            if prepared.is_err() {
                control.set_state(RunState::Failed);
            }
            let frames = renderer.join().expect("no panic");
            drop(server);
            let told = std::iter::from_fn(|| events.try_pop().expect("not corrupt")).collect();
            prepared.map(|()| (frames.expect("all frames"), told))
        })
    }

    pub fn parts(&self) -> Parts {
        let world = small_world();
        let posts = world.elevation_posts().pow(2);
        let stored = world.color_stored();
        let color_bytes = (0..3).map(|mip| u64::from(stored >> mip).pow(2) * 4).sum();
        let (trees, tree_reader) = memory::ping_pong(NODES).expect("valid");
        let (slots, ring) = memory::ring::<Slot>(256).expect("valid");
        let (arrays, elevation) = memory::elevation_ring(ARRAYS, posts).expect("valid");
        let (told, events) = memory::ring::<Event>(1 << 15).expect("valid");
        let (elevation_pool, heights) = memory::pool(self.elevation_slots, u64::from(posts) * 4 + 28).expect("valid");
        let (color_pool, colors) = memory::pool(self.color_slots, color_bytes).expect("valid");
        let (wants, wanted) = memory::want_list(2048).expect("valid");
        let (told_outcomes, outcomes) = memory::outcomes(4096).expect("valid");
        let loader = WantedTiles::new(heights, colors.clone(), wants, outcomes);
        // Two handles on one control block: the preparer's, and that of everyone else here.
        let control = Arc::new(memory::control().expect("a control block"));
        let ports = Ports {
            control: Arc::clone(&control),
            trees: tree_reader,
            ring: slots,
            elevation: arrays,
            events: Events::new(told),
        };
        let gate = Arc::new(Gate::default());
        if self.held.is_none() {
            gate.open();
        }
        let server = Server::start(TileServer {
            control: Arc::clone(&control),
            gate: Arc::clone(&gate),
            source: self.source.clone(),
            pools: [elevation_pool, color_pool],
            wants: wanted,
            outcomes: told_outcomes,
            rotation: self.rotation,
        });
        Parts { control, ports, trees, ring, elevation, colors, events, loader, server, gate }
    }

    pub fn config(&self) -> RunConfig {
        let frames = [self.first_frame, self.first_frame + self.frames * self.realtime.unwrap_or(1)];
        RunConfig {
            width: 320,
            height: 200,
            r_z_px: R_PX[0],
            r_c_px: R_PX[1],
            exaggeration: 1.5,
            realtime: self.realtime.map(|_| RealtimeConfig { has_feedback: false, coarsest_px: R_PX, rest_px: R_PX }),
            ..runs::config(frames)
        }
    }

    /// Writes the trees of the path, as long as anyone takes them.
    fn generate(&self, control: &Control, gate: &Gate, trees: &mut TreeWriter) {
        let mut traversal = Traversal::new(&small_world(), limits());
        let numbers = (self.first_frame..).step_by(self.realtime.unwrap_or(1) as usize);
        for (made, (frame, camera)) in (0..).zip(numbers.zip(path(self.frames))) {
            match self.held {
                Some(held) if made == held => {
                    // When all frames before it have been made.
                    while control.completed_sequence().get() < held && control.check_running().is_ok() {
                        std::thread::sleep(Duration::from_millis(1));
                    }
                    gate.open();
                }
                // Frames are counted from 1: the one before this one is number `made`.
                Some(held) if made > held => gate.await_served(Sequence::new(made), control),
                _ => {}
            }
            if self.generate_one(&mut traversal, frame, &camera, control, trees).is_err() {
                return;
            }
        }
    }

    pub fn generate_one(
        &self,
        traversal: &mut Traversal,
        frame: u64,
        camera: &Camera,
        control: &Control,
        trees: &mut TreeWriter,
    ) -> Result<(), WaitError> {
        let level = LevelFunction::new(camera, &small_world(), 1.5, Measure::Area, R_PX[0], R_PX[1]);
        trees.write(control, |nodes| {
            let stats = traversal.build(&Views::single(camera), &level, &self.source.terrain, nodes);
            let [r_z_px, r_c_px] = R_PX;
            let node_count = stats.node_count;
            TreeHeader { frame, camera: *camera.fields(), r_z_px, r_c_px, node_count, ..TreeHeader::zeroed() }
        })
    }

    /// Takes frames out of the rings and looks at all that they name.
    fn render(
        &self,
        control: &Control,
        ring: &mut Consumer<Slot>,
        elevation: &mut ElevationReader,
        colors: &PoolReader,
    ) -> Result<Vec<Frame>, WaitError> {
        let mut frames = vec![];
        let mut open: Option<Frame> = None;
        let mut array_of = HashMap::new();
        let mut ends = vec![];
        let complete = |count: usize, ends: &[u64], elevation: &mut ElevationReader| {
            if count > 0 {
                elevation.released(RingPosition::new(ends[count - 1])).expect("not corrupt");
                control.set_completed_sequence(Sequence::new(count as u64));
            }
        };
        while frames.len() < self.frames as usize {
            let slot = match ring.try_pop()? {
                Some(slot) => slot,
                None => {
                    // The device finishes what it has; it does not wait for more.
                    complete(frames.len(), &ends, elevation);
                    ring.pop(control)?
                }
            };
            match slot.read().expect("a slot") {
                SlotContent::Marker(marker) => {
                    assert!(open.is_none(), "a frame opens inside of another");
                    open = Some(Frame { marker, tiles: vec![], arrays: vec![], end: FrameEnd::zeroed() });
                    array_of.clear();
                }
                SlotContent::View(view) => {
                    let frame = open.as_ref().expect("a view has a frame");
                    assert_eq!((view.camera, view.index, view.count), (frame.marker.camera, 0, 1));
                }
                SlotContent::Elevation(_) => panic!("this run's frames have elevation arrays"),
                SlotContent::Tile(tile) => {
                    let frame = open.as_mut().expect("a tile has a frame");
                    self.look_at_color(&tile, colors);
                    let index = *array_of.entry(tile.elevation_position).or_insert_with(|| {
                        let array = elevation.read_array(tile.elevation_position).expect("not corrupt");
                        frame.arrays.push(array.expect("published").iter().map(|z| z.to_bits()).collect());
                        frame.arrays.len() as u64 - 1
                    });
                    let neutral = TileSlot { elevation_position: index, color_slot: 0, color_generation: 0, ..tile };
                    frame.tiles.push(neutral);
                }
                SlotContent::End(end) => {
                    let mut frame = open.take().expect("an end has a frame");
                    assert_eq!(end.tile_count as usize, frame.tiles.len());
                    frame.end = FrameEnd { elevation_end: 0, ..end };
                    frames.push(frame);
                    ends.push(end.elevation_end);
                    complete(frames.len().saturating_sub(self.in_flight), &ends, elevation);
                }
            }
        }
        Ok(frames)
    }

    /// The pool's slot holds the colour of the node that the tile slot says.
    fn look_at_color(&self, tile: &TileSlot, colors: &PoolReader) {
        let world = small_world();
        let side = world.node_side(tile.color_level) as u32;
        let [m, n] = tile.color_origin.map(|c| c / side);
        let node = NodeId::new(m, n, tile.color_level).expect("an id");
        assert!(!self.source.is_missing(Tile { layer: Layer::Color, node }));
        let found = colors.bytes(tile.color()).expect("resident");
        let mut expected = vec![0; found.len()];
        self.source.terrain.read_color(node, &mut expected, &mut TileScratch::default()).expect("always");
        assert_eq!(found[..4], expected[..4], "the slot of {node} holds another tile");
    }
}

pub fn limits() -> TreeLimits {
    TreeLimits { nodes: NODES, elevation_leaves: ARRAYS }
}

/// Both sides of all segments.
pub struct Parts {
    pub control: Arc<Control>,
    pub ports: Ports,
    pub trees: TreeWriter,
    pub ring: Consumer<Slot>,
    pub elevation: ElevationReader,
    pub colors: PoolReader,
    pub events: Consumer<Event>,
    pub loader: WantedTiles,
    pub server: Server,
    pub gate: Arc<Gate>,
}

/// The sum of pool slots that no frame of the flight can do without.
pub fn most_wanted(frames: &[Frame]) -> u32 {
    frames.iter().map(|f| f.end.wanted_count).max().unwrap_or(0)
}

//! Writes one colour level of a database as a picture (PPM), to look at: `level_picture WORLD LEVEL
//! out.ppm`.

use std::io::Write;
use terravision_common::database::{Database, TileScratch, TileSource, color_tile_bytes};
use terravision_common::node::NodeId;
use terravision_common::world::COLOR_BORDER;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [world, level, out] = arguments.as_slice() else {
        return Err("usage: level_picture WORLD LEVEL out.ppm".into());
    };
    let database = Database::open(world.as_ref())?;
    let (world, q) = (*database.world(), level.parse::<u8>()?);
    let [columns, rows] = world.nodes_at(q);
    let (side, stored, border) = (world.color_tile() as usize, world.color_stored() as usize, COLOR_BORDER as usize);
    let mut tile = vec![0u8; color_tile_bytes(&world)];
    let mut scratch = TileScratch::default();
    let width = columns as usize * side;
    let mut picture = vec![0u8; width * rows as usize * side * 3];
    for (m, n) in (0..rows).flat_map(|n| (0..columns).map(move |m| (m, n))) {
        let node = NodeId::new(m, n, q).ok_or("no such node")?;
        database.read_color(node, &mut tile, &mut scratch)?;
        for j in 0..side {
            let row = (rows - 1 - n) as usize * side + j;
            for i in 0..side {
                let from = ((j + border) * stored + i + border) * 4;
                let to = (row * width + m as usize * side + i) * 3;
                picture[to..to + 3].copy_from_slice(&tile[from..from + 3]);
            }
        }
    }
    let mut file = std::io::BufWriter::new(std::fs::File::create(out)?);
    write!(file, "P6\n{width} {}\n255\n", rows as usize * side)?;
    file.write_all(&picture)?;
    Ok(())
}

//! What the map shows live: the nodes whose tiles are in memory or wanted, and the ground that is
//! seen. Told to the clients that look at a map, a few times a second, when it has changed.

use super::Hub;
use super::flight_metrics::answer_at;
use crate::sight::Sight;
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Duration;

/// Between two looks.
const EVERY: Duration = Duration::from_millis(400);

/// Looks as long as the process lives and somebody looks at a map.
pub(crate) async fn watch(hub: Arc<Hub>) {
    loop {
        tokio::time::sleep(EVERY).await;
        if !hub.is_map_wanted() {
            continue;
        }
        let tiles = tiles(&hub).await;
        let seen = Arc::clone(&hub);
        // Some thousand depths are looked at.
        let Ok(outline) = tokio::task::spawn_blocking(move || outline(&seen)).await else { continue };
        let text = json!({"type": "map", "tiles": tiles, "footprint": outline}).to_string();
        hub.map.send_if_modified(|before| {
            let is_new = **before != *text;
            if is_new {
                *before = text.into();
            }
            is_new
        });
    }
}

/// Nodes as the flight tells of them; null while it does not.
async fn tiles(hub: &Hub) -> Value {
    let address = hub.flight.borrow().metrics;
    let Some(address) = address else { return Value::Null };
    let answer = answer_at(address, "/tiles").await;
    answer.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or(Value::Null)
}

/// The outline of the ground that the newest picture shows; null for none.
fn outline(hub: &Hub) -> Value {
    let Some(picture) = hub.pictures.borrow().clone() else { return Value::Null };
    let settings = hub.flight.borrow().settings.clone();
    let Ok(sight) = Sight::new(&picture, &settings, hub.terrain.crs_frame()) else { return Value::Null };
    // Decimetres, or about as much in degrees.
    let per_unit = if hub.terrain.is_geographic() { 1e6 } else { 10.0 };
    let round = |value: f64| (value * per_unit).round() / per_unit;
    let outline: Vec<[f64; 2]> = sight.outline().iter().map(|place| [round(place.x), round(place.y)]).collect();
    if outline.len() < 3 { Value::Null } else { json!(outline) }
}

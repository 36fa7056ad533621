//! The ground that a point of a picture shows.

use crate::hub::{Hub, Refusal};
use crate::picture::Scene;
use crate::sight::{Seen, Sight};

/// Pictures of a client that are remembered: it may point at one while the next is on its way.
const KEPT: usize = 8;

/// Which pictures a client was sent, by its numbers.
#[derive(Debug, Default)]
pub(super) struct SentPictures(std::collections::VecDeque<(u32, Scene, u64)>);

impl SentPictures {
    pub(super) fn note(&mut self, n: u32, scene: Scene, number: u64) {
        if self.0.len() >= KEPT {
            self.0.pop_front();
        }
        self.0.push_back((n, scene, number));
    }

    fn find(&self, n: u32) -> Option<(Scene, u64)> {
        self.0.iter().find(|sent| sent.0 == n).map(|sent| (sent.1, sent.2))
    }
}

/// What is seen, and whether in the picture that was meant.
pub(super) type Picked = (Option<Seen>, bool);

/// The ground at a point, from 0 to 1 from the upper left corner, of picture `n`; of the newest
/// where that is not known any more, or not said.
pub(super) fn pick(hub: &Hub, sent: &SentPictures, point: [f64; 2], n: Option<u32>) -> Result<Picked, Refusal> {
    if !point.iter().all(|share| (0.0..=1.0).contains(share)) {
        return Err(("malformed", format!("u, v: expected two numbers from 0 to 1, found {}, {}", point[0], point[1])));
    }
    let meant = n.and_then(|n| sent.find(n)).and_then(|(scene, number)| hub.recent.find(scene, number));
    let is_meant = meant.is_some();
    let Some(picture) = meant.or_else(|| hub.pictures.borrow().clone()) else {
        return Err(("no-picture", "there is no picture yet".into()));
    };
    let settings = hub.flight.borrow().settings.clone();
    let sight = Sight::new(&picture, &settings, hub.terrain.crs_frame());
    let sight = sight.map_err(|error| ("no-picture", error.to_string()))?;
    Ok((sight.at(point), is_meant))
}

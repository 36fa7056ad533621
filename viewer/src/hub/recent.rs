//! The last pictures: a client points at the one that it shows, which is seldom the newest.

use super::lock;
use crate::picture::{Picture, Scene};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

/// Pictures that are kept.
const KEPT: usize = 6;

/// The last pictures, the newest last.
#[derive(Debug, Default)]
pub(crate) struct Recent(Mutex<VecDeque<Arc<Picture>>>);

impl Recent {
    /// A picture has come; the one that leaves for it, if one does.
    pub(crate) fn note(&self, picture: Arc<Picture>) -> Option<Arc<Picture>> {
        let mut kept = lock(&self.0);
        // One of another flight has other settings: no picture is taken for one of those.
        kept.retain(|before| before.flight == picture.flight);
        kept.push_back(picture);
        if kept.len() > KEPT { kept.pop_front() } else { None }
    }

    /// A picture, or another one that shows the same.
    pub(crate) fn find(&self, scene: Scene, number: u64) -> Option<Arc<Picture>> {
        let kept = lock(&self.0);
        let of_scene = || kept.iter().rev().filter(|picture| picture.scene() == scene);
        of_scene().find(|picture| picture.number == number).or_else(|| of_scene().next()).cloned()
    }
}

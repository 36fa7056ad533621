//! Poses from another program: one record behind a sequence lock, newest wins (docs/frame-ring.md).
//!
//! The launcher creates the segment and reads the record ([`PoseInbox`]); the controlling program
//! writes it ([`PoseSender`], or a few lines in any language). Its content must be checked before
//! it is used as a pose.

use super::error::ShmError;
use super::named::{self, CAMERA, NamedSegment, SharedName};
use super::region::{Region, SharedWords};
use super::seqlock::SeqLock;
use super::size::{pack_size, unpack_size};
use crate::sync::{AtomicU64, Ordering, fence};

const RECORD_OFFSET: u64 = 64;
const ANSWERS_OFFSET: u64 = 256;
const TOTAL_BYTES: u64 = 4096;
const WORDS: usize = 10;
const IS_END: u64 = 1;

// SAFETY: atomics alone, repr(C), aligned to 8.
unsafe impl SharedWords for SeqLock<WORDS> {}

/// A pose from another program, unchecked. Degrees, metres, the database's CRS.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseRecord {
    /// Easting, northing and height of the eye.
    pub position: [f64; 3],
    /// Degrees clockwise from grid north.
    pub heading_deg: f64,
    /// Degrees up from the horizontal.
    pub pitch_deg: f64,
    /// Degrees clockwise.
    pub roll_deg: f64,
    /// Vertical field of view, degrees; 0: that of the flight.
    pub vfov_deg: f64,
    /// Time of the pose, seconds, in a monotonic clock of the sender.
    pub time_s: f64,
    /// Wanted width and height of its picture, pixels; zeros: those of the flight.
    pub size: [u32; 2],
    /// The end of the flight instead of a pose.
    pub is_end: bool,
}

impl PoseRecord {
    fn words(&self) -> [u64; WORDS] {
        let [x, y, z] = self.position;
        let numbers = [x, y, z, self.heading_deg, self.pitch_deg, self.roll_deg, self.vfov_deg, self.time_s];
        let mut words = [0; WORDS];
        for (word, number) in words.iter_mut().zip(numbers) {
            *word = number.to_bits();
        }
        words[WORDS - 2] = if self.is_end { IS_END } else { 0 };
        words[WORDS - 1] = pack_size(self.size);
        words
    }

    fn of([x, y, z, heading, pitch, roll, vfov, time, flags, size]: [u64; WORDS]) -> Self {
        Self {
            position: [x, y, z].map(f64::from_bits),
            heading_deg: f64::from_bits(heading),
            pitch_deg: f64::from_bits(pitch),
            roll_deg: f64::from_bits(roll),
            vfov_deg: f64::from_bits(vfov),
            time_s: f64::from_bits(time),
            size: unpack_size(size),
            is_end: flags & IS_END != 0,
        }
    }
}

/// Answers of the launcher to the sender.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PoseAnswers {
    /// Records that became frames.
    pub accepted: u64,
    /// Records that were refused.
    pub refused: u64,
    /// Counter of the record that was read last.
    pub looked_at: u64,
}

/// The launcher's end, which creates the segment and removes it when dropped.
#[derive(Debug)]
pub struct PoseInbox {
    segment: NamedSegment,
    seen: u64,
}

impl PoseInbox {
    /// Creates the segment of this name.
    ///
    /// # Errors
    /// [`ShmError::NameTaken`] while another run has the name.
    pub fn create(name: &SharedName) -> Result<Self, ShmError> {
        Ok(Self { segment: NamedSegment::create(&name.camera_file(), CAMERA, TOTAL_BYTES, |_| {})?, seen: 0 })
    }

    /// Its name below `/dev/shm`.
    #[must_use]
    pub fn file(&self) -> &str {
        self.segment.name()
    }

    /// The newest record, if it is new and none is being written. Does not wait.
    ///
    /// # Errors
    /// [`ShmError::CutShort`]: another program has truncated the file.
    pub fn read(&mut self) -> Result<Option<PoseRecord>, ShmError> {
        // The sequence lock of [`SeqLock::read_numbered`], its loads made by the kernel.
        let file = &self.segment.file;
        let [before] = file.read_words(RECORD_OFFSET)?;
        if before == self.seen || !before.is_multiple_of(2) {
            return Ok(None);
        }
        // SYNC seqlock.end: the words of the record come after its counter.
        fence(Ordering::Acquire);
        let words = file.read_words::<WORDS>(RECORD_OFFSET + 8)?;
        // SYNC seqlock.begin.
        fence(Ordering::Acquire);
        if file.read_words(RECORD_OFFSET)? != [before] {
            return Ok(None);
        }
        self.seen = before;
        Ok(Some(PoseRecord::of(words)))
    }

    /// Answers the sender: how many records were accepted and refused.
    ///
    /// # Errors
    /// [`ShmError::CutShort`]: another program has truncated the file.
    pub fn answer(&self, accepted: u64, refused: u64) -> Result<(), ShmError> {
        let file = &self.segment.file;
        file.write_words(ANSWERS_OFFSET, &[accepted, refused])?;
        // SYNC poses.answers: the counts come before.
        fence(Ordering::Release);
        file.write_words(ANSWERS_OFFSET + 16, &[self.seen])?;
        file.check_len()
    }
}

/// The sender's end. One at a time; another one continues from the current counter.
#[derive(Debug)]
pub struct PoseSender {
    region: Region,
}

impl PoseSender {
    /// Opens the segment of this name.
    ///
    /// # Errors
    /// It does not exist, or has another kind or version.
    pub fn open(name: &SharedName) -> Result<Self, ShmError> {
        let file = name.camera_file();
        let region = named::open(&file, CAMERA, true)?;
        if region.len() < TOTAL_BYTES {
            return Err(ShmError::TooSmall { name: file, needed: TOTAL_BYTES, found: region.len() });
        }
        Ok(Self { region })
    }

    /// Replaces the record. Returns its counter, which [`PoseAnswers::looked_at`] reaches.
    pub fn send(&self, record: &PoseRecord) -> u64 {
        let lock: &SeqLock<WORDS> = self.region.words(RECORD_OFFSET);
        lock.write(&record.words());
        lock.counter()
    }

    /// The record that was sent last, by this sender or one before it; `None` before the first, or
    /// while one is being replaced.
    #[must_use]
    pub fn newest(&self) -> Option<PoseRecord> {
        let lock: &SeqLock<WORDS> = self.region.words(RECORD_OFFSET);
        lock.read().map(PoseRecord::of)
    }

    /// The last answers of the launcher.
    #[must_use]
    pub fn answers(&self) -> PoseAnswers {
        let words: &[AtomicU64] = self.region.words_slice(ANSWERS_OFFSET, 3);
        let [accepted, refused, looked_at] = words else { return PoseAnswers::default() };
        // Acquire: SYNC poses.answers.
        let looked_at = looked_at.load(Ordering::Acquire);
        PoseAnswers { accepted: accepted.load(Ordering::Relaxed), refused: refused.load(Ordering::Relaxed), looked_at }
    }

    /// Whether the flight has ended in order.
    #[must_use]
    pub fn is_ended(&self) -> bool {
        named::is_ended(&self.region)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_record_is_read_once_and_answered() {
        let name = SharedName::parse(&format!("unit-poses-{}", std::process::id())).unwrap();
        let mut inbox = PoseInbox::create(&name).unwrap();
        assert_eq!(inbox.read().unwrap(), None);
        let sender = PoseSender::open(&name).unwrap();
        assert_eq!(sender.newest(), None);
        let mut record = PoseRecord {
            position: [1.0, 2.0, 3.0],
            heading_deg: 4.0,
            pitch_deg: -5.0,
            roll_deg: 6.0,
            vfov_deg: 0.0,
            time_s: 7.5,
            size: [640, 360],
            is_end: false,
        };
        sender.send(&record);
        record.time_s = 8.0;
        let counter = sender.send(&record);
        assert_eq!(inbox.read().unwrap(), Some(record));
        assert_eq!(inbox.read().unwrap(), None);
        inbox.answer(1, 0).unwrap();
        assert_eq!(sender.answers(), PoseAnswers { accepted: 1, refused: 0, looked_at: counter });
        record.is_end = true;
        // Another sender continues.
        assert_eq!(PoseSender::open(&name).unwrap().newest().map(|newest| newest.time_s), Some(8.0));
        PoseSender::open(&name).unwrap().send(&record);
        assert_eq!(inbox.read().unwrap(), Some(record));
        assert!(!sender.is_ended());
        drop(inbox);
        assert!(sender.is_ended() && PoseSender::open(&name).is_err());
    }

    /// A mapping of the file would end the process here.
    #[test]
    fn an_inbox_that_is_cut_is_an_error() {
        let name = SharedName::parse(&format!("unit-poses-cut-{}", std::process::id())).unwrap();
        let mut inbox = PoseInbox::create(&name).unwrap();
        let path = format!("/dev/shm/{}", inbox.file());
        let file = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
        file.set_len(70).unwrap();
        assert!(matches!(inbox.read(), Err(ShmError::CutShort { found: 70, expected: TOTAL_BYTES, .. })));
        file.set_len(0).unwrap();
        assert!(matches!(inbox.read(), Err(ShmError::CutShort { found: 0, .. })));
        assert!(matches!(inbox.answer(1, 2), Err(ShmError::CutShort { .. })));
        drop(inbox);
        assert!(!std::path::Path::new(&path).exists());
    }
}

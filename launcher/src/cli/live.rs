//! How other programs take part in a flight, as typed.

use crate::input::CameraSource;
use clap::Args;

/// How other programs take part in a flight.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = "Other programs (docs/frame-ring.md)")]
pub struct LiveArgs {
    /// Also put every frame into shared memory, /dev/shm/terravision-NAME, where other programs can
    /// read it
    #[arg(long, value_name = "NAME")]
    pub share: Option<String>,
    /// Draw a frame for each pose that another program sends, in place of a path
    ///
    /// shm:NAME reads them from shared memory, /dev/shm/terravision-NAME-camera; udp:127.0.0.1:PORT
    /// reads lines of JSON. The flight ends when the sender says so, at Ctrl-C, or after
    /// --idle-timeout.
    #[arg(long, value_name = "shm:NAME|udp:ADDRESS", conflicts_with_all = ["path", "frames", "agl", "speed", "rests", "eye", "look_at", "from", "heading", "pitch", "roll", "lonlat", "around", "radius", "height", "turns"])]
    pub camera: Option<CameraSource>,
    /// End the flight when no pose has come for this many seconds [default: never]
    #[arg(long, value_name = "SECONDS", requires = "camera")]
    pub idle_timeout: Option<f64>,
}

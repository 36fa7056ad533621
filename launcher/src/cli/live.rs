//! How other programs take part in a flight, as typed.

use crate::input::CameraSource;
use clap::Args;

/// How other programs take part in a flight.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = "Other programs (docs/frame-ring.md)")]
pub struct LiveArgs {
    /// Also put every frame into shared memory, /dev/shm/terravision-NAME, where any number of programs read it
    #[arg(long, value_name = "NAME")]
    pub share: Option<String>,
    /// Fly the poses that another program sends, one frame for each, in place of a path
    ///
    /// shm:NAME is a record in shared memory, /dev/shm/terravision-NAME-camera; udp:127.0.0.1:PORT takes JSON lines.
    /// The flight ends when the sender says so, at Ctrl-C, or after --idle-timeout.
    #[arg(long, value_name = "shm:NAME|udp:ADDRESS", conflicts_with_all = ["path", "frames", "agl", "speed", "rests", "eye", "look_at", "from", "heading", "pitch", "roll", "lonlat", "around", "radius", "height", "turns"])]
    pub camera: Option<CameraSource>,
    /// End the flight when no pose has come for so many seconds [default: wait for ever]
    #[arg(long, value_name = "SECONDS", requires = "camera")]
    pub idle_timeout: Option<f64>,
}

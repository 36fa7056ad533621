//! Questions on a Unix socket: requests of JSON, a line each, of several clients.

use super::lines::{Line, Lines, too_long};
use super::question::{Asker, Terms};
use super::request;
use crate::failure::Failure;
use crate::path::crs::Transform;
use crate::process::interrupt;
use anyhow::{Context, anyhow};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::Mode;
use std::fs;
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::FileTypeExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Duration;
use terravision_common::ground::GroundTiles;
use terravision_common::terminal::complain;

/// Clients at a time.
const MOST_CLIENTS: usize = 64;
/// How often a wait looks whether Ctrl-C has come.
const TICK: Duration = Duration::from_millis(100);
/// A client that takes nothing of its answer for this long is left.
const LONGEST_WRITE: Duration = Duration::from_secs(10);

/// The socket's file, removed when it is dropped.
struct SocketFile<'a>(&'a Path);

impl Drop for SocketFile<'_> {
    fn drop(&mut self) {
        fs::remove_file(self.0).ok();
    }
}

/// Answers clients until Ctrl-C.
///
/// # Errors
/// Bad input: the socket cannot be made.
pub(super) fn listen(
    path: &Path,
    tiles: &GroundTiles<'_>,
    transform: Option<&Transform>,
    terms: &Terms,
) -> Result<(), Failure> {
    interrupt::listen().context("cannot listen for Ctrl-C").map_err(Failure::failed)?;
    let listener = bind(path).map_err(Failure::bad_input)?;
    let file = SocketFile(path);
    listener.set_nonblocking(true).context("cannot listen").map_err(Failure::failed)?;
    let mut out = io::stdout().lock();
    writeln!(out, "{}", path.display())
        .and_then(|()| out.flush())
        .context("cannot write to standard output")
        .map_err(Failure::failed)?;
    let clients = AtomicUsize::new(0);
    thread::scope(|scope| {
        while !interrupt::is_interrupted() {
            wait(&listener);
            let client = match listener.accept() {
                Ok((client, _)) => client,
                Err(error) => {
                    if !matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) {
                        complain(&format!("terravision: warning: a client was not let in: {error}"));
                        thread::sleep(TICK);
                    }
                    continue;
                }
            };
            if clients.load(Ordering::Relaxed) >= MOST_CLIENTS {
                refuse(client, &format!("{MOST_CLIENTS} clients are connected already; try again later"));
                continue;
            }
            clients.fetch_add(1, Ordering::Relaxed);
            let clients = &clients;
            let serve = move || {
                // A client that goes away is no error of ours.
                serve(&client, tiles, transform, terms).unwrap_or_else(|error| {
                    tracing::debug!(%error, "a client has gone");
                });
                clients.fetch_sub(1, Ordering::Relaxed);
            };
            if let Err(error) = thread::Builder::new().name("client".into()).spawn_scoped(scope, serve) {
                clients.fetch_sub(1, Ordering::Relaxed);
                complain(&format!("terravision: warning: a client was not let in, there is no thread: {error}"));
            }
        }
        // New clients find nobody from now on; those that are connected leave within a tick.
        drop(file);
    });
    Ok(())
}

/// The socket, which only this user may use. One that a killed program has left is replaced.
fn bind(path: &Path) -> anyhow::Result<UnixListener> {
    let shown = path.display();
    match fs::symlink_metadata(path) {
        Ok(about) if !about.file_type().is_socket() => {
            return Err(anyhow!("--listen: {shown} exists and is not a socket; name another path"));
        }
        Ok(_) if UnixStream::connect(path).is_ok() => {
            return Err(anyhow!("--listen: another program listens on {shown}; name another path, or end it"));
        }
        Ok(_) => fs::remove_file(path).with_context(|| format!("--listen: cannot replace {shown}"))?,
        Err(_) => {}
    }
    // No other thread makes files yet.
    let before = rustix::process::umask(Mode::from_raw_mode(0o177));
    let bound = UnixListener::bind(path);
    rustix::process::umask(before);
    bound.with_context(|| format!("--listen: cannot make the socket {shown}, a path of at most 107 bytes in a folder"))
}

/// Waits until a client comes, a tick at most.
fn wait(listener: &UnixListener) {
    let mut polled = [PollFd::new(listener, PollFlags::IN)];
    let tick = Timespec { tv_sec: 0, tv_nsec: TICK.subsec_nanos().into() };
    // Interrupted by a signal it just looks earlier.
    poll(&mut polled, Some(&tick)).ok();
}

fn refuse(mut client: UnixStream, sentence: &str) {
    client.set_write_timeout(Some(TICK)).ok();
    client.write_all(&request::refusal(sentence)).ok();
}

/// Answers a client until it leaves.
fn serve(client: &UnixStream, tiles: &GroundTiles<'_>, transform: Option<&Transform>, terms: &Terms) -> io::Result<()> {
    client.set_nonblocking(false)?;
    client.set_read_timeout(Some(TICK))?;
    client.set_write_timeout(Some(LONGEST_WRITE))?;
    let (mut asker, mut lines) = (Asker::new(tiles, transform), Lines::new(client));
    let mut answers = Vec::new();
    while !interrupt::is_interrupted() {
        let mut is_too_long = false;
        let read = lines.next_batch(|batch| {
            for line in batch {
                match line {
                    Line::Whole(text) if text.trim_ascii().is_empty() => {}
                    Line::Whole(text) => request::answer(&mut asker, terms, text, &mut answers),
                    Line::TooLong => is_too_long = true,
                }
            }
        });
        // Its client is not waited for until it has sent the rest.
        is_too_long |= lines.is_too_long();
        if is_too_long {
            answers.extend(request::refusal(&too_long()));
        }
        let has_more = match read {
            Ok(has_more) => has_more,
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => continue,
            Err(error) => return Err(error),
        };
        let mut out = *lines.input();
        out.write_all(&answers)?;
        answers.clear();
        if is_too_long || !has_more {
            break;
        }
    }
    Ok(())
}

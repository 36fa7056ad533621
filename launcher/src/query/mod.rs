//! `terravision query`: questions to a world's ground, by lines of standard input or on a Unix
//! socket (docs/query.md).
//!
//! * [`lines`]: whole lines of a stream, as they come. [`text`], [`request`]: two languages of
//!   lines. [`question`]: what is asked, and the answers. [`listen`]: the socket.

mod lines;
mod listen;
mod question;
mod request;
mod text;

use crate::cli::query::{InterpolationChoice, QueryArgs, QueryCrs};
use crate::failure::{ExitStatus, Failure};
use crate::path::crs::Transform;
use crate::plan::georeference;
use crate::world::open_world;
use anyhow::{Context, anyhow};
use lines::{Line, Lines};
use question::{Asker, MOST_RADIUS_M, Question, Terms};
use std::io::{self, ErrorKind, Write};
use terravision_common::database::TileError;
use terravision_common::ground::{GroundTiles, Interpolation};
use terravision_common::terminal::complain;

/// Answers until the input ends, or Ctrl-C.
///
/// # Errors
/// Bad input: no database, a flag out of range, a socket that cannot be listened on. Tiles that
/// could not be read. Standard input or output fails.
pub fn query(args: &QueryArgs) -> Result<(), Failure> {
    let terms = terms(args)?;
    let database = open_world(&args.world, &args.database)?;
    let georeference = georeference(&database);
    let transform = match (georeference.from_lonlat(), terms.is_lonlat) {
        (Ok(transform), _) => Some(transform),
        (Err(error), true) => return Err(Failure::bad_input(error)),
        // Who asks for it later is told.
        (Err(_), false) => None,
    };
    if terms.is_lonlat {
        let doubts = georeference.take_doubts();
        doubts.iter().for_each(|doubt| complain(&format!("terravision: warning: {doubt}")));
    }
    let most_bytes = usize::try_from(args.memory.0).unwrap_or(usize::MAX);
    let tiles = GroundTiles::new(&database, database.world(), most_bytes).bounded(database.ranges());
    match &args.listen {
        Some(path) => listen::listen(path, &tiles, transform.as_ref(), &terms)?,
        None => answer_input(&tiles, transform.as_ref(), &terms)?,
    }
    match tiles.take_failures() {
        None => Ok(()),
        Some((count, first)) => {
            Err(Failure { status: ExitStatus::TilesUnavailable, error: anyhow!("{}", unread(count, &first)) })
        }
    }
}

/// The sentence about tiles that could not be read.
fn unread(count: u64, first: &TileError) -> String {
    match count {
        1 => format!("1 tile could not be read, and a coarser one was taken: {first}"),
        _ => format!("{count} tiles could not be read, and coarser ones were taken; the first: {first}"),
    }
}

fn terms(args: &QueryArgs) -> Result<Terms, Failure> {
    let question = match args.sphere {
        Some(radius) if radius > 0.0 && radius <= MOST_RADIUS_M => Question::Sphere(radius),
        Some(radius) => {
            return Err(Failure::bad_input(anyhow!(
                "--sphere is {radius}: expected a radius in metres, more than 0 and at most {MOST_RADIUS_M}"
            )));
        }
        None if args.sight => Question::Sight,
        None => Question::Height,
    };
    let interpolation = match args.interpolation {
        InterpolationChoice::Bilinear => Interpolation::Bilinear,
        InterpolationChoice::Facet => Interpolation::Facet,
    };
    Ok(Terms { question, interpolation, is_lonlat: args.crs == QueryCrs::Lonlat, is_agl: args.agl })
}

/// Answers the lines of standard input, as many at a time as have come.
fn answer_input(tiles: &GroundTiles<'_>, transform: Option<&Transform>, terms: &Terms) -> Result<(), Failure> {
    let mut asker = Asker::new(tiles, transform);
    let mut lines = Lines::new(io::stdin().lock());
    let (mut out, mut answers) = (io::stdout().lock(), Vec::new());
    loop {
        let has_more = lines
            .next_batch(|batch| answer_batch(&mut asker, terms, batch, &mut answers))
            .context("cannot read standard input")
            .map_err(Failure::failed)?;
        match out.write_all(&answers).and_then(|()| out.flush()) {
            Ok(()) => answers.clear(),
            // Their reader wants no more of them: head, say.
            Err(error) if error.kind() == ErrorKind::BrokenPipe => return Ok(()),
            Err(error) => return Err(error).context("cannot write to standard output").map_err(Failure::failed),
        }
        if !has_more {
            return Ok(());
        }
    }
}

/// Answers a batch of lines: text in one go, and requests one by one, in order.
fn answer_batch(asker: &mut Asker<'_>, terms: &Terms, batch: &[Line<'_>], out: &mut Vec<u8>) {
    let is_request = |line: &Line<'_>| matches!(line, Line::Whole(text) if text.trim_ascii_start().starts_with(b"{"));
    for group in batch.chunk_by(|a, b| !is_request(a) && !is_request(b)) {
        match group {
            [Line::Whole(text)] if is_request(&group[0]) => request::answer(asker, terms, text, out),
            _ => {
                let given = group.iter().map(|line| match line {
                    Line::Whole(text) => text::parse(text, terms),
                    Line::TooLong => Err(lines::too_long()),
                });
                text::answer(asker, terms, given.collect(), out);
            }
        }
    }
}

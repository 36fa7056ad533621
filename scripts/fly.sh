#!/usr/bin/env bash
# From nothing to a film: installs what is missing, builds, makes the default world, ingests it, flies around its highest
# mountains. With --serve it serves the world to web browsers instead: the address to open is the last line, Ctrl-C ends it.
# Everything lands under out/. A second run reuses what is there; delete a file or folder to have it made anew.
#
#   TERRAVISION_SIZE    posts along a side of the world (4096)
#   TERRAVISION_FRAMES  frames of the film (240)
#   TERRAVISION_PICTURE width and height of the picture (1280x720)
#   TERRAVISION_OUT     where everything lands (out)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

if [[ $# -gt 1 || ($# == 1 && $1 != --serve) ]]; then
  printf 'usage: scripts/fly.sh [--serve]\n' >&2
  exit 2
fi

readonly SIZE=${TERRAVISION_SIZE:-4096}
readonly FRAMES=${TERRAVISION_FRAMES:-240}
readonly PICTURE=${TERRAVISION_PICTURE:-1280x720}
readonly OUT=${TERRAVISION_OUT:-out}

say() { printf '\n== %s\n' "$*" >&2; }

scripts/setup.sh
PATH=$HOME/.cargo/bin:$PATH

say 'building (the first time takes some minutes)'
# Where there is a display, terravision view opens a window on it.
features=()
[[ -n ${DISPLAY:-}${WAYLAND_DISPLAY:-} ]] && features=(--features window)
cargo build --release --locked --bins "${features[@]}"
target=${CARGO_TARGET_DIR:-target}/release
terravision=$target/terravision

mkdir -p "$OUT"
source=$OUT/world-$SIZE
world=$OUT/world-$SIZE.tv
if [[ ! -f $source/.complete ]]; then
  say "making a world of $SIZE x $SIZE posts: $source"
  "$terravision" synth -o "$source" --size "$SIZE" --overwrite
  touch "$source/.complete"
fi
# The manifest is the last thing that an ingest writes.
if [[ ! -f $world/manifest.json || $world/manifest.json -ot $source/.complete ]]; then
  say "ingesting it: $world"
  "$terravision" ingest --elevation "$source/dem.tif" --color "$source/ortho.tif" -o "$world" --overwrite
fi

if [[ ${1:-} == --serve ]]; then
  say "serving it: open this address in a browser"
  exec "$terravision" serve "$world"
fi

# Is $1 there, and newer than the world and the programs that made it?
is_fresh() {
  local program
  [[ -e $1 && $1 -nt $world/manifest.json ]] || return 1
  for program in terravision terravision-generator terravision-prefetcher terravision-preparer terravision-renderer; do
    [[ $1 -nt $target/$program ]] || return 1
  done
}

film=$OUT/orbit-$SIZE-$PICTURE-$FRAMES.mp4
report=${film%.mp4}.json
if is_fresh "$film" && is_fresh "$report"; then
  say "the film is there: $film"
else
  say "flying $FRAMES frames: $film"
  "$terravision" fly "$world" --path orbit --frames "0..$FRAMES" --size "$PICTURE" -o "$film" --report "$report"
fi

stills=$OUT/stills-$SIZE-$PICTURE
if ! is_fresh "$stills/.complete"; then
  say "drawing four stills at the best quality: $stills"
  mkdir -p "$stills"
  for frame in 0 60 120 180; do
    "$terravision" fly "$world" --path orbit --frames "$frame..$((frame + 1))" --size "$PICTURE" --quality best --quiet -o "$stills/"
  done
  touch "$stills/.complete"
fi

sheet=$OUT/contact-sheet-$SIZE-$PICTURE-$FRAMES.png
if ! is_fresh "$sheet" || [[ $sheet -ot $film ]]; then
  say "a contact sheet of the film: $sheet"
  # Twenty pictures, evenly spread; fewer when the film has fewer.
  every=$(((FRAMES + 19) / 20))
  ffmpeg -hide_banner -loglevel error -y -i "$film" \
    -vf "select=not(mod(n\\,$every)),scale=320:-2,tile=5x4:padding=4:color=black" -frames:v 1 -update 1 "$sheet"
fi

# The figures of the report, without a JSON tool: one key a line.
figure() { sed -n "s/^ *\"$1\": //p" "$report" | head -n 1 | sed 's/,$//; s/^"//; s/"$//'; }
stage() { sed -n "/^  \"stages\"/,/^  }/p" "$report" | sed -n "/\"$1\"/,/}/s/^ *\"ms_median\": \([0-9.]*\).*/\1/p"; }

absolute() { printf '%s' "$(cd "$(dirname "$1")" && pwd)/$(basename "$1")"; }
printf '\nfilm           %s\nstills         %s\ncontact sheet  %s\nreport         %s\n\n' \
  "$(absolute "$film")" "$(absolute "$stills")/" "$(absolute "$sheet")" "$(absolute "$report")"
printf 'drawn by       %s (%s), %s, %s\n' "$(figure technique)" "$(figure technique_reason)" "$(figure device)" "$(figure driver)"
printf 'flight         %.0f frames at %s, %.1f frames/s, %.1f s to the first frame, settled: %s\n' \
  "$(figure frames)" "$PICTURE" "$(figure fps)" "$(figure time_to_first_frame_s)" "$(figure settled)"
printf 'frame          median %.1f ms, 99 %% below %.1f ms, worst %.1f ms\n' \
  "$(figure frame_ms_median)" "$(figure frame_ms_p99)" "$(figure frame_ms_max)"
printf 'stages         generator %.2f ms, preparer %.2f ms, renderer %.2f ms a frame (medians)\n' \
  "$(stage generator)" "$(stage preparer)" "$(stage renderer)"
printf 'load           %.0f nodes of the tree a frame (median), %.0f tiles loaded, %.0f MB of memory in all\n' \
  "$(figure nodes_median)" "$(figure loaded)" "$(figure all)"

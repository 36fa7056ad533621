#!/usr/bin/env bash
# Holds a frame rate while a process takes a core away: a flight against the clock at 60 % of what this machine reaches,
# with feedback and without, two minutes each. Prints a table and a summary line, draws
# out/realtime/realtime.svg; the whole fails when a target is missed.
#
#   scripts/realtime.sh           the whole: about six minutes, on a machine that does nothing else
#   scripts/realtime.sh --short   20 s each, for tests: that it runs, not how well
#
#   TERRAVISION_WORLD   fly over this database (a synthetic one, made once)
#   TERRAVISION_OUT     where the plot lands (out)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

arguments=()
case ${1:-} in
  '') arguments+=(--strict) ;;
  --short) arguments+=(--seconds 20 --load-seconds 4 --size 640x360 --world-size 1024) ;;
  *)
    printf 'usage: scripts/realtime.sh [--short]\n' >&2
    exit 2
    ;;
esac
if [[ -n ${TERRAVISION_WORLD:-} ]]; then
  arguments+=(--world "$TERRAVISION_WORLD")
fi

scripts/setup.sh
PATH=$HOME/.cargo/bin:$PATH
cargo build --release --locked --bins
exec "${CARGO_TARGET_DIR:-target}/release/terravision" bench realtime "${arguments[@]}" -o "${TERRAVISION_OUT:-out}/realtime"

#!/usr/bin/env bash
# What prediction gains over a slow link: one fast flight (straight ahead, turns, a stop) against the clock over a database behind
# 20 Mbit/s and 80 ms, with each prediction, each time from a cold cache. Prints a table and a summary line, draws out/link/link.svg; the
# whole fails when a target is missed.
#
#   scripts/link.sh           the whole: five minutes, on a machine that does nothing else
#   scripts/link.sh --short   12 s each: that it runs, not how well
#
#   TERRAVISION_WORLD   fly over this database (a synthetic one, made once)
#   TERRAVISION_OUT     where the plot lands (out)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

arguments=(--size 640x360)
case ${1:-} in
  '') arguments+=(--world-size 4096 --strict) ;;
  --short) arguments+=(--seconds 12 --world-size 1024) ;;
  *)
    printf 'usage: scripts/link.sh [--short]\n' >&2
    exit 2
    ;;
esac
if [[ -n ${TERRAVISION_WORLD:-} ]]; then
  arguments+=(--world "$TERRAVISION_WORLD")
fi

scripts/setup.sh
PATH=$HOME/.cargo/bin:$PATH
cargo build --release --locked --bins
exec "${CARGO_TARGET_DIR:-target}/release/terravision" bench link "${arguments[@]}" -o "${TERRAVISION_OUT:-out}/link"

#!/usr/bin/env bash
# Half an hour of flight at random over a world far larger than memory, in --memory 1GiB: resident memory and open files, sampled
# every five seconds, have to stay as they are. Prints a table and a summary line, draws
# out/long-run/long-run.svg; the whole fails when a target is missed.
#
#   scripts/long_run.sh           the whole; makes the world first: 21.4 GB on disk, seven minutes of a core
#   scripts/long_run.sh --short   half a minute over a small world, for tests
#
#   TERRAVISION_WORLD   fly over this database
#   TERRAVISION_NODES   else over one of this many nodes a side (1024, which are 164 km; 64 in the short form). Bytes go with the square
#   TERRAVISION_OUT     where world and plot land (out)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

out=${TERRAVISION_OUT:-out}
nodes=1024
arguments=(--size 640x360 --memory-mib 1024)
case ${1:-} in
  '') arguments+=(--strict) ;;
  --short)
    nodes=64
    arguments=(--size 320x180 --memory-mib 256 --seconds 30)
    ;;
  *)
    printf 'usage: scripts/long_run.sh [--short]\n' >&2
    exit 2
    ;;
esac
nodes=${TERRAVISION_NODES:-$nodes}

scripts/setup.sh
PATH=$HOME/.cargo/bin:$PATH
cargo build --release --locked --bins
target=${CARGO_TARGET_DIR:-target}/release
world=${TERRAVISION_WORLD:-$out/long-run-$nodes.tv}
if [[ ! -f $world/manifest.json ]]; then
  mkdir -p "$out"
  "$target/terravision-ingest" sparse --bulk --detailed-nodes "$nodes" --texels-per-post 8 -o "$world"
fi
exec "$target/terravision" bench long-run "${arguments[@]}" --world "$world" -o "$out/long-run"

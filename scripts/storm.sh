#!/usr/bin/env bash
# Storms over a flight against the clock, while a reader of its frame ring watches; a summary line each (docs/supervision.md).
#
#   scripts/storm.sh [death|bytes|all] [--short]
#
#   death    kills a stage at random every 2 s for 3 minutes
#   bytes    writes random bytes over the heads of rings, trees, pools and the frame ring, in 45 flights of 4 s
#   --short  some 15 s each: what the tests do
#
# The programs are built with checks of bounds and overflows (the dev profile, which is optimised).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

scripts/setup.sh
PATH=$HOME/.cargo/bin:$PATH
cargo build --locked --bins
exec cargo run --quiet --locked -p terravision-tests --example storm -- "$@"

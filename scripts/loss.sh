#!/usr/bin/env bash
# Flies against the clock while a link loses 30 % of all requests, damages 5 %, delays 5 % by 5 s, and the server is gone for
# 20 s; looks at every texel of every frame. Prints a summary line, and fails when a texel is wrong, when there is a hole, when
# frames stop (in the whole: when less than 95 % are on time), or when the picture is not what it should be afterwards.
#
#   scripts/loss.sh           two minutes
#   scripts/loss.sh --short   16 s, as the tests run it
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

case ${1:-} in
  '') export TERRAVISION_STORM_S=120 TERRAVISION_GONE_S=20 ;;
  --short) ;;
  *)
    printf 'usage: scripts/loss.sh [--short]\n' >&2
    exit 2
    ;;
esac

scripts/setup.sh --tests
PATH=$HOME/.cargo/bin:$PATH
output=$(cargo test --locked -p terravision-tests --test loss -- --nocapture 2>&1) || {
  printf '%s\n' "$output" >&2
  exit 1
}
grep '^loss: ' <<<"$output"

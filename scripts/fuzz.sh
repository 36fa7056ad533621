#!/usr/bin/env bash
# Gives every reader of foreign bytes changed inputs, SECONDS each (60 unless told), from a new seed: the long form of what the test
# suite does in a moment (tests/tests/fuzz). Inputs that break a reader are kept under target/, and named.
#
#   scripts/fuzz.sh [SECONDS] [NAME]   NAME: only targets with this in their name, e.g. `database::` or `kml`
#   TERRAVISION_FUZZ_SEED=N            the inputs of another run again, in the same order
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

seconds=${1:-60} name=${2:-}
if ! [[ $seconds =~ ^[1-9][0-9]*$ ]]; then
  printf 'usage: scripts/fuzz.sh [SECONDS] [NAME]\n' >&2
  exit 2
fi

scripts/setup.sh --tests
PATH=$HOME/.cargo/bin:$PATH
export TERRAVISION_FUZZ_SEED=${TERRAVISION_FUZZ_SEED:-$RANDOM}

cargo test --locked --workspace --no-run --test fuzz --lib
TERRAVISION_FUZZ_SECONDS=$seconds cargo test --locked --workspace --test fuzz -- --show-output "$name" |
  grep -E '^[a-z-]+: [0-9]+ inputs|^test |panicked|is kept|^error'

# Segments of a run are fuzzed beside the code that reads them. Rounds of new cases, as long as all of that takes.
if [[ -z $name || segments == *"$name"* ]]; then
  end=$((SECONDS + seconds)) rounds=0
  while ((SECONDS < end)); do
    env -u PROPTEST_RNG_SEED PROPTEST_CASES=2000 cargo test --quiet --locked --workspace --lib shm::tests::garbage >/dev/null
    rounds=$((rounds + 1))
  done
  printf 'segments: %d rounds of 2000 cases each\n' "$rounds"
fi

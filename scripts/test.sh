#!/usr/bin/env bash
# Installs what is missing, then runs all tests, and the models of the shared-memory algorithms under loom. Arguments go to
# cargo test, e.g. scripts/test.sh -p terravision; with `loom` alone only the models are run.
#
#   TERRAVISION_DATA  folder of real data sets; tests of real data say so and pass when it is not set
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

scripts/setup.sh --tests
PATH=$HOME/.cargo/bin:$PATH

# The dev profile is optimised: it builds twice as fast as release, and checks for overflows.
# Test programs run one after the other, their tests side by side.
if [[ $* != loom ]]; then
  cargo test --locked "${@:---workspace}"
fi
# The models have a folder of their own: their flags would have everything built anew.
if [[ $# == 0 || $* == loom ]]; then
  RUSTFLAGS="--cfg loom" CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-target}/loom \
    cargo test --locked -p terravision-common --lib --release loom_
fi

#!/usr/bin/env bash
# Installs what is missing, then runs all tests. Arguments go to cargo test, e.g. scripts/test.sh -p terravision.
#
#   TERRAVISION_DATA  folder of real data sets; tests of real data say so and pass when it is not set
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

scripts/setup.sh --tests
PATH=$HOME/.cargo/bin:$PATH

# The dev profile is optimised: it builds twice as fast as release, and checks for overflows.
# Test programs run one after the other, their tests side by side.
if (($# == 0)); then
  set -- --workspace
fi
exec cargo test --locked "$@"

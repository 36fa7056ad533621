#!/usr/bin/env bash
# Installs what is missing, then runs all tests, and the models of the shared-memory algorithms under loom. Arguments go to
# cargo test, e.g. scripts/test.sh -p terravision; with `loom` alone only the models are run, with `page` alone only the tests of
# the viewer's page in a browser.
#
#   --repeat N     runs the tests (not the models) N times, whatever fails, and says at the end which tests failed, and how often;
#                  the output of each round is kept in target/repeat/
#   --under-load   with a busy loop for each core beside it: a test must not depend on who is faster
#
#   TERRAVISION_NEEDS_BROWSER=1  fails when there is no browser, or no node, for the tests of the page, or no Xvfb or Weston for those
#                  of the window; without it they are left out
#   TERRAVISION_DATA  folder of real data sets; tests of real data say so and pass when it is not set
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

repeats=0 has_load=
while [[ ${1:-} == --repeat || ${1:-} == --under-load ]]; do
  if [[ $1 == --under-load ]]; then
    has_load=1
  elif [[ ${2:-} =~ ^[1-9][0-9]*$ ]]; then
    repeats=$2
    shift
  else
    printf 'usage: scripts/test.sh [--repeat N] [--under-load] [ARGUMENTS OF cargo test | loom]\n' >&2
    exit 2
  fi
  shift
done

scripts/setup.sh --tests
PATH=$HOME/.cargo/bin:$PATH

load=()
end_load() {
  # Only what was started here.
  if ((${#load[@]} > 0)); then
    kill "${load[@]}" 2>/dev/null || true
    wait "${load[@]}" 2>/dev/null || true
    load=()
  fi
}
trap end_load EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

begin_load() {
  if [[ -n $has_load ]]; then
    for ((core = $(nproc); core > 0; core--)); do
      (while :; do :; done) &
      load+=($!)
    done
  fi
}

# The names of the tests that failed according to the output $1 of cargo test, each once.
failed_in() { sed -n '/^failures:$/,/^test result:/s/^    \([A-Za-z_0-9:]\+\)$/\1/p' "$1" | sort -u; }

repeat() {
  local folder=${CARGO_TARGET_DIR:-target}/repeat round failed=0 log
  rm -rf "$folder"
  mkdir -p "$folder"
  cargo test --locked --no-run "$@"
  begin_load
  for ((round = 1; round <= repeats; round++)); do
    log=$folder/round-$round.log
    if cargo test --locked --no-fail-fast "$@" >"$log" 2>&1; then
      printf 'round %d of %d: passed, %d s so far\n' "$round" "$repeats" "$SECONDS"
    else
      failed=$((failed + 1))
      failed_in "$log" >"$folder/round-$round.failed"
      printf 'round %d of %d: FAILED, %d s so far: %s\n' "$round" "$repeats" "$SECONDS" "$(paste -sd ' ' "$folder/round-$round.failed")"
    fi
  done
  end_load
  cat "$folder"/*.failed 2>/dev/null | sort | uniq -c | sort -rn || true
  printf '%d rounds, %d failed%s\n' "$repeats" "$failed" "${has_load:+, under load}"
  [[ $failed == 0 ]]
}

# Whether the tests of the page can be run here; says why not.
has_browser() {
  local lack=
  command -v npm >/dev/null || lack=npm
  command -v node >/dev/null || lack=node
  command -v chromium >/dev/null || command -v chromium-browser >/dev/null || lack=chromium
  [[ -z $lack ]] && return
  printf "test.sh: the tests of the viewer's page are left out: %s is missing (scripts/setup.sh --tests installs it where it can)\n" "$lack" >&2
  [[ -z ${TERRAVISION_NEEDS_BROWSER:-} ]] || exit 1
  return 1
}

test_page() {
  has_browser || return 0
  cargo build --locked --workspace --bins
  scripts/page.sh --check
  node viewer/web/test.mjs browser
}

# The dev profile is optimised: it builds twice as fast as release, and checks for overflows.
# Test programs run one after the other, their tests side by side.
if [[ $* != loom && $* != page ]]; then
  if ((repeats > 0)); then
    repeat "${@:---workspace}"
    exit
  fi
  begin_load
  cargo test --locked "${@:---workspace}"
  end_load
fi
# The models have a folder of their own: their flags would have everything built anew.
if [[ $# == 0 || $* == loom ]]; then
  RUSTFLAGS="--cfg loom" CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-target}/loom \
    cargo test --locked -p terravision-common --lib --release loom_
fi
if [[ $# == 0 || $* == page ]]; then
  test_page
fi

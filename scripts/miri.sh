#!/usr/bin/env bash
# The algorithms of shared memory under Miri, which looks for undefined behaviour: rings, ping-pong buffer, want list, tile pools,
# waits on futexes, and readers of garbage, over memory of one process (`Region::heap`); 34 tests, three minutes. Miri cannot run
# mappings of files, signals, other processes, and pidfd_open, by which a wait notices that a process is dead (those two tests of
# waits are left out). loom checks orderings (`scripts/test.sh loom`). Needs a nightly compiler: rustup toolchain install nightly
# --component miri,rust-src.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
PATH=$HOME/.cargo/bin:$PATH

# /proc/self is read for the id of this process. rustix makes system calls by assembly unless told; Miri knows those of libc.
export MIRIFLAGS=${MIRIFLAGS:--Zmiri-disable-isolation}
export RUSTFLAGS="--cfg rustix_use_libc"
# A case takes a thousand times as long.
export PROPTEST_CASES=${PROPTEST_CASES:-4} PROPTEST_DISABLE_FAILURE_PERSISTENCE=1 PROPTEST_RNG_SEED=1

if (($# == 0)); then
  set -- shm::tests::ring shm::tests::want_list shm::tests::pool shm::tests::waits shm::tests::garbage --skip that_is_gone
fi
cargo +nightly miri test --locked -p terravision-common --lib --target-dir target/miri -- "$@"

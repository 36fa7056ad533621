#!/usr/bin/env bash
# Do the models of the shared-memory algorithms notice an ordering that is too weak? Weakens one at a time, in a copy of the
# sources, and runs the models under loom: each time one of them has to fail. A line each, and a summary.
#
#   scripts/weaken.sh    about ten minutes
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

scripts/setup.sh
PATH=$HOME/.cargo/bin:$PATH
target=$(realpath -m "${CARGO_TARGET_DIR:-target}/loom")
copy=$(mktemp -d)
trap 'rm -rf "$copy"' EXIT
git ls-files -z | tar --null -cf - -T - | tar -xf - -C "$copy"

# What is weakened: a name, the file, the line as it stands there (what is before and after it may be any spaces), and what
# takes its place.
weakenings=(
  'ring: publish|cursor.rs|positions.write.0.store(self.position, Ordering::Release);|positions.write.0.store(self.position, Ordering::Relaxed);'
  'ring: give back|cursor.rs|positions.read.0.store(self.position, Ordering::Release);|positions.read.0.store(self.position, Ordering::Relaxed);'
  'pool: publish a tile|slot_words.rs|self.usage.fetch_xor(SlotState::Filling as u64 ^ SlotState::Ready as u64, Ordering::Release);|self.usage.fetch_xor(SlotState::Filling as u64 ^ SlotState::Ready as u64, Ordering::Relaxed);'
  'pool: claim before filling|slot_words.rs|fence(Ordering::Release);|'
  'pool: look again after reading|slot_words.rs|fence(Ordering::Acquire);|'
  'seqlock: begin|seqlock.rs|fence(Ordering::Release);|'
  'seqlock: end|seqlock.rs|self.sequence.store(odd.wrapping_add(1), Ordering::Release);|self.sequence.store(odd.wrapping_add(1), Ordering::Relaxed);'
  'seqlock: look again after reading|seqlock.rs|fence(Ordering::Acquire);|'
  'frame ring: begin|frame_core.rs|fence(Ordering::Release); // SYNC frame.begin|'
  'frame ring: end|frame_core.rs|fence(Ordering::Release); // SYNC frame.end|'
  'frame ring: look again after reading|frame_core.rs|fence(Ordering::Acquire);|'
  'want list: begin|want_core.rs|fence(Ordering::Release);|'
  'want list: end|want_core.rs|self.version.0.store(odd.wrapping_add(1).max(2), Ordering::Release);|self.version.0.store(odd.wrapping_add(1).max(2), Ordering::Relaxed);'
  'want list: look again after reading|want_core.rs|fence(Ordering::Acquire);|'
)

# The models of the copy; on standard output what failed.
models() {
  local output
  if output=$(cd "$copy" && RUSTFLAGS='--cfg loom' CARGO_TARGET_DIR=$target \
    cargo test --locked -p terravision-common --lib --release loom_ 2>&1); then
    grep '^test result: ok' <<<"$output" >/dev/null || { printf '%s\n' "$output" >&2; exit 1; }
    return 0
  fi
  if ! grep '^test .* FAILED$' <<<"$output" | sed 's/^test .*::\(loom_[a-z_0-9]*\).*/\1/; s/^test \(.*\) \.\.\. FAILED/\1/' | sort -u; then
    printf '%s\n' "$output" >&2
    exit 1
  fi
}

failed=$(models)
if [[ -n $failed ]]; then
  printf 'weaken: as they are, models fail: %s\n' "$failed" >&2
  exit 1
fi
caught=0
for weakening in "${weakenings[@]}"; do
  IFS='|' read -r name file from to <<<"$weakening"
  path=$copy/common/src/shm/$file
  cp "$path" "$path.whole"
  FROM=$from TO=$to perl -0pi -e 's/\Q$ENV{FROM}\E/$ENV{TO}/' "$path"
  if cmp -s "$path" "$path.whole"; then
    printf 'weaken: %s: its line is not in %s any more\n' "$name" "$file" >&2
    exit 1
  fi
  failed=$(models | paste -sd ' ')
  if [[ -n $failed ]]; then
    caught=$((caught + 1))
    printf '%-40s fails: %s\n' "$name" "$failed"
  else
    printf '%-40s NOT noticed\n' "$name"
  fi
  mv "$path.whole" "$path"
  touch "$path"
done
printf 'weaken: %d of %d weakened orderings are noticed\n' "$caught" "${#weakenings[@]}"
[[ $caught -eq ${#weakenings[@]} ]]

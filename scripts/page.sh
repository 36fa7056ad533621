#!/usr/bin/env bash
# Builds the page of `terravision serve` anew, from viewer/web/src to viewer/web/dist, which is committed so that cargo needs
# no node. Types and unit tests are checked first.
#
#   scripts/page.sh           builds
#   scripts/page.sh --check   builds beside it, and fails when the bytes differ from those that are committed
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../viewer/web"

say() { printf 'page: %s\n' "$*" >&2; }

if [[ $# -gt 1 || ( $# == 1 && $1 != --check ) ]]; then
  say 'usage: scripts/page.sh [--check]'
  exit 2
fi
if ! command -v node >/dev/null || ! command -v npm >/dev/null; then
  say 'node or npm is missing: scripts/setup.sh --tests installs them'
  exit 1
fi

# The versions of package-lock.json; scripts of packages are not run, none is needed.
if [[ ! -e node_modules/.package-lock.json || package-lock.json -nt node_modules/.package-lock.json ]]; then
  npm ci --ignore-scripts --no-audit --no-fund --loglevel=error >&2
fi
node_modules/.bin/tsc --noEmit --strict -p .

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
node test.mjs unit
node build.mjs "$work/dist"

bytes=$(cat "$work"/dist/* | gzip -9 | wc -c)
if ((bytes > 120000)); then
  say "the page has $bytes bytes gzipped; at most 120000 are wanted"
  exit 1
fi
if [[ ${1:-} != --check ]]; then
  rm -rf dist
  cp -r "$work/dist" dist
  say "viewer/web/dist is new: $bytes bytes gzipped"
elif diff -rq dist "$work/dist" >&2; then
  say "viewer/web/dist is what the sources give: $bytes bytes gzipped"
else
  say 'viewer/web/dist is not what the sources give: run scripts/page.sh and commit it'
  exit 1
fi

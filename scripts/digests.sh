#!/usr/bin/env bash
# Prints a digest of what a build draws: pictures of the mesh and of rays, depth and ground, over five worlds and twelve paths.
# Run it before and after a change that pictures must not notice, on one machine: the lists must be equal. (Another driver or
# processor may draw other bytes, so no list is kept here.)
#
#   scripts/digests.sh [FOLDER]   FOLDER has the programs of a build; target/release if not given
#
#   scripts/digests.sh ../before/target/release >before.txt
#   scripts/digests.sh >after.txt && diff before.txt after.txt
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

programs=${1:-${CARGO_TARGET_DIR:-target}/release}
terravision=$programs/terravision
if [[ ! -x $terravision ]]; then
  printf 'digests.sh: no program %s: build it (cargo build --release --bins), or name the folder of another build\n' "$terravision" >&2
  exit 2
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

# Silent unless it fails. Exit code 3, tiles missing, is a failure too.
tv() {
  local code=0
  "$terravision" "$@" >"$work/log" 2>&1 || code=$?
  if ((code != 0)); then
    cat "$work/log" >&2
    printf 'digests.sh: exit code %d: terravision %s\n' "$code" "$*" >&2
    return 1
  fi
}

# Textured; tinted by height; fine ground inside coarse ground; holes, and a grid that is turned against the source's; clipped, without a photo.
readonly WORLDS='textured tinted nested holes clipped'
make_worlds() {
  tv synth -o "$work/alps" --size 512 --spacing 20 --seed 1
  tv synth -o "$work/fine" --size 128 --spacing 5 --seed 4
  tv synth -o "$work/wide" --size 256 --spacing 40 --seed 7
  tv ingest --elevation "$work/alps/dem.tif" --color "$work/alps/ortho.tif" -o "$work/textured.tv"
  tv ingest --elevation "$work/alps/dem.tif" -o "$work/tinted.tv"
  tv ingest --elevation "$work/wide/dem.tif" "$work/fine/dem.tif" --color "$work/wide/ortho.tif" -o "$work/nested.tv"
  tv ingest --elevation "$work/alps/dem.tif" --color "$work/alps/ortho.tif" --crs EPSG:32630 --voids keep -o "$work/holes.tv"
  tv ingest --elevation "$work/wide/dem.tif" --crs EPSG:3035 --voids clip -o "$work/clipped.tv"
}

# Longitude and latitude of the place that is $1 and $2 half sides east and north of the middle, which all worlds share.
at() { awk -v e="$1" -v n="$2" 'BEGIN { printf "%.6f,%.6f", 9.0 + e * 0.067, 46.953 + n * 0.046 }'; }

# The flags of the path $1.
path_flags() {
  case $1 in
    orbit) echo --path orbit --frames 0..2 ;;
    round) echo --path orbit --around "$(at 0.1 0.1)" --lonlat --radius 2500 --height 900 --frames 100..102 ;;
    oblique) echo --lonlat --look-at "$(at 0 0)" --from 200,25,6000 ;;
    low) echo --lonlat --eye "$(at -0.5 -0.4),60" --agl --heading 50 --pitch -4 ;;
    lowest) echo --lonlat --eye "$(at 0.2 0.1)" --heading 200 --pitch 2 ;;
    above) echo --lonlat --eye "$(at 0 0),2500" --agl --heading 0 --pitch -90 ;;
    inside) echo --lonlat --eye "$(at 0.01 0.01),300" --agl --heading 300 --pitch -35 ;;
    rolled) echo --lonlat --eye "$(at 0.4 -0.5),500" --agl --heading 320 --pitch -15 --roll 40 ;;
    upside-down) echo --lonlat --eye "$(at -0.4 0.5),700" --agl --heading 140 --pitch -20 --roll 180 ;;
    edge) echo --lonlat --eye "$(at -0.98 -0.9),400" --agl --heading 2 --pitch -12 ;;
    outside) echo --lonlat --eye "$(at 1.5 1.6),4500" --heading 225 --pitch -22 ;;
    up) echo --lonlat --eye "$(at -0.2 0.3),100" --agl --heading 90 --pitch 25 ;;
  esac
}
readonly PATHS='orbit round oblique low lowest above inside rolled upside-down edge outside up'

# All paths over the world $1 as one: $work/path.json; the name of the path of each frame: $work/names.
join_paths() {
  local path flags
  : >"$work/poses"
  : >"$work/names"
  for path in $PATHS; do
    read -ra flags < <(path_flags "$path")
    tv path "$work/$1.tv" "${flags[@]}" -o "$work/part.json"
    sed -n 's/^ *\({"heading.*}\),\?$/\1/p' "$work/part.json" | tee -a "$work/poses" | sed "s/.*/$path/" >>"$work/names"
  done
  printf '{%s, "frames": [\n%s\n]}\n' "$(sed -n '1s/^{\("crs": "[^"]*"\).*/\1/p' "$work/part.json")" "$(paste -sd, "$work/poses")" >"$work/path.json"
}

# Flies over the world $1 as $2 with the flags that follow; prints a line for each path.
fly() {
  local world=$1 technique=$2 i=0 path frame
  shift 2
  rm -rf "$work/frames"
  tv fly "$work/$world.tv" --path "$work/path.json" --size 320x180 -o "$work/frames/" "$@"
  while read -r path; do
    frame=$(printf '%06d' "$i")
    for file in "$work"/frames/*"$frame"*.* "$work"/frames/*/*"$frame"*.*; do
      [[ -f $file ]] || continue
      printf '%s  %s %s %s %s\n' "$(sha256sum <"$file" | cut -c 1-32)" "$world" "$technique" "$path" "${file#"$work/frames/"}"
    done
    i=$((i + 1))
  done <"$work/names"
}

make_worlds
for world in $WORLDS; do
  join_paths "$world"
  planes=(--depth "$work/frames/depth" --ground "$work/frames/ground")
  fly "$world" mesh --technique mesh "${planes[@]}"
  fly "$world" mesh-best --technique mesh --quality best --edge none
  fly "$world" exact --technique rays --rays mipmap "${planes[@]}"
  fly "$world" coherent --technique rays --rays coherent "${planes[@]}"
done

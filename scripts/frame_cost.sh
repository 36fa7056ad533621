#!/usr/bin/env bash
# What a frame costs by technique: processor time of all processes, user and system, of flights without a GPU. Alternating
# turns; a frame is the difference of a long and a short flight, so that starting up and the first tiles do not count.
#
#   scripts/frame_cost.sh [WORLD]
#
#   WORLD                   the world [default: that of scripts/fly.sh, out/world-4096.tv]
#   TERRAVISION_TURNS       turns (5)
#   TERRAVISION_FRAMES      frames of the short and of the long flight ("40 160")
#   TERRAVISION_PICTURE     width and height of the picture (1280x720)
#   TERRAVISION_BIN         folder of the programs (target/release)
#   TERRAVISION_BEFORE      folder of other programs, whose mesh is what all is divided by
#   TERRAVISION_BEFORE_WORLD  the world that those fly over (WORLD)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

readonly WORLD=${1:-out/world-4096.tv}
readonly TURNS=${TERRAVISION_TURNS:-5}
readonly PICTURE=${TERRAVISION_PICTURE:-1280x720}
readonly BIN=${TERRAVISION_BIN:-${CARGO_TARGET_DIR:-target}/release}
readonly BEFORE=${TERRAVISION_BEFORE:-}
read -r SHORT LONG <<<"${TERRAVISION_FRAMES:-40 160}"
readonly SHORT LONG TIMEFORMAT='%U %S'

# flight LABEL FOLDER WORLD INSTRUCTIONS FLAGS...: "LABEL FRAMES SECONDS" of both flights.
flight() {
    local label=$1 folder=$2 world=$3 instructions=$4 frames times
    shift 4
    for frames in "$SHORT" "$LONG"; do
        times=$({ time env ${instructions:+TERRAVISION_INSTRUCTIONS="$instructions"} "$folder/terravision" fly "$world" \
            --path orbit --frames "0..$frames" --size "$PICTURE" "$@" -o - --quiet >/dev/null 2>&3; } 3>&2 2>&1)
        echo "$label $frames $times"
    done
}

for ((turn = 0; turn < TURNS; turn++)); do
    if [[ -n $BEFORE ]]; then
        flight mesh-before "$BEFORE" "${TERRAVISION_BEFORE_WORLD:-$WORLD}" '' --technique mesh
    fi
    flight mesh "$BIN" "$WORLD" '' --technique mesh
    flight mipmap "$BIN" "$WORLD" '' --rays mipmap
    flight sweep "$BIN" "$WORLD" '' --rays sweep
    flight sweep-AVX2 "$BIN" "$WORLD" AVX2 --rays sweep
    flight sweep-portable "$BIN" "$WORLD" portable --rays sweep
    flight sweep-best "$BIN" "$WORLD" '' --rays sweep --quality best
done | awk -v short="$SHORT" -v long="$LONG" '
    $2 == short { before = $3 + $4; next }
    {
        if (!($1 in count)) order[++labels] = $1
        ms[$1, ++count[$1]] = ($3 + $4 - before) / (long - short) * 1000
    }
    END {
        printf "%-16s %8s %8s %8s %10s\n", "", "median", "least", "most", "of " order[1]
        for (l = 1; l <= labels; l++) {
            label = order[l]; n = count[label]
            for (i = 1; i <= n; i++) sorted[i] = ms[label, i]
            for (i = 1; i <= n; i++) for (j = i + 1; j <= n; j++)
                if (sorted[j] < sorted[i]) { swap = sorted[i]; sorted[i] = sorted[j]; sorted[j] = swap }
            median = (sorted[int((n + 1) / 2)] + sorted[int(n / 2) + 1]) / 2
            if (l == 1) first = median
            printf "%-16s %5.1f ms %5.1f ms %5.1f ms %10.2f\n", label, median, sorted[1], sorted[n], median / first
        }
    }'

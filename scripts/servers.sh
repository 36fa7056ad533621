#!/usr/bin/env bash
# One fast flight against the clock over a world on a web server (nginx), and once more over the same world in an S3 bucket (moto),
# both on loopback, each from an empty cache, to a film with a report. A summary line each; fails when a flight does, when a tile cannot be
# had, or when the film lacks frames. Nothing is left running.
#
#   scripts/servers.sh           a minute each
#   scripts/servers.sh --short   eight seconds each over a small world
#
#   TERRAVISION_WORLD   this database, a folder (a synthetic one of 4096 x 4096 posts, made once)
#   TERRAVISION_PICTURE width and height of the picture (640x360)
#   TERRAVISION_FPS     frames per second (30)
#   TERRAVISION_OUT     where films, reports and world land (out)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

seconds=60 size=4096
case ${1:-} in
  '') ;;
  --short) seconds=8 size=1024 ;;
  *)
    printf 'usage: scripts/servers.sh [--short]\n' >&2
    exit 2
    ;;
esac
picture=${TERRAVISION_PICTURE:-640x360}
fps=${TERRAVISION_FPS:-30}
out=${TERRAVISION_OUT:-out}

scripts/setup.sh --servers
PATH=$HOME/.cargo/bin:$PATH:/usr/sbin
cargo build --release --locked --bins
target=$(realpath "${CARGO_TARGET_DIR:-target}")
terravision=$target/release/terravision
nginx=$target/nginx/usr/sbin/nginx
[[ -x $nginx ]] || nginx=$(command -v nginx)

mkdir -p "$out/servers"
world=${TERRAVISION_WORLD:-$out/world-$size.tv}
if [[ ! -f $world/manifest.json ]]; then
  "$terravision" synth -o "$out/world-$size" --size "$size"
  "$terravision" ingest --elevation "$out/world-$size/dem.tif" --color "$out/world-$size/ortho.tif" -o "$world" --overwrite
fi
world=$(realpath "$world")

scratch=$(mktemp -d)
servers=()
cleanup() {
  # Only what was started here.
  if ((${#servers[@]} > 0)); then
    kill "${servers[@]}" 2>/dev/null || true
    wait "${servers[@]}" 2>/dev/null || true
  fi
  rm -rf "$scratch"
}
trap cleanup EXIT

free_port() { python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])'; }

# Waits until a server listens on port $1, as long as process $2 lives.
await_port() {
  local tries
  for tries in {1..600}; do
    if (: <"/dev/tcp/127.0.0.1/$1") 2>/dev/null; then return; fi
    kill -0 "$2" || break
    sleep 0.1
  done
  printf 'servers: no server listens on port %s\n' "$1" >&2
  exit 1
}

# A circle through the world, low and fast: a twentieth of its side in a second, 400 m/s at most.
"$terravision" info "$world" --json | python3 -c '
import json, math, sys
seconds, path = float(sys.argv[1]), sys.argv[2]
info = json.load(sys.stdin)
west, south, east, north = info["bounds"]
high = info["manifest"]["elevation"]["range_m"][1]
speed = min(0.05 * min(east - west, north - south), 400.0)
radius = speed * seconds / (2.0 * math.pi)
radius = min(radius, 0.35 * min(east - west, north - south))
frames = []
for k in range(int(seconds) + 1):
    a = speed * k / radius
    frames.append({"t": k, "x": 0.5 * (west + east) + radius * math.cos(a), "y": 0.5 * (south + north) + radius * math.sin(a),
                   "z": high + 150.0, "heading": -math.degrees(a) % 360.0, "pitch": -22.0})
json.dump({"keyframes": frames}, open(path, "w"))
' "$seconds" "$out/servers/fast.json"

# Flies over $2 and says how, under the name $1.
fly() {
  local film=$out/servers/$1.mp4 report=$out/servers/$1.json
  "$terravision" fly "$2" --mode realtime --fps "$fps" --path "$out/servers/fast.json" --size "$picture" \
    --cache "$scratch/cache-$1" -o "$film" --report "$report" --quiet
  local pictures
  pictures=$(ffprobe -v error -count_packets -select_streams v -show_entries stream=nb_read_packets -of csv=p=0 "$film")
  python3 -c '
import json, sys
name, film, pictures, report = sys.argv[1], sys.argv[2], int(sys.argv[3]), json.load(open(sys.argv[4]))
flight, network = report["realtime"], report["network"]
if pictures != flight["frames"]:
    sys.exit("%s: %d pictures in %s, expected %d" % (name, pictures, film, flight["frames"]))
if network["bytes"] == 0:
    sys.exit("%s: nothing came from the server" % name)
interval = flight["interval_ms"]
print("%s: %d frames, %.1f %% on time, interval p50 %.1f p95 %.1f p99 %.1f worst %.1f ms, %.1f %% of the picture as fine as wanted, "
      "%.1f MB in %d requests: %s" % (
          name, flight["frames"], 100 * flight["on_time_share"], interval["p50"], interval["p95"], interval["p99"], interval["worst"],
          100 * flight["sharp_mean"], network["bytes"] / 1e6, network["requests"], film))
' "$1" "$film" "$pictures" "$report"
}

port=$(free_port)
mkdir "$scratch/nginx"
cat >"$scratch/nginx.conf" <<END
# One process, in the foreground, that writes nowhere but here.
daemon off;
master_process off;
pid $scratch/nginx/pid;
error_log $scratch/nginx/error.log;
events {}
http {
  access_log off;
  client_body_temp_path $scratch/nginx/body;
  proxy_temp_path $scratch/nginx/proxy;
  fastcgi_temp_path $scratch/nginx/fastcgi;
  uwsgi_temp_path $scratch/nginx/uwsgi;
  scgi_temp_path $scratch/nginx/scgi;
  server {
    listen 127.0.0.1:$port;
    root $(dirname "$world");
  }
}
END
"$nginx" -e "$scratch/nginx/error.log" -c "$scratch/nginx.conf" &
servers+=($!)
await_port "$port" "${servers[-1]}"
fly nginx "http://127.0.0.1:$port/$(basename "$world")"

port=$(free_port)
"$target/s3-server/bin/moto_server" -H 127.0.0.1 -p "$port" >/dev/null 2>&1 &
servers+=($!)
await_port "$port" "${servers[-1]}"
curl -sSf -o "$scratch/answer" -X PUT "http://127.0.0.1:$port/terrain"
for file in "$world"/*; do
  curl -sSf -o "$scratch/answer" -T "$file" "http://127.0.0.1:$port/terrain/maps/world.tv/$(basename "$file")"
done
export AWS_ENDPOINT_URL=http://127.0.0.1:$port AWS_ACCESS_KEY_ID=testing AWS_SECRET_ACCESS_KEY=testing
fly s3 s3://terrain/maps/world.tv

#!/usr/bin/env python3
"""Compares JPEG with H.264 for a client of `terravision serve` over a slow link, in one flight:

    scripts/video_cost.py WORLD [--link 150000] [--turn 15] [--size 960x540] [--program target/debug/terravision] [-- FLAGS OF serve]

A pilot circles and moves all the time. It takes --link bytes a second, once as a client that decodes JPEG alone, and once as one that
decodes H.264; and once more JPEG as fast as it comes. Of each: pictures and bytes a second, processor time of the viewer and its
encoder a picture, and PSNR of some pictures against `GET /api/still.png` at their poses. Needs ffmpeg.
"""

import argparse
import json
import statistics
import struct
import subprocess
import sys
import tempfile
import time

from serve_load import Client, Pilot, Server, exact, psnr

SAMPLES = 5
JPEG, PNG, H264 = 0, 1, 2
BEGIN_WITHIN_S = 60


class Viewing(Client):
    """A client that keeps its pictures from some moment on: H.264 since the last configuration."""

    def __init__(self, *arguments, **named):
        self.moving, self.stream, self.kinds = [], [], {JPEG: 0, PNG: 0, H264: 0}
        super().__init__(*arguments, **named)

    def picture(self, payload):
        super().picture(payload)
        kind = payload[12]
        self.kinds[kind] += 1
        if kind == H264:
            if struct.unpack_from("<I", payload, 128)[0] > 0:
                self.stream.clear()
            self.stream.append(payload)
        elif kind == JPEG:
            self.moving.append(payload)


def annex_b(payload):
    """An access unit with start codes in place of lengths, behind the parameter sets where it has a configuration."""
    (size,) = struct.unpack_from("<I", payload, 128)
    config, unit, found = payload[132 : 132 + size], payload[132 + size :], b""
    if size:
        at, parts = 5, []
        for mask in (0x1F, 0xFF):
            count, at = config[at] & mask, at + 1
            for _ in range(count):
                (length,) = struct.unpack_from(">H", config, at)
                parts.append(config[at + 2 : at + 2 + length])
                at += 2 + length
        found = b"".join(b"\0\0\0\1" + part for part in parts)
    at = 0
    while at < len(unit):
        (length,) = struct.unpack_from(">I", unit, at)
        found += b"\0\0\0\1" + unit[at + 4 : at + 4 + length]
        at += 4 + length
    return found


def frames_of(stream, folder):
    """The pictures of a stream, decoded: raw RGB."""
    width, height = struct.unpack_from("<2I", stream[0], 24)
    with open(f"{folder}/a.h264", "wb") as file:
        file.write(b"".join(map(annex_b, stream)))
    color = "scale=in_color_matrix=bt709:in_range=tv,format=rgb24"
    raw = subprocess.check_output(["ffmpeg", "-v", "error", "-f", "h264", "-i", f"{folder}/a.h264", "-fps_mode", "passthrough", "-vf", color, "-f", "rawvideo", "-"])
    size = width * height * 3
    frames = [raw[at : at + size] for at in range(0, len(raw), size)]
    assert len(frames) == len(stream), (len(frames), len(stream))
    return frames, f"{width}x{height}"


def quality(server, client):
    """PSNR of pictures that are spread over what was kept, dB."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        kept = client.stream or client.moving
        chosen = [kept[len(kept) * (i + 1) // (SAMPLES + 1)] for i in range(SAMPLES)]
        frames, size = frames_of(client.stream, folder) if client.stream else ([], "")
        for payload in chosen:
            with open(f"{folder}/b.png", "wb") as file:
                file.write(exact(server, payload))
            reads = ["-i", f"{folder}/a"]
            content = payload[128:]
            if frames:
                reads = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, *reads]
                content = frames[kept.index(payload)]
            with open(f"{folder}/a", "wb") as file:
                file.write(content)
            found.append(psnr(reads, ["-i", f"{folder}/b.png"]))
    return found


def fly(server, arguments, reads, has_video):
    client = Viewing(server.port, server.size, reads=reads, watches=False, has_video=has_video)
    pilot = Pilot(server, client)
    end = time.monotonic() + BEGIN_WITHIN_S
    while time.monotonic() < end and (client.pictures < 5 or (has_video and client.kinds[H264] < 5)):
        time.sleep(0.1)
    client.moving.clear()
    before = dict(client.kinds)
    turn = pilot.turn(server, arguments.turn)
    pilot.ends = True
    time.sleep(0.2)
    client.end()
    kinds = {name: client.kinds[kind] - before[kind] for name, kind in (("jpeg", JPEG), ("png", PNG), ("h264", H264))}
    values = quality(server, client)
    return {
        "kinds": kinds,
        "frames_per_s": round(turn["frames_per_s"], 1),
        "pictures_per_s": round(turn["pictures_per_s"], 1),
        "bytes_per_s": round(turn["bytes_per_s"]),
        "latency_ms": round(turn["latency_ms"]),
        "cpu_ms_a_picture": round(1e3 * turn["viewer_cores"] / max(turn["pictures_per_s"], 1e-3), 2),
        "viewer_cores": round(turn["viewer_cores"], 3),
        "psnr_db": [statistics.median(values), *values],
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("world")
    parser.add_argument("--link", type=float, default=150_000)
    parser.add_argument("--turn", type=float, default=15)
    parser.add_argument("--size", default="960x540")
    parser.add_argument("--program", default="target/debug/terravision")
    own, _, flags = " ".join(sys.argv[1:]).partition(" -- ")
    arguments = parser.parse_args(own.split())
    arguments.flags = flags.split()
    server = Server(arguments)
    try:
        for name, reads, has_video in (("JPEG", None, False), ("JPEG over the link", arguments.link, False), ("H.264 over the link", arguments.link, True)):
            print(name, json.dumps(fly(server, arguments, reads, has_video)), flush=True)
    finally:
        server.end()


if __name__ == "__main__":
    main()

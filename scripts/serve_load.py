#!/usr/bin/env python3
"""Measures what clients of `terravision serve` cost, and whether bad ones cost others anything.

    scripts/serve_load.py WORLD [--minutes 10] [--turn 20] [--rounds 3] [--size 960x540] [--program target/debug/terravision] [-- FLAGS OF serve]

1. Bad clients: a pilot circles; turns of --turn seconds alternate between the pilot alone and the pilot beside one bad client of each
   kind (reads at a tenth of the rate that it needs, stops reading, floods). Of each turn: frames of the flight, late ones, pictures and latency of the pilot.
2. A crowd: 50 clients that are there, and 5 that take every picture, for --minutes: memory of all programs, minute by minute.
3. A flight: bytes a second of the pilot, and the quality of some of its pictures (PSNR by ffmpeg against `GET /api/still.png` at their poses).

Prints a report, and writes it as JSON with -o. Python's own library only, and ffmpeg for 3.
"""

import argparse
import base64
import json
import math
import os
import re
import signal
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request

POSES_PER_S = 20


class Client(threading.Thread):
    """A client of the WebSocket. `reads`: bytes a second that it takes, None for all, 0 for none."""

    def __init__(self, port, size, reads=None, acknowledges=True, floods=False, watches=True, has_video=False):
        super().__init__(daemon=True)
        self.reads, self.acknowledges, self.floods = reads, acknowledges, floods
        self.lock, self.ends = threading.Lock(), False
        self.pictures, self.bytes, self.latencies, self.kept, self.bye = 0, 0, [], None, None
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=30)
        if reads is not None:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)
        key = base64.b64encode(os.urandom(16)).decode()
        head = f"GET /api/socket HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        self.socket.sendall(f"{head}Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode())
        self.rest = b""
        while b"\r\n\r\n" not in self.rest:
            self.rest += self.receive(4096)
        answer, self.rest = self.rest.split(b"\r\n\r\n", 1)
        assert b" 101 " in answer.split(b"\r\n")[0] + b" ", answer
        self.say({"type": "hello", "protocol": 1, "size": size, "dpr": 1, "watch": watches, "h264": has_video})
        self.start()

    def receive(self, most):
        part = self.socket.recv(most)
        if not part:
            raise ConnectionError("closed")
        return part

    def say(self, message):
        self.frame(0x1, json.dumps(message).encode())

    def frame(self, kind, payload):
        size = len(payload)
        head = struct.pack("!BB", 0x80 | kind, 0x80 | size) if size < 126 else struct.pack("!BBH", 0x80 | kind, 0xFE, size)
        # A mask of zeros is one, too.
        with self.lock:
            self.socket.sendall(head + bytes(4) + payload)

    def take(self, count):
        """The next bytes, at the rate of this client."""
        parts = [self.rest[:count]]
        self.rest = self.rest[count:]
        missing = count - len(parts[0])
        while missing > 0:
            part = self.receive(min(missing, 1 << 16) if self.reads is None else min(missing, 4096))
            parts.append(part)
            missing -= len(part)
            if self.reads:
                time.sleep(len(part) / self.reads)
        return b"".join(parts)

    def run(self):
        try:
            while not self.ends:
                if self.floods:
                    self.say({"type": "ping", "id": 1})
                    continue
                if self.reads == 0:
                    time.sleep(0.1)
                    continue
                self.message()
        except (OSError, ConnectionError, ValueError):
            pass

    def message(self):
        first, size = struct.unpack("!BB", self.take(2))
        if size == 126:
            (size,) = struct.unpack("!H", self.take(2))
        elif size == 127:
            (size,) = struct.unpack("!Q", self.take(8))
        payload, kind = self.take(size), first & 0xF
        if kind == 0x9:
            self.frame(0xA, payload)
        elif kind == 0x2:
            self.picture(payload)
        elif kind == 0x1 and b'"bye"' in payload:
            self.bye = json.loads(payload)
        elif kind == 0x1 and b'"probe"' in payload:
            self.say({"type": "probed", "time_ms": json.loads(payload)["time_ms"]})

    def picture(self, payload):
        (n,) = struct.unpack_from("<I", payload, 8)
        received, _drawn, handed = struct.unpack_from("<3d", payload, 96)
        self.pictures += 1
        self.bytes += len(payload)
        self.latencies.append(handed - received)
        if payload[12] == 0 and struct.unpack_from("<H", payload, 14)[0] == 75:
            self.kept = payload
        if self.acknowledges:
            self.say({"type": "ack", "n": n})

    def end(self):
        self.ends = True
        self.socket.close()


class Pilot:
    """Circles around the start of the world, poses twenty times a second."""

    def __init__(self, server, client=None):
        self.client = client or Client(server.port, server.size, watches=False)
        self.start, self.id, self.ends = server.info["world"]["start"], 0, False
        self.begun = time.monotonic()
        threading.Thread(target=self.fly, daemon=True).start()

    def fly(self):
        while not self.ends:
            angle = (time.monotonic() - self.begun) * 0.05
            radius = 0.15 * self.start["z"]
            self.id += 1
            pose = dict(self.start, heading=(self.start["heading"] + math.degrees(angle)) % 360)
            pose["x"] += radius * math.sin(angle)
            pose["y"] += radius * (1 - math.cos(angle))
            try:
                self.client.say({"type": "pose", "id": self.id, **pose})
            except OSError:
                return
            time.sleep(1 / POSES_PER_S)

    def turn(self, server, seconds):
        """What happens within some seconds."""
        before, cpu = server.metrics(), server.cpu_s()
        self.client.latencies.clear()
        pictures, sent, begun = self.client.pictures, self.client.bytes, time.monotonic()
        time.sleep(seconds)
        passed, after, worked = time.monotonic() - begun, server.metrics(), server.cpu_s()
        rate = lambda name: (after.get(name, 0) - before.get(name, 0)) / passed
        latencies = list(self.client.latencies) or [math.nan]
        return {
            "frames_per_s": rate("terravision_frames_written_total"),
            "late_per_s": rate("terravision_frames_late_total"),
            "skipped_per_s": rate("terravision_frames_skipped_total"),
            "pictures_per_s": (self.client.pictures - pictures) / passed,
            "bytes_per_s": (self.client.bytes - sent) / passed,
            "latency_ms": statistics.median(latencies),
            "viewer_cores": (worked - cpu) / passed,
        }


class Server:
    def __init__(self, arguments):
        command = [arguments.program, "serve", arguments.world, "--addr", "127.0.0.1:0", "--quiet", *arguments.flags]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.page = self.process.stdout.readline().strip()
        self.port = int(re.search(r":(\d+)/", self.page).group(1))
        self.size = [int(side) for side in arguments.size.split("x")]
        self.info = json.loads(self.get("/api/info"))

    def get(self, path):
        return urllib.request.urlopen(f"http://127.0.0.1:{self.port}{path}", timeout=120).read()

    def metrics(self):
        lines = [line.rsplit(" ", 1) for line in self.get("/api/metrics").decode().splitlines() if not line.startswith("#")]
        return {name: float(value) for name, value in lines}

    def family(self):
        """Process ids below the server, and their names."""
        parents, names = {}, {}
        for entry in os.listdir("/proc"):
            if entry.isdigit():
                try:
                    stat = open(f"/proc/{entry}/stat").read()
                except OSError:
                    continue
                names[int(entry)] = stat[stat.index("(") + 1 : stat.rindex(")")]
                parents[int(entry)] = int(stat[stat.rindex(")") + 2 :].split()[1])
        found = {self.process.pid}
        while True:
            more = {pid for pid, parent in parents.items() if parent in found} - found
            if not more:
                return {pid: names.get(pid, "") for pid in found}
            found |= more

    def cpu_s(self):
        """Processor time of the viewer and of its encoders so far."""
        ticks = 0
        for pid, name in self.family().items():
            if name.startswith("terravision-vie") or name == "ffmpeg":
                fields = open(f"/proc/{pid}/stat").read().rsplit(")", 1)[1].split()
                ticks += int(fields[11]) + int(fields[12])
        return ticks / os.sysconf("SC_CLK_TCK")

    def memory(self):
        """Private memory of each program, MB: shared memory is that of the run, which is fixed."""
        found = {}
        for pid, name in self.family().items():
            try:
                text = open(f"/proc/{pid}/smaps_rollup").read()
            except OSError:
                continue
            private = sum(int(kb) for kb in re.findall(r"^Private_(?:Clean|Dirty): +(\d+)", text, re.M))
            found[name] = found.get(name, 0) + private / 1e3
        return found

    def end(self):
        self.process.send_signal(signal.SIGINT)
        self.process.wait(30)


def bad_clients(server, pilot, needed, arguments):
    turns = {"alone": [], "slow": [], "deaf": [], "flood": []}
    kinds = list(turns)
    for number in range(arguments.rounds):
        # Each kind is at each place: what else the machine does grows and fades.
        for kind in kinds[number % 4 :] + kinds[: number % 4]:
            bad = None
            if kind == "slow":
                bad = Client(server.port, server.size, reads=max(needed / 10, 1e4))
            elif kind == "deaf":
                bad = Client(server.port, server.size, reads=0)
            elif kind == "flood":
                bad = Client(server.port, server.size, floods=True)
            turns[kind].append(pilot.turn(server, arguments.turn))
            if bad is not None:
                bad.end()
    median = lambda kind, key: statistics.median(turn[key] for turn in turns[kind])
    report = {kind: {key: round(median(kind, key), 3) for key in turns[kind][0]} for kind in turns}
    for kind in ("slow", "deaf", "flood"):
        alone = report["alone"]
        report[kind]["frames_of_alone"] = round(report[kind]["frames_per_s"] / alone["frames_per_s"], 3)
        report[kind]["pictures_of_alone"] = round(report[kind]["pictures_per_s"] / alone["pictures_per_s"], 3)
    return report


def crowd(server, pilot, arguments):
    idle = [Client(server.port, server.size, acknowledges=False) for _ in range(50)]
    active = [Client(server.port, server.size) for _ in range(4)]
    memory, ends = [], time.monotonic() + 60 * arguments.minutes
    time.sleep(5)
    begun = [client.pictures for client in active]
    since = time.monotonic()
    while time.monotonic() < ends:
        memory.append({name: round(mb, 1) for name, mb in server.memory().items()})
        time.sleep(min(60, max(1, ends - time.monotonic())))
    memory.append({name: round(mb, 1) for name, mb in server.memory().items()})
    passed = time.monotonic() - since
    rates = [round((client.pictures - before) / passed, 2) for client, before in zip(active, begun)]
    report = {"minutes": round(passed / 60, 2), "pictures_per_s": rates, "memory_mb": memory, "clients": server.metrics()["terravision_viewer_clients"]}
    for client in idle + active:
        client.end()
    return report


def psnr(first, second):
    """PSNR of two pictures, each the arguments with which ffmpeg reads it."""
    graph = "[0]format=rgb24[a];[1]format=rgb24[b];[a][b]psnr"
    ran = subprocess.run(["ffmpeg", "-hide_banner", "-nostdin", *first, *second, "-lavfi", graph, "-f", "null", "-"], capture_output=True, text=True)
    value = re.search(r"average:([\d.]+|inf)", ran.stderr)
    return float(value.group(1)) if value else None


def exact(server, payload):
    """The exact picture at the pose of a picture, PNG."""
    width, height = struct.unpack_from("<2I", payload, 24)
    x, y, z, heading, pitch, roll, vfov = struct.unpack_from("<7d", payload, 40)
    return server.get(f"/api/still.png?x={x}&y={y}&z={z}&heading={heading}&pitch={pitch}&roll={roll}&vfov={vfov}&width={width}&height={height}")


def quality(server, pilot, samples=5):
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(samples):
            pilot.client.kept = None
            while pilot.client.kept is None:
                time.sleep(0.05)
            payload = pilot.client.kept
            for name, content in (("a.jpg", payload[128:]), ("b.png", exact(server, payload))):
                with open(f"{folder}/{name}", "wb") as file:
                    file.write(content)
            found.append({"bytes": len(payload), "psnr_db": psnr(["-i", f"{folder}/a.jpg"], ["-i", f"{folder}/b.png"])})
            time.sleep(1)
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("world")
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--turn", type=float, default=20)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--size", default="960x540")
    parser.add_argument("--program", default="target/debug/terravision")
    parser.add_argument("-o", "--output")
    own, _, flags = " ".join(sys.argv[1:]).partition(" -- ")
    arguments = parser.parse_args(own.split())
    arguments.flags = flags.split()
    server = Server(arguments)
    try:
        pilot = Pilot(server)
        time.sleep(6)
        report = {"flight": pilot.turn(server, arguments.turn), "samples": quality(server, pilot)}
        report["bad_clients"] = bad_clients(server, pilot, report["flight"]["bytes_per_s"], arguments)
        if arguments.minutes > 0:
            report["crowd"] = crowd(server, pilot, arguments)
        pilot.ends = True
    finally:
        server.end()
    text = json.dumps(report, indent=1)
    print(text)
    if arguments.output:
        with open(arguments.output, "w") as file:
            file.write(text + "\n")


if __name__ == "__main__":
    main()

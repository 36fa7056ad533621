"""Frames from a flight, and poses to it, in shared memory. The layouts are those of docs/frame-ring.md. Needs NumPy."""
import math
import mmap
import os
import struct
import sys
import time

try:
    import numpy as np
except ImportError:
    sys.exit("terravision_live.py: NumPy is missing: apt-get install python3-numpy, or pip install numpy")


def _open(file, magic, timeout, prot):
    path, until = f"/dev/shm/terravision-{file}", time.monotonic() + timeout
    while not os.path.exists(path):
        if time.monotonic() > until:
            raise TimeoutError(f"{path} is not there: does the flight run?")
        time.sleep(0.01)
    with open(path, "rb" if prot == mmap.PROT_READ else "r+b") as segment:
        memory = mmap.mmap(segment.fileno(), 0, prot=prot)
    found = struct.unpack_from("<8sI", memory)
    if found != (magic, 1):
        raise ValueError(f"{path} is not a segment {magic} of version 1: {found}")
    return memory


class Frames:
    """The frame ring of `terravision fly … -o shared:NAME`."""

    def __init__(self, name, timeout=30.0):
        self.memory = _open(name, b"TVFRAMES", timeout, mmap.PROT_READ)
        header = struct.unpack_from("<4I5Q", self.memory, 64)
        self.width, self.height, _, self.slots, self.first, self.stride, self.color, self.depth, self.ground = header

    def is_ended(self):
        """Whether the flight has ended, or was killed."""
        pid, _, state = struct.unpack_from("<IQI", self.memory, 12)
        return state == 2 or not os.path.exists(f"/proc/{pid}")

    def newest(self):
        """The newest frame as a dictionary; None before the first."""
        while True:
            (number,) = struct.unpack_from("<Q", self.memory, 128)
            if number == 0:
                return None
            slot = self.first + (number - 1) % self.slots * self.stride
            if struct.unpack_from("<Q", self.memory, slot)[0] != 2 * number:
                continue
            names = "frame published camera t x y z heading pitch roll vfov flags width height".split()
            frame = dict(zip(names, struct.unpack_from("<3Q8dQ2I", self.memory, slot + 8)), number=number)
            size = min(frame["height"], self.height), min(frame["width"], self.width)
            frame["rgba"] = self._plane(slot, self.color, size, np.uint8, 4)
            frame["is_made_up"] = frame["rgba"][..., 3] & 1 == 0
            frame["depth"] = self._plane(slot, self.depth, size, np.float32, 1)
            frame["ground"] = self._plane(slot, self.ground, size, np.float64, 3)
            if struct.unpack_from("<Q", self.memory, slot)[0] == 2 * number:
                return frame

    def of_pose(self, t, timeout=60.0, camera=None):
        """Waits for the frame of the pose that was sent with this time; not for one that the camera's flight has refused."""
        until = time.monotonic() + timeout
        while time.monotonic() < until and not self.is_ended():
            frame = self.newest()
            if frame is not None and frame["t"] == t:
                return frame
            if camera is not None and camera.is_refused():
                raise ValueError(f"the flight refused the pose of time {t}: {camera.why_refused()}")
            time.sleep(0.0005)
        raise TimeoutError(f"no frame of the pose of time {t}" + (": the flight has ended" if self.is_ended() else ""))

    def _plane(self, slot, offset, size, kind, channels):
        if not offset:
            return None
        plane = np.frombuffer(self.memory, kind, size[0] * size[1] * channels, slot + offset)
        return plane.reshape(*size, channels).squeeze().copy()


class Camera:
    """The poses of `terravision fly … --camera shm:NAME`. Degrees; metres in the world's CRS."""

    def __init__(self, name, timeout=30.0):
        self.memory = _open(f"{name}-camera", b"TVCAMERA", timeout, mmap.PROT_READ | mmap.PROT_WRITE)

    def send(self, t, x, y, z, heading, pitch, roll=0.0, vfov=0.0, end=False, size=(0, 0)):
        """Replaces the pose; t has to grow. vfov 0 and size (0, 0) are those of the flight."""
        self.refused_before, self.sent = self.answers()[1], (x, y, z, heading, pitch, roll, vfov, t)
        odd = (struct.unpack_from("<Q", self.memory, 64)[0] + 1) | 1
        struct.pack_into("<Q", self.memory, 64, odd)
        struct.pack_into("<8dQ2I", self.memory, 72, x, y, z, heading, pitch, roll, vfov, t, end, *size)
        struct.pack_into("<Q", self.memory, 64, odd + 1)

    def end(self):
        """The flight is over."""
        self.send(0, 0, 0, 0, 0, 0, end=True)

    def answers(self):
        """Poses accepted and refused so far, and the counter of the one looked at last."""
        return struct.unpack_from("<3Q", self.memory, 256)

    def is_refused(self):
        """Whether the flight has looked at the pose that was sent last, and refused it."""
        _, refused, looked_at = self.answers()
        return looked_at == struct.unpack_from("<Q", self.memory, 64)[0] and refused > self.refused_before

    def why_refused(self):
        """What can be seen from here; the flight itself says it on its standard error."""
        x, y, z, heading, pitch, roll, vfov, _ = self.sent
        if not all(map(math.isfinite, self.sent)):
            return "a number is not finite"
        if not -90 <= pitch <= 90:
            return f"pitch {pitch} is not within -90 and 90"
        if max(abs(heading), abs(roll)) > 1e6 or (vfov != 0 and not 1 <= vfov <= 170):
            return "an angle is out of range"
        return f"t is not newer than that of the poses before, or {x} {y} {z} is too far from the world (the flight says which)"

"""Prints statistics of the live pictures of a flight:  read_frames.py NAME [COUNT]   (layout: docs/frame-ring.md; needs NumPy)"""
import mmap, os, struct, sys, time
try:
    import numpy as np
except ImportError:
    sys.exit("read_frames.py: NumPy is missing: apt-get install python3-numpy, or pip install numpy")

name, count = sys.argv[1] if len(sys.argv) > 1 else sys.exit(__doc__), int(sys.argv[2]) if len(sys.argv) > 2 else sys.maxsize
path, until = f"/dev/shm/terravision-{name}", time.monotonic() + 30
while not os.path.exists(path):
    time.sleep(0.01) if time.monotonic() < until else sys.exit(f"{path} is not there: does the flight run?")
ring = mmap.mmap(os.open(path, os.O_RDONLY), 0, prot=mmap.PROT_READ)
assert ring[:8] == b"TVFRAMES" and struct.unpack_from("<I", ring, 8) == (1,), "no frame ring of version 1"
width, height, planes, slots, first, stride, color, depth, ground = struct.unpack_from("<4I5Q", ring, 64)
seen = shown = 0
while shown < count:
    pid, _, state, _, newest = struct.unpack_from("<IQI100sQ", ring, 12)
    if newest == seen:
        if state == 2 or not os.path.exists(f"/proc/{pid}"):
            break  # the flight has ended, or was killed
        time.sleep(0.001)
        continue
    slot = first + (newest - 1) % slots * stride
    sequence, frame, *_, t, x, y, z = struct.unpack_from("<4Q4d", ring, slot)
    rgba = np.frombuffer(ring, np.uint8, width * height * 4, slot + color).reshape(height, width, 4).copy()
    meters = np.frombuffer(ring, np.float32, width * height, slot + depth).copy() if depth else np.full(1, np.nan)
    if (sequence, struct.unpack_from("<Q", ring, slot)[0]) != (2 * newest, 2 * newest):
        continue  # overtaken while copying
    seen, shown, sight = newest, shown + 1, meters[np.isfinite(meters)]
    red, green, blue, _ = rgba.mean((0, 1))
    near, far = (sight.min(), sight.max()) if sight.size else (np.nan, np.nan)
    text = f"frame {frame} at {x:.1f} {y:.1f} {z:.1f}: mean colour {red:.2f} {green:.2f} {blue:.2f}, depth {near:.1f} to {far:.1f} m"
    print(text, flush=True)

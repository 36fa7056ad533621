"""Flies a circle and saves what it sees: fly_circle.py NAME X Y RADIUS HEIGHT [FRAMES [FOLDER]], X Y the centre. Beside it:

    terravision fly WORLD --camera shm:NAME -o shared:NAME --depth --size 640x360

It needs NumPy and Pillow.
"""
import math
import sys

try:
    import numpy as np
    from PIL import Image
except ImportError as missing:
    sys.exit(f"fly_circle.py: {missing.name} is missing: apt-get install python3-numpy python3-pil, or pip install numpy pillow")
from terravision_live import Camera, Frames

sys.tracebacklimit = 0  # what goes wrong is said in a sentence
if len(sys.argv) < 6:
    sys.exit(__doc__)
name, (x, y, radius, height) = sys.argv[1], map(float, sys.argv[2:6])
count, folder = int(sys.argv[6]) if len(sys.argv) > 6 else 60, sys.argv[7] if len(sys.argv) > 7 else "."
camera, frames = Camera(name), Frames(name)
if not frames.depth:
    sys.exit(f"fly_circle.py: the frames of {name} have no depth: fly with --depth")
for step in range(count):
    angle = 2 * math.pi * step / count
    east, north = x + radius * math.sin(angle), y + radius * math.cos(angle)
    camera.send(t=step, x=east, y=north, z=height, heading=math.degrees(angle) + 180, pitch=-25)
    frame = frames.of_pose(t=step, camera=camera)
    seen = frame["depth"][np.isfinite(frame["depth"])]
    near, far = (seen.min(), seen.max()) if seen.size else (np.nan, np.nan)
    print(f"step {step}: frame {frame['frame']}, ground from {near:.0f} to {far:.0f} m away", flush=True)
camera.end()
if not seen.size:
    sys.exit("fly_circle.py: the last picture shows the sky alone; fly lower")

depth = frame["depth"]
np.save(f"{folder}/depth.npy", depth)
Image.fromarray(frame["rgba"][..., :3]).save(f"{folder}/color.png")
grey = 255 - 235 * np.log(depth / near) / np.log(far / near)  # near is bright, the sky black
Image.fromarray(np.nan_to_num(grey).astype(np.uint8)).save(f"{folder}/depth.png")

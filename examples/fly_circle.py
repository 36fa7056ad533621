"""Flies a circle and saves what it sees: fly_circle.py NAME X Y RADIUS HEIGHT [FRAMES [FOLDER]], X Y the centre. Beside it:

    terravision fly WORLD --camera shm:NAME -o shared:NAME --depth --size 640x360
"""
import math
import sys

import numpy as np
from PIL import Image
from terravision_live import Camera, Frames

name, (x, y, radius, height) = sys.argv[1], map(float, sys.argv[2:6])
count, folder = int(sys.argv[6]) if len(sys.argv) > 6 else 60, sys.argv[7] if len(sys.argv) > 7 else "."
camera, frames = Camera(name), Frames(name)
for step in range(count):
    angle = 2 * math.pi * step / count
    east, north = x + radius * math.sin(angle), y + radius * math.cos(angle)
    camera.send(t=step, x=east, y=north, z=height, heading=math.degrees(angle) + 180, pitch=-25)
    frame = frames.of_pose(t=step)
    seen = frame["depth"][np.isfinite(frame["depth"])]
    print(f"step {step}: frame {frame['frame']}, ground from {seen.min():.0f} to {seen.max():.0f} m away", flush=True)
camera.end()

depth = frame["depth"]
np.save(f"{folder}/depth.npy", depth)
Image.fromarray(frame["rgba"][..., :3]).save(f"{folder}/color.png")
grey = 255 - 235 * np.log(depth / seen.min()) / np.log(seen.max() / seen.min())  # near is bright, the sky black
Image.fromarray(np.nan_to_num(grey).astype(np.uint8)).save(f"{folder}/depth.png")

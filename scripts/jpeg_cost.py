#!/usr/bin/env python3
"""Processor time of a JPEG by the two encoders that the viewer can be built with, in turns that alternate:

    cargo build --workspace --examples
    scripts/jpeg_cost.py PICTURE.png [--turns 7] [--count 40] [--program target/debug/examples/jpeg_cost]

Medians of the turns, milliseconds a picture, and bytes: of quality 75 with halved chroma, and of 90 without. Needs ffmpeg.
"""

import argparse
import subprocess
import tempfile


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("picture")
    parser.add_argument("--turns", default="7")
    parser.add_argument("--count", default="40")
    parser.add_argument("--program", default="target/debug/examples/jpeg_cost")
    arguments = parser.parse_args()
    probe = ["ffprobe", "-v", "error", "-show_entries", "stream=width,height", "-of", "csv=p=0", arguments.picture]
    width, height = subprocess.check_output(probe, text=True).strip().split(",")
    raw = ["ffmpeg", "-v", "error", "-i", arguments.picture, "-f", "rawvideo", "-pix_fmt", "rgba", "-"]
    with tempfile.NamedTemporaryFile() as file:
        file.write(subprocess.check_output(raw))
        file.flush()
        subprocess.run([arguments.program, file.name, width, height, arguments.turns, arguments.count], check=True)


if __name__ == "__main__":
    main()

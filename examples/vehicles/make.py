#!/usr/bin/env python3
"""Makes the example fleet: models of a truck and of an aircraft (glTF 2.0), and fleet.czml.

    python3 examples/vehicles/make.py [LONGITUDE LATITUDE [COUNT]]

COUNT trucks drive circles around a place (by default one in the world of scripts/fly.sh), and aircraft fly around it.
It needs Python alone, and writes beside itself.
"""

import base64
import json
import math
import struct
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
START = "2026-06-21T10:00:00Z"
METRES_PER_DEGREE = 111_320.0


def box(low, high):
    """Corners of a box, and its faces, each counter-clockwise from outside. Ahead is +z, left +x, up +y, as in glTF."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    corners = [(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in (z0, z1)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, faces


def triangles(shape):
    """The triangles of a shape of corners and faces."""
    corners, faces = shape
    for face in faces:
        for second, third in zip(face[1:], face[2:]):
            yield corners[face[0]], corners[second], corners[third]


def wing(points, thickness):
    """A flat plate over points (x, z) that are counter-clockwise as they are seen from above (x left, z ahead)."""
    half, count = thickness / 2, len(points)
    corners = [(x, half, z) for x, z in points] + [(x, -half, z) for x, z in points]
    faces = [tuple(range(count)), tuple(range(2 * count - 1, count - 1, -1))]
    faces += [(i, count + i, count + (i + 1) % count, (i + 1) % count) for i in range(count)]
    return corners, faces


def upright(shape):
    """A flat shape on its edge: its left side becomes its upper one."""
    corners, faces = shape
    return [(-y, x, z) for x, y, z in corners], faces


def moved(shape, by):
    corners, faces = shape
    return [tuple(a + b for a, b in zip(corner, by)) for corner in corners], faces


def write_model(name, parts):
    """A glTF file of parts, each a linear colour and its shapes."""
    data, views, accessors, primitives, materials = b"", [], [], [], []
    for color, shapes in parts:
        points = [corner for shape in shapes for triangle in triangles(shape) for corner in triangle]
        packed = b"".join(struct.pack("<3f", *point) for point in points)
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(packed)})
        low, high = ([side(point[axis] for point in points) for axis in range(3)] for side in (min, max))
        accessors.append({"bufferView": len(views) - 1, "componentType": 5126, "count": len(points), "type": "VEC3",
                          "min": low, "max": high})
        materials.append({"pbrMetallicRoughness": {"baseColorFactor": [*color, 1]}})
        primitives.append({"attributes": {"POSITION": len(accessors) - 1}, "material": len(materials) - 1})
        data += packed
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    document = {
        "asset": {"version": "2.0", "generator": "examples/vehicles/make.py"},
        "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [{"primitives": primitives}],
        "materials": materials, "accessors": accessors, "bufferViews": views,
        "buffers": [{"byteLength": len(data), "uri": uri}],
    }
    (HERE / name).write_text(json.dumps(document) + "\n")


def models():
    wheels = [box((x - 0.2, 0.0, z - 0.5), (x + 0.2, 1.0, z + 0.5)) for x in (-1.1, 1.1) for z in (-2.7, -1.4, 2.6)]
    windows = [box((-1.0, 1.9, 4.05), (1.0, 2.7, 4.12)), box((-1.27, 1.9, 3.0), (1.27, 2.6, 3.8))]
    write_model("truck.gltf", [
        ((0.55, 0.03, 0.02), [box((-1.25, 0.7, 2.0), (1.25, 2.9, 4.1))]),
        ((0.75, 0.75, 0.72), [box((-1.25, 1.0, -4.0), (1.25, 3.6, 1.9))]),
        ((0.01, 0.01, 0.01), wheels),
        ((0.02, 0.04, 0.07), windows),
    ])
    body = [box((-0.6, -0.6, -4.5), (0.6, 0.6, 3.5)), box((-0.4, -0.45, 3.5), (0.4, 0.35, 4.6))]
    fin = moved(upright(wing([(0.0, -2.9), (0.0, -4.5), (1.9, -4.6), (1.9, -3.9)], 0.12)), (0.0, 0.5, 0.0))
    write_model("aircraft.gltf", [
        ((0.8, 0.8, 0.8), [*body, moved(wing([(-7.0, 0.6), (-7.0, -0.6), (0.0, -1.0), (7.0, -0.6), (7.0, 0.6), (0.0, 1.4)][::-1], 0.16), (0, 0.3, 0))]),
        ((0.02, 0.1, 0.5), [fin, moved(wing([(-2.2, -3.7), (-2.2, -4.5), (2.2, -4.5), (2.2, -3.7)][::-1], 0.1), (0, 0.3, 0))]),
    ])


def circle(longitude, latitude, height, radius, seconds, phase):
    """Samples of a round, anticlockwise as seen from above: seconds, longitude, latitude, height."""
    samples = []
    for step in range(0, int(seconds) + 1, 2):
        angle = phase + math.tau * step / seconds
        east, north = radius * math.cos(angle), radius * math.sin(angle)
        samples += [step, round(longitude + east / METRES_PER_DEGREE / math.cos(math.radians(latitude)), 8),
                    round(latitude + north / METRES_PER_DEGREE, 8), height]
    return samples


def main():
    place = [float(text) for text in sys.argv[1:3]] or [8.9300, 46.9400]
    count = int(sys.argv[3]) if len(sys.argv) > 3 else 24
    models()
    packets = [{"id": "document", "name": "example fleet", "version": "1.0"}]
    for number in range(count):
        ring, phase = number % 6, math.tau * number / count
        radius = 60.0 + 45.0 * ring
        packets.append({
            "id": f"truck {number}",
            "model": {"gltf": "truck.gltf", "heightReference": "CLAMP_TO_GROUND"},
            "point": {"pixelSize": 3, "color": {"rgba": [220, 60, 40, 255]}},
            "position": {"epoch": START, "cartographicDegrees": circle(*place, 0, radius, math.tau * radius / 8, phase)},
        })
    for number in range(max(count // 6, 1)):
        radius = 150.0 + 60.0 * number
        packets.append({
            "id": f"aircraft {number}",
            "model": {"gltf": "aircraft.gltf", "heightReference": "RELATIVE_TO_GROUND"},
            "point": {"pixelSize": 3, "color": {"rgba": [240, 240, 255, 255]}},
            "position": {"epoch": START, "interpolationAlgorithm": "LAGRANGE", "interpolationDegree": 3,
                         "cartographicDegrees": circle(*place, 60 + 25 * number, radius, math.tau * radius / 30, 1.3 * number)},
        })
    (HERE / "fleet.czml").write_text("[\n" + ",\n".join(json.dumps(packet) for packet in packets) + "\n]\n")


if __name__ == "__main__":
    main()

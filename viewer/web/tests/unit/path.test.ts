import assert from 'node:assert/strict';
import { test } from 'node:test';
import type { Pose } from '../../src/math/pose';
import { Spline, type Keyframe } from '../../src/math/spline';
import { turn } from '../../src/math/vector';
import { fromServer, toJson, toKml } from '../../src/paths/file';
import { sideOf } from '../../src/paths/side';

const POSE: Pose = { x: 560_000, y: 5_116_000, z: 3500, heading: 350, pitch: -24, roll: 0, vfov: 60 };
const KEYS: Keyframe[] = [
  { ...POSE, t: 0 },
  { ...POSE, t: 2 },
  { ...POSE, t: 4, x: 560_100, heading: 10 },
  { ...POSE, t: 8, x: 560_200, heading: 30 },
];

const near = (found: number, expected: number, tolerance: number) =>
  assert.ok(Math.abs(found - expected) <= tolerance, `expected ${expected}, found ${found}`);

test('a path goes through its keyframes, rests between equal ones and does not swing out', () => {
  const spline = new Spline(KEYS);
  for (const key of KEYS) {
    near(spline.pose(key.t).x, key.x, 1e-9);
    near(turn(key.heading, spline.pose(key.t).heading), 0, 1e-9);
    near(spline.pose(key.t).pitch, key.pitch, 1e-9);
  }
  near(spline.pose(1).x, 560_000, 1e-9);
  near(turn(0, spline.pose(3).heading), 0, 4);
  let before = -Infinity;
  for (const { x, roll } of spline.samples(81)) {
    assert.ok(x >= before - 1e-9 && Math.abs(roll) < 1e-9);
    before = x;
  }
  assert.deepEqual([spline.start, spline.end], [0, 8]);
  assert.equal(spline.pose(99).x, 560_200);
});

test('a keyframe that rests is come to and left slowly', () => {
  const speed = (keys: Keyframe[], t: number) => (new Spline(keys).pose(t + 0.01).x - new Spline(keys).pose(t).x) / 0.01;
  assert.ok(speed(KEYS, 4) > 25);
  const rests = KEYS.map((key, i) => (i === 2 ? { ...key, rest: true } : key));
  assert.ok(speed(rests, 4) < 1 && speed(rests, 3.98) < 4 && speed(rests, 6) > 25);
});

test('a target is looked at all the time', () => {
  const spline = new Spline(KEYS, [560_100, 5_117_000, 3500]);
  for (const [t, heading] of [[0, 5.710593], [4, 0], [8, -5.710593]] as const) {
    near(turn(heading, spline.pose(t).heading), 0, 1e-6);
    near(spline.pose(t).pitch, 0, 1e-9);
  }
});

test('a path file has rests and the target, and what the server has read comes in', () => {
  const json = toJson({ keyframes: KEYS.map((key, i) => (i === 0 ? { ...key, rest: true } : key)), target: [1, 2, 3.00049] }, 32610);
  const read = fromServer(json, 50);
  assert.deepEqual([read.keyframes[0]!.rest, read.keyframes[1]!.rest, read.target, read.keyframes[0]!.vfov], [true, undefined, [1, 2, 3], 60]);
  near(read.keyframes[2]!.x, 560_100, 1e-9);
  const frames = fromServer('{"fps": 10, "frames": [{"x":1,"y":2,"z":3,"heading":4,"pitch":5},{"x":1,"y":2,"z":3,"heading":4,"pitch":5}]}', 50);
  near(frames.keyframes[1]!.t, 0.1, 1e-12);
  assert.equal(frames.keyframes[1]!.vfov, 50);
});

test('a tour of Google Earth has longitudes, latitudes and true headings', () => {
  const kml = toKml(KEYS, 'a & b', 32610)!;
  assert.match(kml, /<name>a &amp; b<\/name>/);
  assert.equal(kml.match(/<gx:FlyTo>/g)!.length, 4);
  // pyproj, EPSG:32610 to EPSG:4326: -122.22257, 46.19500; the grid is turned by 0.5611 degrees there.
  const number = (tag: string) => Number(new RegExp(`<${tag}>([-\\d.]+)<`).exec(kml)![1]);
  near(number('longitude'), -122.22247, 2e-4);
  near(number('latitude'), 46.195, 1e-3);
  near(number('heading'), 350 + 0.561, 0.02);
  assert.equal(number('tilt'), 66);
  assert.equal(toKml(KEYS, 'w', 2056), undefined);
});

test('from the side a path has heights over distances, above the ground', () => {
  const spline = new Spline(KEYS.map((key, i) => ({ ...key, x: 560_000 + 25 * key.t, z: 3000 + 100 * i })));
  const samples = spline.samples(50);
  const side = sideOf(samples, KEYS, samples.map(() => 2000), { width: 560, height: 150 });
  near(side.length, 200, 1e-6);
  assert.ok(side.low < 2000 && side.high > 3500 && side.ground.endsWith('Z'));
  near(side.heightAt(side.yOf(2750)), 2750, 1e-9);
  near(side.alongAt(0), 0, 1e-9);
  near(side.alongAt(8), 200, 1e-9);
  assert.equal(sideOf(samples, KEYS, [], { width: 560, height: 150 }).ground, '');
});

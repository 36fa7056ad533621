import assert from 'node:assert/strict';
import { test } from 'node:test';
import { apply, cssMatrix, invert, reprojection } from '../../src/math/homography';
import { aboveGround, dragGround, dragSky, fly, lookAt, nearWorld, tiltAbout, turnAbout, zoomTo } from '../../src/math/navigate';
import { axesOf, eyeOf, focalOf, isPose, project, rayThrough, tidy, type Pose } from '../../src/math/pose';
import { eyesOf, poseOfEye, projectIn } from '../../src/math/stereo';
import { add, dot, length, scale, sub, turn, wrap, type Vec3 } from '../../src/math/vector';

const SIZE = { width: 960, height: 540 };
const POSE: Pose = { x: 560_000, y: 5_116_000, z: 3500, heading: 37, pitch: -24, roll: 0, vfov: 60 };

const near = (found: number, expected: number, tolerance: number, what = '') =>
  assert.ok(Math.abs(found - expected) <= tolerance, `${what}: expected ${expected}, found ${found}`);

/** Poses of all kinds, the same ones in every run. */
function* poses(count: number): Generator<Pose> {
  let seed = 1;
  const next = (low: number, high: number) => {
    seed = (seed * 48271) % 2147483647;
    return low + ((high - low) * seed) / 2147483647;
  };
  for (let i = 0; i < count; i++) {
    yield { x: next(-1e5, 1e5), y: next(-1e5, 1e5), z: next(100, 9000), heading: next(0, 360), pitch: next(-89, 5), roll: next(-180, 180), vfov: next(20, 100) };
  }
}

test('axes are those of docs/frame-ring.md: of length 1, square to each other, right-handed', () => {
  const level = axesOf({ ...POSE, heading: 90, pitch: 0, roll: 0 });
  for (const [found, expected] of [
    [level.forward, [1, 0, 0]],
    [level.right, [0, -1, 0]],
    [level.up, [0, 0, 1]],
  ] as const) {
    found.forEach((value, i) => near(value, expected[i]!, 1e-12));
  }
  // Roll is clockwise as seen from behind: the right wing sinks.
  assert.ok(axesOf({ ...POSE, pitch: 0, roll: 30 }).right[2] < 0);
  for (const pose of poses(50)) {
    const { forward, right, up } = axesOf(pose);
    for (const axis of [forward, right, up]) near(length(axis), 1, 1e-12);
    near(dot(forward, right), 0, 1e-12);
    near(dot(forward, up), 0, 1e-12);
    near(dot(right, up), 0, 1e-12);
    near(right[0] * forward[1] - right[1] * forward[0], up[2], 1e-12, 'right × forward = up');
  }
});

test('a point of the picture and the place it shows lead to each other', () => {
  for (const pose of poses(100)) {
    const point = { u: 123.5, v: 400.25 };
    const place = add(eyeOf(pose), scale(rayThrough(pose, SIZE, point), 1234));
    const found = project(pose, SIZE, place)!;
    near(found.u, point.u, 1e-6);
    near(found.v, point.v, 1e-6);
    near(found.depth, 1234, 1e-6);
    assert.equal(project(pose, SIZE, sub(eyeOf(pose), scale(axesOf(pose).forward, 5))), undefined);
  }
});

test('both eyes of a pair see a place where the renderer draws it', () => {
  // As in viewer/src/sight.rs: straight down from a kilometre, eyes 80 m apart.
  const down: Pose = { x: 500, y: 700, z: 1000, heading: 0, pitch: -90, roll: 0, vfov: 90 };
  const [left, right] = eyesOf(80, 1000);
  const size = { width: 200, height: 100 };
  for (const eye of [left, right]) near(projectIn(eye, down, size, [110, 699, 0])!.u, 80.5, 1e-9);
  // What is nearer than where the pictures meet is farther right for the left eye.
  const [near_l, near_r] = [left, right].map((eye) => projectIn(eye, down, size, [500, 700, 500])!.u);
  near(near_l! - near_r!, (50 * 80) / 500 - (50 * 80) / 1000, 1e-9);
});

test('each eye of a pair is moved to where the camera of now sees level ground', () => {
  for (const pose of poses(40)) {
    if (pose.pitch > -10) continue;
    const seen = { ...pose, x: pose.x + 12, heading: pose.heading + 3, pitch: pose.pitch + 1 };
    for (const eye of eyesOf(60, 2000)) {
      const matrix = reprojection(pose, SIZE, seen, { width: 480, height: 270 }, 20, eye);
      const ray = rayThrough(pose, SIZE, { u: 400, v: 500 });
      const from = eyeOf(poseOfEye(pose, eye));
      const place = add(from, scale(ray, (20 - from[2]) / ray[2]));
      const [before, after] = [projectIn(eye, pose, SIZE, place), projectIn(eye, seen, { width: 480, height: 270 }, place)];
      if (before === undefined || after === undefined) continue;
      const found = apply(matrix, before.u, before.v)!;
      near(found.u, after.u, 1e-6);
      near(found.v, after.v, 1e-6);
    }
  }
});

test('the focal length is that of docs/camera-paths.md', () => {
  near(focalOf(POSE, SIZE), 270 / Math.tan(Math.PI / 6), 1e-9);
});

test('a drag holds the ground: the place that was taken is under the cursor', () => {
  for (const pose of [POSE, { ...POSE, roll: 20 }, { ...POSE, pitch: -89 }]) {
    const taken = add(eyeOf(pose), scale(rayThrough(pose, SIZE, { u: 480, v: 400 }), 3000)) as Vec3;
    const cursor = { u: 600, v: 350 };
    const next = dragGround(pose, SIZE, taken, cursor)!;
    const seen = project(next, SIZE, taken)!;
    near(seen.u, cursor.u, 1e-6);
    near(seen.v, cursor.v, 1e-6);
    assert.equal(next.z, pose.z);
  }
});

test('a drag near the horizon holds no ground', () => {
  assert.equal(dragGround({ ...POSE, pitch: 0 }, SIZE, [560_000, 5_200_000, 100], { u: 480, v: 200 }), undefined);
});

test('a drag of the sky turns the camera', () => {
  const next = dragSky(POSE, SIZE, { u: 400, v: 100 }, { u: 410, v: 100 });
  assert.ok(next.heading < POSE.heading);
  assert.equal(next.x, POSE.x);
});

test('turning and tilting about a place leaves it at its distance, and in the middle where it was there', () => {
  for (const pose of poses(60)) {
    const place = add(eyeOf(pose), scale(axesOf(pose).forward, 2500));
    for (const next of [turnAbout(pose, place, 33), tiltAbout(pose, place, -7)]) {
      near(length(sub(eyeOf(next), place)), 2500, 1e-6);
      const seen = project(next, SIZE, place)!;
      near(seen.u, SIZE.width / 2, 1e-6);
      near(seen.v, SIZE.height / 2, 1e-6);
    }
  }
});

test('tilting ends above the place and never goes over the top', () => {
  const place = add(eyeOf(POSE), scale(axesOf(POSE).forward, 2500));
  assert.equal(tiltAbout(POSE, place, -500).pitch, -90);
  assert.ok(tiltAbout(POSE, place, 500).z > place[2]);
});

test('zooming leaves the place under the cursor and the distance goes by the factor', () => {
  for (const pose of poses(60)) {
    const cursor = { u: 300, v: 380 };
    const place = add(eyeOf(pose), scale(rayThrough(pose, SIZE, cursor), 1500));
    const next = zoomTo(pose, place, 0.5);
    const seen = project(next, SIZE, place)!;
    near(seen.u, cursor.u, 1e-6);
    near(seen.v, cursor.v, 1e-6);
    near(seen.depth, 750, 1e-6);
  }
  assert.equal(length(sub(eyeOf(zoomTo(POSE, [560_000, 5_116_000, 3490], 0.001)), [560_000, 5_116_000, 3490])), 3);
});

test('flying goes where the camera looks, and stays out of the ground', () => {
  const north = fly({ ...POSE, heading: 0 }, 100, 10, 1);
  near(north.y - POSE.y, 100, 1e-9);
  near(north.x - POSE.x, 10, 1e-9);
  assert.equal(aboveGround({ ...POSE, z: 90 }, 100).z, 102.5);
  assert.equal(aboveGround(POSE, 100), POSE);
});

test('flying ends where the server would refuse to go on', () => {
  const [start, bounds] = [POSE, [[POSE.x - 1000, POSE.y - 500], [POSE.x + 1000, POSE.y + 500]]] as const;
  assert.equal(nearWorld(start, bounds), start);
  const far = nearWorld({ ...start, x: 1e9, y: -1e9 }, bounds);
  // Twice the longer side from the corner at most.
  const away = Math.hypot(far.x - bounds[1][0], far.y - bounds[0][1]);
  assert.ok(away > 3900 && away < 4000, `${away}`);
});

test('looking at a place from a direction has it in the middle', () => {
  const pose = lookAt([100, 200, 300], 225, 25, 6000, 60);
  const seen = project(pose, SIZE, [100, 200, 300])!;
  near(seen.u, 480, 1e-6);
  near(seen.v, 270, 1e-6);
  near(seen.depth, 6000, 1e-6);
});

test('a camera that only turns is re-projected exactly', () => {
  const seen = { ...POSE, heading: 40, pitch: -20, roll: 5 };
  const matrix = reprojection(POSE, SIZE, seen, { width: 480, height: 270 }, 500);
  for (const point of [{ u: 480, v: 270 }, { u: 100, v: 500 }, { u: 700, v: 60 }]) {
    const place = add(eyeOf(POSE), scale(rayThrough(POSE, SIZE, point), 777));
    const expected = project(seen, { width: 480, height: 270 }, place)!;
    const found = apply(matrix, point.u, point.v)!;
    near(found.u, expected.u, 1e-6);
    near(found.v, expected.v, 1e-6);
  }
});

test('a camera that moves is re-projected over level ground', () => {
  const seen = { ...POSE, x: POSE.x + 120, y: POSE.y - 80, z: POSE.z - 200, heading: 44 };
  const matrix = reprojection(POSE, SIZE, seen, SIZE, 500);
  const point = { u: 400, v: 450 };
  const ray = rayThrough(POSE, SIZE, point);
  const place = add(eyeOf(POSE), scale(ray, (500 - POSE.z) / ray[2]));
  const expected = project(seen, SIZE, place)!;
  const found = apply(matrix, point.u, point.v)!;
  near(found.u, expected.u, 1e-6);
  near(found.v, expected.v, 1e-6);
  const back = apply(invert(matrix)!, found.u, found.v)!;
  near(back.u, point.u, 1e-6);
  near(back.v, point.v, 1e-6);
  assert.match(cssMatrix(matrix), /^matrix3d\((-?[\d.e-]+,){15}-?[\d.e-]+\)$/);
});

test('angles wrap', () => {
  assert.equal(wrap(-10), 350);
  assert.equal(turn(350, 10), 20);
  assert.equal(turn(10, 350), -20);
  assert.equal(tidy({ ...POSE, heading: 725 }).heading, 5);
  assert.deepEqual(Object.keys(tidy({ ...POSE, t: 3 } as Pose)), ['x', 'y', 'z', 'heading', 'pitch', 'roll', 'vfov']);
});

test('what is not a pose is refused', () => {
  assert.ok(isPose(POSE));
  for (const change of [{ x: NaN }, { pitch: 91 }, { vfov: 0 }, { heading: undefined }, { z: '7' }]) assert.ok(!isPose({ ...POSE, ...change }));
});

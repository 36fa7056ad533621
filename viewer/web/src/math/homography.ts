import { axesOf, eyeOf, focalOf, type Pose, type Size } from './pose';
import { MIDDLE, poseOfEye, shiftOf, type Eye } from './stereo';
import { dot, sub, type Vec3 } from './vector';

/** Nine numbers, row after row. */
export type Matrix3 = readonly number[];

export function multiply(a: Matrix3, b: Matrix3): Matrix3 {
  const product: number[] = [];
  for (let row = 0; row < 3; row++) {
    for (let column = 0; column < 3; column++) {
      let sum = 0;
      for (let k = 0; k < 3; k++) sum += a[row * 3 + k]! * b[k * 3 + column]!;
      product.push(sum);
    }
  }
  return product;
}

/** From camera coordinates (right, down, forward) of an eye to pixels. */
function intrinsics(pose: Pose, size: Size, eye: Eye): Matrix3 {
  const f = focalOf(pose, size);
  return [f, 0, size.width / 2 + shiftOf(pose, size, eye), 0, f, size.height / 2, 0, 0, 1];
}

function inverseIntrinsics(pose: Pose, size: Size, eye: Eye): Matrix3 {
  const f = focalOf(pose, size);
  return [1 / f, 0, -(size.width / 2 + shiftOf(pose, size, eye)) / f, 0, 1 / f, -size.height / 2 / f, 0, 0, 1];
}

/** The camera's right, down and forward in the world. */
function rows(pose: Pose): readonly [Vec3, Vec3, Vec3] {
  const { forward, right, up } = axesOf(pose);
  return [right, [-up[0], -up[1], -up[2]], forward];
}

/**
 * Where the pixels of the picture of an eye that was drawn from one pose are seen from another one.
 *
 * What was drawn is taken for a level plane at the height `ground`, so that also a camera that has moved shows the ground
 * about where it is; directions at the horizon and a camera that has only turned come out exactly.
 */
export function reprojection(drawn: Pose, drawnSize: Size, seen: Pose, seenSize: Size, ground: number, eye: Eye = MIDDLE): Matrix3 {
  const from = rows(drawn);
  const to = rows(seen);
  const drawnEye = eyeOf(poseOfEye(drawn, eye));
  const move = sub(drawnEye, eyeOf(poseOfEye(seen, eye)));
  // A point of the plane along a ray d of the drawn camera is at d · below / d.z; homogeneous, it is d + move · d.z / below.
  const below = ground - drawnEye[2];
  const share = below < -1e-6 ? 1 / below : 0;
  const turned: number[] = [];
  for (const row of to) {
    for (const column of from) turned.push(dot(row, column) + dot(row, move) * column[2] * share);
  }
  return multiply(multiply(intrinsics(seen, seenSize, eye), turned), inverseIntrinsics(drawn, drawnSize, eye));
}

/** Where a matrix takes a point; undefined when it goes behind the camera. */
export function apply(m: Matrix3, u: number, v: number): { u: number; v: number } | undefined {
  const w = m[6]! * u + m[7]! * v + m[8]!;
  if (!(w > 0)) return undefined;
  return { u: (m[0]! * u + m[1]! * v + m[2]!) / w, v: (m[3]! * u + m[4]! * v + m[5]!) / w };
}

/** The matrix that undoes another one, up to a factor of the same sign. */
export function invert(m: Matrix3): Matrix3 | undefined {
  const [a, b, c, d, e, f, g, h, i] = m as [number, number, number, number, number, number, number, number, number];
  const determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g);
  if (!(Math.abs(determinant) > 0)) return undefined;
  const sign = Math.sign(determinant);
  return [e * i - f * h, c * h - b * i, b * f - c * e, f * g - d * i, a * i - c * g, c * d - a * f, d * h - e * g, b * g - a * h, a * e - b * d].map(
    (value) => value * sign,
  );
}

/** The same as a CSS transform whose origin is the upper left corner. */
export function cssMatrix(m: Matrix3): string {
  // CSS takes numbers of ordinary size. The sign stays: it says what is in front of the camera.
  const unit = Math.abs(m[8]!) || 1;
  const k = m.map((value) => value / unit);
  const columns = [k[0], k[3], 0, k[6], k[1], k[4], 0, k[7], 0, 0, 1, 0, k[2], k[5], 0, k[8]];
  return `matrix3d(${columns.map((value) => Number(value!.toPrecision(12))).join(',')})`;
}

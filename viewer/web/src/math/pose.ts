import { dot, radians, sub, wrap, type Vec3 } from './vector';

/**
 * Where the camera is and what it looks at: easting, northing and height in metres, angles in degrees.
 * Heading is clockwise from grid north, pitch up from the horizontal, roll clockwise as seen from behind.
 */
export interface Pose {
  readonly x: number;
  readonly y: number;
  readonly z: number;
  readonly heading: number;
  readonly pitch: number;
  readonly roll: number;
  /** Vertical field of view. */
  readonly vfov: number;
}

export interface Axes {
  readonly forward: Vec3;
  readonly right: Vec3;
  readonly up: Vec3;
}

/** Width and height of a picture, in any unit. */
export interface Size {
  readonly width: number;
  readonly height: number;
}

/** A point of the picture, from its upper left corner, in the unit of its size. */
export interface Point {
  readonly u: number;
  readonly v: number;
}

export const eyeOf = (pose: Pose): Vec3 => [pose.x, pose.y, pose.z];
export const withEye = (pose: Pose, eye: Vec3): Pose => ({ ...pose, x: eye[0], y: eye[1], z: eye[2] });

/** The axes of the camera, as docs/frame-ring.md has them. */
export function axesOf(pose: Pose): Axes {
  const h = radians(pose.heading);
  const p = radians(pose.pitch);
  const r = radians(pose.roll);
  const [sh, ch, sp, cp, sr, cr] = [Math.sin(h), Math.cos(h), Math.sin(p), Math.cos(p), Math.sin(r), Math.cos(r)];
  return {
    forward: [sh * cp, ch * cp, sp],
    right: [ch * cr + sh * sp * sr, -sh * cr + ch * sp * sr, -cp * sr],
    up: [ch * sr - sh * sp * cr, -sh * sr - ch * sp * cr, cp * cr],
  };
}

/** The focal length, in the unit of the picture's size. */
export const focalOf = (pose: Pose, size: Size): number => size.height / 2 / Math.tan(radians(pose.vfov) / 2);

/** The direction that a point of the picture shows; its part along the view axis is 1, so that a multiple is a depth. */
export function rayThrough(pose: Pose, size: Size, point: Point): Vec3 {
  const { forward, right, up } = axesOf(pose);
  const f = focalOf(pose, size);
  const a = (point.u - size.width / 2) / f;
  const b = (point.v - size.height / 2) / f;
  return [
    forward[0] + a * right[0] - b * up[0],
    forward[1] + a * right[1] - b * up[1],
    forward[2] + a * right[2] - b * up[2],
  ];
}

/** Where in the picture a place is, and its depth; undefined behind the camera. */
export function project(pose: Pose, size: Size, place: Vec3): (Point & { depth: number }) | undefined {
  const { forward, right, up } = axesOf(pose);
  const away = sub(place, eyeOf(pose));
  const depth = dot(away, forward);
  if (!(depth > 0)) return undefined;
  const f = focalOf(pose, size);
  return { u: size.width / 2 + (f * dot(away, right)) / depth, v: size.height / 2 - (f * dot(away, up)) / depth, depth };
}

/** Whether all numbers of a pose are such that a camera can have them. */
export function isPose(value: unknown): value is Pose {
  if (typeof value !== 'object' || value === null) return false;
  const pose = value as Record<string, unknown>;
  const isNumber = (key: string) => typeof pose[key] === 'number' && Number.isFinite(pose[key]);
  return (
    ['x', 'y', 'z', 'heading', 'pitch', 'roll', 'vfov'].every(isNumber) &&
    Math.abs(pose.pitch as number) <= 90 &&
    (pose.vfov as number) >= 1 &&
    (pose.vfov as number) <= 170
  );
}

export const samePose = (a: Pose, b: Pose): boolean =>
  a.x === b.x && a.y === b.y && a.z === b.z && a.heading === b.heading && a.pitch === b.pitch && a.roll === b.roll && a.vfov === b.vfov;

/** The same pose with its heading as people write it, and without what else its object may have. */
export const tidy = ({ x, y, z, heading, pitch, roll, vfov }: Pose): Pose => ({ x, y, z, heading: wrap(heading), pitch, roll, vfov });

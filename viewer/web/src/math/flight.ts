import { eyeOf, type Pose } from './pose';
import { clamp, length, sub, turn } from './vector';

/** From 0 to 1 with rest at both ends. */
export const ease = (t: number): number => {
  const s = clamp(t, 0, 1);
  return s * s * s * (s * (6 * s - 15) + 10);
};

const mix = (a: number, b: number, t: number): number => a + (b - a) * t;

/**
 * The pose a share t of the way from one pose to another. Heights go in proportion to their logarithm above `ground`, so
 * that a descent from far above does not end in a rush.
 */
export function between(a: Pose, b: Pose, t: number, ground: number): Pose {
  const low = Math.max(1, Math.min(a.z, b.z) - ground);
  const [from, to] = [Math.max(low, a.z - ground), Math.max(low, b.z - ground)];
  const z = t <= 0 ? a.z : t >= 1 ? b.z : ground + from * Math.pow(to / from, t);
  // What moves with the height moves as fast as it, so that the flight is a straight line.
  const along = Math.abs(b.z - a.z) > 1e-3 ? (z - a.z) / (b.z - a.z) : t;
  return {
    x: mix(a.x, b.x, along),
    y: mix(a.y, b.y, along),
    z,
    heading: a.heading + turn(a.heading, b.heading) * t,
    pitch: mix(a.pitch, b.pitch, t),
    roll: a.roll + turn(a.roll, b.roll) * t,
    vfov: mix(a.vfov, b.vfov, t),
  };
}

/** How long a flight from one pose to another takes, seconds: longer ones take longer, but no one waits. */
export function durationOf(a: Pose, b: Pose, clearance: number): number {
  const far = length(sub(eyeOf(a), eyeOf(b))) / Math.max(10, clearance);
  return clamp(0.45 + 0.3 * Math.log1p(far) + Math.abs(turn(a.heading, b.heading)) / 400, 0.45, 2.5);
}

/** A pose and its moment, seconds. */
export interface Keyframe extends Pose {
  readonly t: number;
}

/**
 * The pose of a path at a moment: a piecewise cubic with continuous velocity, at rest between equal keyframes and at the
 * ends. Close to what a flight of the file shows; that one also levels speeds between unevenly spaced keyframes.
 */
export function poseAt(keyframes: readonly Keyframe[], t: number): Pose | undefined {
  const first = keyframes[0];
  const last = keyframes[keyframes.length - 1];
  if (first === undefined || last === undefined) return undefined;
  if (t <= first.t) return first;
  if (t >= last.t) return last;
  let i = 0;
  while (keyframes[i + 1]!.t < t) i++;
  const [a, b] = [keyframes[i]!, keyframes[i + 1]!];
  const span = b.t - a.t;
  const s = (t - a.t) / span;
  const value = (key: keyof Pose, isAngle: boolean): number => {
    const step = (from: Keyframe, to: Keyframe) => (isAngle ? turn(from[key], to[key]) : to[key] - from[key]) / (to.t - from.t);
    const here = step(a, b);
    const before = i > 0 ? step(keyframes[i - 1]!, a) : here;
    const after = i + 2 < keyframes.length ? step(b, keyframes[i + 2]!) : here;
    return hermite(a[key], here, slope(before, here), slope(here, after), span, s);
  };
  return {
    x: value('x', false),
    y: value('y', false),
    z: value('z', false),
    heading: value('heading', true),
    pitch: clamp(value('pitch', false), -90, 90),
    roll: value('roll', true),
    vfov: value('vfov', false),
  };
}

/** The harmonic mean of two speeds of one sign, otherwise rest: the curve does not swing out. */
const slope = (a: number, b: number): number => (a * b > 0 ? (2 * a * b) / (a + b) : 0);

function hermite(from: number, speed: number, atStart: number, atEnd: number, span: number, s: number): number {
  const [s2, s3] = [s * s, s * s * s];
  return (
    from +
    speed * span * (3 * s2 - 2 * s3) +
    atStart * span * (s3 - 2 * s2 + s) +
    atEnd * span * (s3 - s2)
  );
}

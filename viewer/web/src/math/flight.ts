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

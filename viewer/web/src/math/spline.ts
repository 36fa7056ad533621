import type { Pose } from './pose';
import { add, clamp, degrees, length, radians, scale, sub, turn, type Vec3 } from './vector';

/** A pose and its moment, seconds. */
export interface Keyframe extends Pose {
  readonly t: number;
  /** The camera stands still for this moment: it eases in and out. */
  readonly rest?: boolean;
}

/** A rotation: x, y, z, w, of length 1. */
type Quat = readonly [number, number, number, number];

interface Knot {
  t: number;
  position: Vec3;
  attitude: Quat;
  velocity: Vec3;
  /** Rotation vector a second, in the camera's own frame. */
  spin: Vec3;
  roll: number;
  rollSpeed: number;
}

const ZERO: Vec3 = [0, 0, 0];
const STEEPEST_LEVEL = 60;
const WIDEST_LEVEL = 120;
/** A target that is nearer than this gives no direction, metres. */
const NEAREST_TARGET = 1e-6;

const multiply = (a: Quat, b: Quat): Quat => [
  a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
  a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
  a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
  a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
];
const inverse = (q: Quat): Quat => [-q[0], -q[1], -q[2], q[3]];
const negative = (q: Quat): Quat => [-q[0], -q[1], -q[2], -q[3]];

function normal(q: Quat): Quat {
  const size = Math.hypot(...q);
  return [q[0] / size, q[1] / size, q[2] / size, q[3] / size];
}

function fromVector(v: Vec3): Quat {
  const angle = length(v);
  if (angle === 0) return [0, 0, 0, 1];
  const s = Math.sin(angle / 2) / angle;
  return [v[0] * s, v[1] * s, v[2] * s, Math.cos(angle / 2)];
}

function toVector(q: Quat): Vec3 {
  const size = Math.hypot(q[0], q[1], q[2]);
  return size < 1e-8 ? ZERO : scale([q[0], q[1], q[2]], (2 * Math.atan2(size, q[3])) / size);
}

function apply(q: Quat, v: Vec3): Vec3 {
  const [x, y, z] = multiply(multiply(q, [v[0], v[1], v[2], 0]), inverse(q));
  return [x, y, z];
}

/** The rotation that leads from one attitude to another, by the shorter arc where `isShort`. */
function between(a: Quat, b: Quat, isShort: boolean): Vec3 {
  const way = normal(multiply(inverse(a), b));
  return toVector(isShort && way[3] < 0 ? negative(way) : way);
}

const slerp = (a: Quat, b: Quat, s: number): Quat => normal(multiply(a, fromVector(scale(between(a, b, true), s))));

function attitudeOf(pose: Pose): Quat {
  const about = (axis: Vec3, angle: number) => fromVector(scale(axis, radians(angle)));
  return multiply(multiply(about([0, 0, 1], -pose.heading), about([1, 0, 0], pose.pitch)), about([0, 1, 0], pose.roll));
}

type Angles = Pick<Pose, 'heading' | 'pitch' | 'roll'>;

function anglesOf(attitude: Quat): Angles {
  const [right, forward, up] = [apply(attitude, [1, 0, 0]), apply(attitude, [0, 1, 0]), apply(attitude, [0, 0, 1])];
  const pitch = degrees(Math.asin(clamp(forward[2], -1, 1)));
  if (Math.hypot(forward[0], forward[1]) < 1e-9) {
    const ahead = forward[2] > 0 ? scale(up, -1) : up;
    return { heading: degrees(Math.atan2(ahead[0], ahead[1])), pitch, roll: 0 };
  }
  const heading = Math.atan2(forward[0], forward[1]);
  const level: Vec3 = [Math.cos(heading), -Math.sin(heading), 0];
  // The level right crossed with the line of sight.
  const above: Vec3 = [level[1] * forward[2], -level[0] * forward[2], level[0] * forward[1] - level[1] * forward[0]];
  const part = (a: Vec3, b: Vec3) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  return { heading: degrees(heading), pitch, roll: degrees(Math.atan2(-part(right, above), part(right, level))) };
}

const shortened = (v: Vec3, most: number): Vec3 => {
  const size = length(v);
  return size > most ? scale(v, most / size) : v;
};
const mix = (a: Vec3, b: Vec3, s: number): Vec3 => add(a, scale(sub(b, a), s));

interface Slope {
  seconds: number;
  velocity: Vec3;
  spin: Vec3;
  rollSpeed: number;
}

function slopeOf(a: Knot, b: Knot): Slope {
  const seconds = b.t - a.t;
  return {
    seconds,
    velocity: scale(sub(b.position, a.position), 1 / seconds),
    spin: scale(between(a.attitude, b.attitude, false), 1 / seconds),
    rollSpeed: (b.roll - a.roll) / seconds,
  };
}

function fastestSpin({ spin, seconds }: Slope): number {
  const way = length(spin) * seconds;
  return (Math.max(0, Math.min(0.5 * way, 0.45 * (Math.PI - way))) * 3) / seconds;
}

function setSpeeds(knot: Knot, a: Slope | undefined, b: Slope | undefined): void {
  const only = a ?? b;
  if (only === undefined) return;
  if (a === undefined || b === undefined) {
    [knot.velocity, knot.spin, knot.rollSpeed] = [only.velocity, only.spin, only.rollSpeed];
    return;
  }
  const weight = a.seconds / (a.seconds + b.seconds);
  knot.velocity = shortened(mix(a.velocity, b.velocity, weight), 3 * Math.min(length(a.velocity), length(b.velocity)));
  knot.spin = shortened(mix(a.spin, b.spin, weight), Math.min(fastestSpin(a), fastestSpin(b)));
  const most = 3 * Math.min(Math.abs(a.rollSpeed), Math.abs(b.rollSpeed));
  knot.rollSpeed = clamp(a.rollSpeed + (b.rollSpeed - a.rollSpeed) * weight, -most, most);
}

/**
 * The flight through keyframes, as `terravision fly` flies it (launcher/src/path/spline.rs has the same formulas, and their
 * sources): the preview shows what a film will.
 */
export class Spline {
  private readonly knots: Knot[];
  private readonly hasOwnRoll: boolean;
  private readonly vfov: number;

  /** Keyframes in the order of their times, at least one; `target`: what the camera looks at all the time. */
  constructor(
    keys: readonly Keyframe[],
    private readonly target?: Vec3,
  ) {
    this.vfov = keys[0]?.vfov ?? 60;
    const knots: Knot[] = (this.knots = keys.map((key) => ({
      t: key.t,
      position: [key.x, key.y, key.z],
      attitude: attitudeOf(key),
      velocity: ZERO,
      spin: ZERO,
      roll: key.roll,
      rollSpeed: 0,
    })));
    for (let i = 1; i < knots.length; i++) {
      const [before, knot] = [knots[i - 1]!, knots[i]!];
      if (before.attitude.reduce((sum, value, k) => sum + value * knot.attitude[k]!, 0) < 0) knot.attitude = negative(knot.attitude);
      knot.roll = before.roll + turn(before.roll, knot.roll);
    }
    knots.forEach((knot, i) => {
      const [before, after] = [knots[i - 1], knots[i + 1]];
      if (!keys[i]!.rest) setSpeeds(knot, before && slopeOf(before, knot), after && slopeOf(knot, after));
    });
    const isLevel = keys.every((key, i) => {
      const before = keys[i - 1];
      return Math.abs(key.pitch) <= STEEPEST_LEVEL && (before === undefined || Math.abs(turn(before.heading, key.heading)) <= WIDEST_LEVEL);
    });
    this.hasOwnRoll = isLevel || target !== undefined;
  }

  get start(): number {
    return this.knots[0]?.t ?? 0;
  }

  get end(): number {
    return this.knots[this.knots.length - 1]?.t ?? 0;
  }

  /** The pose at a moment; before the first and after the last it stands still. */
  pose(t: number): Pose {
    const after = this.firstAfter(t);
    const [a, b] = [this.knots[Math.max(0, after - 1)]!, this.knots[after]];
    if (b === undefined || after === 0) return this.finished(a.position, anglesOf(a.attitude), a.roll);
    const h = b.t - a.t;
    const s = (t - a.t) / h;
    const [s2, s3] = [s * s, s * s * s];
    const [whole, atStart, atEnd] = [3 * s2 - 2 * s3, h * (s3 - 2 * s2 + s), h * (s3 - s2)];
    const step = scale(sub(b.position, a.position), whole);
    const position = add(add(a.position, step), add(scale(a.velocity, atStart), scale(b.velocity, atEnd)));
    const first = multiply(a.attitude, fromVector(scale(a.spin, h / 3)));
    const second = multiply(b.attitude, fromVector(scale(b.spin, -h / 3)));
    // De Casteljau's construction on the sphere.
    const [c, d, e] = [slerp(a.attitude, first, s), slerp(first, second, s), slerp(second, b.attitude, s)];
    const attitude = slerp(slerp(c, d, s), slerp(d, e, s), s);
    return this.finished(position, anglesOf(attitude), a.roll + (b.roll - a.roll) * whole + a.rollSpeed * atStart + b.rollSpeed * atEnd);
  }

  /** Some poses from the first to the last moment, evenly in time. */
  samples(count: number): (Pose & { t: number })[] {
    const { start, end } = this;
    return Array.from({ length: count }, (_, i) => {
      const t = start + ((end - start) * i) / Math.max(1, count - 1);
      return { ...this.pose(t), t };
    });
  }

  private firstAfter(t: number): number {
    let [low, high] = [0, this.knots.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.knots[middle]!.t <= t) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  private finished(position: Vec3, angles: Angles, roll: number): Pose {
    const [x, y, z] = position;
    const pose = { x, y, z, ...angles, roll: this.hasOwnRoll ? roll : angles.roll, vfov: this.vfov };
    const sight = this.target === undefined ? ZERO : sub(this.target, position);
    if (length(sight) < NEAREST_TARGET) return pose;
    const flat = Math.hypot(sight[0], sight[1]);
    const heading = flat < NEAREST_TARGET ? pose.heading : degrees(Math.atan2(sight[0], sight[1]));
    return { ...pose, heading, pitch: degrees(Math.atan2(sight[2], flat)) };
  }
}

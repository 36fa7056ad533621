import { dragGround, dragSky, tiltAbout, turnAbout, zoomTo } from '../math/navigate';
import type { Point } from '../math/pose';
import type { Vec3 } from '../math/vector';
import type { Viewer } from '../state/viewer';
import type { Motion } from './motion';

const TILT_PER_PIXEL = 0.3;
/** Way of two fingers after which it is clear what they do, pixels. */
const CLEAR_PX = 9;
const TAP_MS = 250;
const DOUBLE_TAP_MS = 350;

interface Finger {
  start: Point;
  at: Point;
}

const middle = (a: Point, b: Point): Point => ({ u: (a.u + b.u) / 2, v: (a.v + b.v) / 2 });
const spread = (a: Point, b: Point): number => Math.max(1, Math.hypot(b.u - a.u, b.v - a.v));
const direction = (a: Point, b: Point): number => Math.atan2(b.v - a.v, b.u - a.u);

/** One finger pans; two zoom and turn, or tilt when both go up or down together. */
export class Touches {
  private readonly fingers = new Map<number, Finger>();
  private gesture: 'unclear' | 'zoom' | 'tilt' = 'unclear';
  private place: Vec3 | undefined | 'unknown' = 'unknown';
  private begun = 0;
  private mostFingers = 0;
  private lastTap = { time: 0, point: { u: 0, v: 0 } };

  constructor(
    private readonly viewer: Viewer,
    private readonly motion: Motion,
  ) {}

  down(id: number, point: Point): void {
    if (this.fingers.size === 0) {
      this.begun = performance.now();
      this.mostFingers = 0;
    }
    this.fingers.set(id, { start: point, at: point });
    this.mostFingers = Math.max(this.mostFingers, this.fingers.size);
    this.beginAnew();
  }

  /** Returns the tap that a finger made, if it was one. */
  up(id: number): { point: Point; isDouble: boolean } | undefined {
    const finger = this.fingers.get(id);
    this.fingers.delete(id);
    this.beginAnew();
    const now = performance.now();
    if (finger === undefined || this.mostFingers > 1 || now - this.begun > TAP_MS || spread(finger.start, finger.at) > CLEAR_PX) return undefined;
    const isDouble = now - this.lastTap.time < DOUBLE_TAP_MS && spread(finger.at, this.lastTap.point) < 40;
    this.lastTap = { time: now, point: finger.at };
    return { point: finger.at, isDouble };
  }

  move(id: number, point: Point, inputAt: number): void {
    const finger = this.fingers.get(id);
    if (finger === undefined) return;
    const before = finger.at;
    finger.at = point;
    if (this.place === 'unknown') return;
    if (this.fingers.size === 1) this.pan(before, point, inputAt);
    else if (this.fingers.size === 2) this.two(id, before, point, inputAt);
  }

  /** What is held is asked for anew whenever a finger comes or goes. */
  private beginAnew(): void {
    this.gesture = 'unclear';
    this.place = 'unknown';
    const points = [...this.fingers.values()].map((finger) => finger.at);
    if (points.length === 0 || points.length > 2) return;
    for (const finger of this.fingers.values()) finger.start = finger.at;
    const held = points.length === 1 ? points[0]! : middle(points[0]!, points[1]!);
    const count = points.length;
    void this.viewer.pick(held).then((hit) => {
      if (this.fingers.size === count) this.place = hit?.place;
    });
  }

  private pan(before: Point, point: Point, inputAt: number): void {
    const pose = this.viewer.pose;
    if (pose === undefined) return;
    const size = this.viewer.eye;
    const place = this.place as Vec3 | undefined;
    const [from, to] = [this.viewer.inEye(before), this.viewer.inEye(point, before)];
    const next = place === undefined ? dragSky(pose, size, from, to) : dragGround(pose, size, place, to);
    if (next !== undefined) this.viewer.setPose(next, inputAt);
  }

  private two(id: number, before: Point, point: Point, inputAt: number): void {
    const [first, second] = [...this.fingers.values()] as [Finger, Finger];
    const isFirst = this.fingers.get(id) === first;
    if (this.gesture === 'unclear') this.gesture = this.recognize(first, second);
    if (this.gesture === 'unclear') return;
    const pose = this.viewer.pose;
    if (pose === undefined) return;
    const place = (this.place as Vec3 | undefined) ?? this.viewer.ahead(middle(first.at, second.at));
    if (place === undefined) return;
    if (this.gesture === 'tilt') {
      // Each finger's way counts half.
      this.viewer.setPose(tiltAbout(pose, place, ((before.v - point.v) / 2) * TILT_PER_PIXEL), inputAt);
      return;
    }
    const [a, b] = isFirst ? [before, second.at] : [first.at, before];
    const factor = spread(a, b) / spread(first.at, second.at);
    const twist = ((direction(a, b) - direction(first.at, second.at)) * 180) / Math.PI;
    const turned = turnAbout(pose, place, -shortest(twist));
    const zoomed = zoomTo(turned, place, factor, 3, this.viewer.worldSide * 1.5);
    const panned = dragGround(zoomed, this.viewer.eye, place, this.viewer.inEye(middle(first.at, second.at)));
    this.motion.stop();
    this.viewer.setPose(panned ?? zoomed, inputAt);
  }

  private recognize(first: Finger, second: Finger): 'unclear' | 'zoom' | 'tilt' {
    const way = (finger: Finger) => ({ u: finger.at.u - finger.start.u, v: finger.at.v - finger.start.v });
    const [a, b] = [way(first), way(second)];
    const change = Math.abs(spread(first.at, second.at) - spread(first.start, second.start));
    const isVertical = (way: Point) => Math.abs(way.v) > 2 * Math.abs(way.u);
    const least = Math.min(Math.abs(a.v), Math.abs(b.v));
    if (isVertical(a) && isVertical(b) && a.v * b.v > 0 && least > CLEAR_PX / 2) return 'tilt';
    const isFar = Math.max(Math.hypot(a.u, a.v), Math.hypot(b.u, b.v)) > 2.5 * CLEAR_PX;
    if (change > CLEAR_PX && isFar) return 'zoom';
    return isFar ? 'zoom' : 'unclear';
  }
}

const shortest = (angle: number): number => ((((angle + 180) % 360) + 360) % 360) - 180;

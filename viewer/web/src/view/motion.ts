import { between, durationOf, ease } from '../math/flight';
import { turnAbout, zoomTo, tiltAbout, look } from '../math/navigate';
import type { Pose } from '../math/pose';
import { clamp, turn, type Vec3 } from '../math/vector';
import type { Viewer } from '../state/viewer';

/** The next pose of a motion after some seconds; undefined when it has ended. */
export type Step = (pose: Pose, seconds: number) => Pose | undefined;

/** Whether the user's system asks for less motion: flights are cuts then. */
export const isMotionReduced = (): boolean => window.matchMedia('(prefers-reduced-motion: reduce)').matches;

/** Longest step, seconds: a page that was in the background does not jump. */
const LONGEST_STEP = 0.1;

/**
 * Moves the camera with the display's frames: one planned motion at a time (a flight to a place, an orbit, a path), and
 * any number of hands that are held (keys, a gamepad).
 */
export class Motion {
  private planned: { step: Step; ended: (() => void) | undefined } | undefined;
  private readonly held = new Map<string, Step>();
  private request: number | undefined;
  private before = 0;

  constructor(readonly viewer: Viewer) {}

  /** Begins with a motion in place of the one before; `ended` is called whether it ends or is replaced. */
  play(step: Step, ended?: () => void): void {
    this.stop();
    this.planned = { step, ended };
    this.wake();
  }

  /** Ends the planned motion where it is. */
  stop(): void {
    const planned = this.planned;
    this.planned = undefined;
    planned?.ended?.();
  }

  hold(name: string, step: Step): void {
    this.held.set(name, step);
    this.wake();
  }

  letGo(name: string): void {
    this.held.delete(name);
  }

  letAllGo(): void {
    this.held.clear();
  }

  /** Flies to a pose; resolves at the end, also when something else comes between. */
  goTo(pose: Pose, seconds?: number): Promise<void> {
    const start = this.viewer.pose;
    if (start === undefined || isMotionReduced() || seconds === 0) {
      this.stop();
      this.viewer.setPose(pose);
      return Promise.resolve();
    }
    const ground = Math.min(this.viewer.ground, start.z - 1, pose.z - 1);
    const duration = seconds ?? durationOf(start, pose, this.viewer.clearance);
    let t = 0;
    return new Promise((resolve) => {
      this.play((_, dt) => {
        if (t >= duration) return undefined;
        t += dt;
        return t >= duration ? pose : between(start, pose, ease(t / duration), ground);
      }, resolve);
    });
  }

  /** Turns and tilts by some degrees about a place (or about the camera itself), softly. */
  turnBy(place: Vec3 | undefined, heading: number, pitch: number): void {
    let left = 1;
    this.play((pose, dt) => {
      if (left <= 0) return undefined;
      const share = isMotionReduced() ? 1 : clamp(dt / 0.25, 0, left);
      left -= share;
      if (place === undefined) return look(pose, heading * share, pitch * share);
      return tiltAbout(turnAbout(pose, place, heading * share), place, pitch * share);
    });
  }

  northUp(place: Vec3 | undefined): void {
    const pose = this.viewer.pose;
    if (pose === undefined) return;
    const roll = -turn(0, pose.roll);
    if (roll !== 0) this.viewer.setPose({ ...pose, roll: 0 });
    this.turnBy(place, turn(pose.heading, 0), 0);
  }

  private zoomLeft = 0;
  private zoomPlace: Vec3 | undefined;

  /** Zooms to a place by a factor of the distance; further calls add to what is left. */
  zoomBy(place: Vec3, factor: number): void {
    this.zoomLeft = clamp(this.zoomLeft + Math.log(factor), -4, 4);
    this.zoomPlace = place;
    const step: Step = (pose, dt) => {
      const share = isMotionReduced() ? 1 : 1 - Math.exp(-dt / 0.07);
      const done = Math.abs(this.zoomLeft) < 0.004 ? this.zoomLeft : this.zoomLeft * share;
      this.zoomLeft -= done;
      const next = zoomTo(pose, this.zoomPlace!, Math.exp(done), 3, this.viewer.worldSide * 1.5);
      if (this.zoomLeft === 0) this.letGo('zoom');
      return next;
    };
    this.stop();
    this.hold('zoom', step);
  }

  private wake(): void {
    if (this.request !== undefined) return;
    this.before = performance.now();
    this.request = requestAnimationFrame((now) => this.tick(now));
  }

  private tick(now: number): void {
    this.request = undefined;
    const seconds = clamp((now - this.before) / 1000, 0, LONGEST_STEP);
    this.before = now;
    let pose = this.viewer.pose;
    if (pose === undefined) return;
    for (const step of [...this.held.values()]) pose = step(pose, seconds) ?? pose;
    if (this.planned !== undefined) {
      const next = this.planned.step(pose, seconds);
      if (next === undefined) this.stop();
      else pose = next;
    }
    // Who is not the pilot moves nothing.
    if (!this.viewer.setPose(pose)) {
      this.letAllGo();
      this.stop();
    }
    if (this.held.size > 0 || this.planned !== undefined) {
      this.request = requestAnimationFrame((next) => this.tick(next));
    }
  }
}

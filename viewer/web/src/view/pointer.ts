import { dragGround, dragSky, look, tiltAbout, turnAbout, zoomTo } from '../math/navigate';
import { eyeOf, type Point, type Pose } from '../math/pose';
import { length, sub, type Vec3 } from '../math/vector';
import type { Viewer } from '../state/viewer';
import type { Motion } from './motion';
import { Touches } from './touch';

/** Degrees for each pixel of a drag that turns. */
const TURN_PER_PIXEL = 0.3;
const HOVER_EVERY_MS = 120;
/** A drag shorter than this is a click, pixels. */
const CLICK_PX = 4;

/** What a click on the picture does when it does not move the camera; true when it took the click. */
export type ClickTool = (point: Point) => boolean;

/** What a drag holds: not known yet, sky, or a place. */
type Held = { kind: 'unknown' } | { kind: 'sky' } | { kind: 'ground'; place: Vec3 };

/** Mouse and pen on the picture; fingers are handed on. */
export class Pointer {
  private drag: { id: number; turns: boolean; start: Point; last: Point; held: Held; isClick: boolean } | undefined;
  private wheel: { at: Point; until: number; place: Promise<Vec3 | undefined> } | undefined;
  private hoveredAt = 0;
  private hover: Point | undefined;
  readonly touches: Touches;
  clickTool: ClickTool | undefined;

  constructor(
    private readonly view: HTMLElement,
    private readonly viewer: Viewer,
    private readonly motion: Motion,
    private readonly refused: () => void,
  ) {
    this.touches = new Touches(viewer, motion);
    view.addEventListener('pointerdown', (event) => this.down(event));
    view.addEventListener('pointermove', (event) => this.move(event));
    view.addEventListener('pointerup', (event) => this.up(event));
    view.addEventListener('pointercancel', (event) => this.up(event));
    view.addEventListener('pointerleave', () => this.left());
    view.addEventListener('wheel', (event) => this.turnWheel(event), { passive: false });
    view.addEventListener('dblclick', (event) => void this.flyThere(this.pointOf(event)));
    view.addEventListener('contextmenu', (event) => event.preventDefault());
    viewer.watchPictures(() => this.hoverAgain());
  }

  private pointOf(event: MouseEvent): Point {
    const box = this.view.getBoundingClientRect();
    return { u: event.clientX - box.left, v: event.clientY - box.top };
  }

  private down(event: PointerEvent): void {
    // What floats above the picture has clicks of its own.
    if (event.target instanceof Element && event.target.closest('button, a, [data-floating]')) return;
    this.view.focus({ preventScroll: true });
    const point = this.pointOf(event);
    this.view.setPointerCapture(event.pointerId);
    if (!this.viewer.isPilot && this.clickTool === undefined) this.refused();
    this.motion.stop();
    if (event.pointerType === 'touch') {
      this.touches.down(event.pointerId, point);
      return;
    }
    if (event.button > 2 || this.drag !== undefined) return;
    const turns = event.button !== 0 || event.ctrlKey;
    const drag = { id: event.pointerId, turns, start: point, last: point, held: { kind: 'unknown' } as Held, isClick: true };
    this.drag = drag;
    void this.viewer.pick(point).then((hit) => {
      drag.held = hit === null ? { kind: 'sky' } : { kind: 'ground', place: hit.place };
    });
  }

  private move(event: PointerEvent): void {
    const point = this.pointOf(event);
    if (event.pointerType === 'touch') {
      this.touches.move(event.pointerId, point, event.timeStamp);
      return;
    }
    const drag = this.drag;
    if (drag === undefined || drag.id !== event.pointerId) {
      this.hover = point;
      this.hoverSoon();
      return;
    }
    if (Math.hypot(point.u - drag.start.u, point.v - drag.start.v) > CLICK_PX) drag.isClick = false;
    // Until the server has said what is held; the way so far is made up for then.
    if (drag.held.kind === 'unknown' || drag.isClick) return;
    const pose = this.viewer.pose;
    if (pose === undefined) return;
    const next = drag.turns ? this.turned(pose, drag.held, drag.last, point) : this.dragged(pose, drag, point);
    drag.last = point;
    this.viewer.setPose(next, event.timeStamp);
  }

  private turned(pose: Pose, held: Held, last: Point, point: Point): Pose {
    const heading = (point.u - last.u) * TURN_PER_PIXEL;
    const pitch = (last.v - point.v) * TURN_PER_PIXEL;
    if (held.kind !== 'ground') return look(pose, heading, pitch);
    return tiltAbout(turnAbout(pose, held.place, heading), held.place, pitch);
  }

  private dragged(pose: Pose, { held, last, start }: { held: Held; last: Point; start: Point }, point: Point): Pose {
    const size = this.viewer.eye;
    const to = this.viewer.inEye(point, start);
    if (held.kind !== 'ground') return dragSky(pose, size, this.viewer.inEye(last, start), to);
    const next = dragGround(pose, size, held.place, to);
    // Near the horizon a pixel is a mile: the ground cannot be held there.
    const most = 4 * length(sub(eyeOf(pose), held.place));
    return next === undefined || length(sub(eyeOf(next), eyeOf(pose))) > most ? pose : next;
  }

  private up(event: PointerEvent): void {
    if (event.pointerType === 'touch') {
      const tap = this.touches.up(event.pointerId);
      if (event.type === 'pointerup') this.tapped(tap);
      return;
    }
    const drag = this.drag;
    if (drag === undefined || drag.id !== event.pointerId) return;
    this.drag = undefined;
    if (drag.isClick && event.type === 'pointerup' && !drag.turns) this.clickTool?.(drag.start);
  }

  private tapped(tap: { point: Point; isDouble: boolean } | undefined): void {
    if (tap === undefined) return;
    const isTaken = this.clickTool?.(tap.point) ?? false;
    if (!isTaken && tap.isDouble) void this.flyThere(tap.point);
  }

  private left(): void {
    this.hover = undefined;
    this.viewer.store.set({ cursor: null });
  }

  private turnWheel(event: WheelEvent): void {
    event.preventDefault();
    if (!this.viewer.isPilot) {
      this.refused();
      return;
    }
    const point = this.pointOf(event);
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? event.deltaY * 33 : event.deltaY;
    const factor = Math.exp(Math.max(-240, Math.min(240, lines)) * 0.002);
    const now = performance.now();
    const wheel = this.wheel;
    const isSame = wheel !== undefined && now < wheel.until && Math.hypot(wheel.at.u - point.u, wheel.at.v - point.v) < 3;
    // One place for as long as the wheel turns: it stays under the cursor.
    if (!isSame) this.wheel = { at: point, until: 0, place: this.placeAt(point) };
    this.wheel!.until = now + 350;
    void this.wheel!.place.then((place) => {
      if (place !== undefined) this.motion.zoomBy(place, factor);
    });
  }

  /** The place under a point; for sky one far ahead, so that the wheel moves on. */
  private async placeAt(point: Point): Promise<Vec3 | undefined> {
    const hit = await this.viewer.pick(point);
    return hit?.place ?? this.viewer.ahead(point);
  }

  private async flyThere(point: Point): Promise<void> {
    if (this.clickTool !== undefined || !this.viewer.isPilot) return;
    const hit = await this.viewer.pick(point);
    const pose = this.viewer.pose;
    if (hit === null || pose === undefined) return;
    await this.motion.goTo(zoomTo(pose, hit.place, 0.35, 20));
  }

  private hoverSoon(): void {
    const now = performance.now();
    if (now - this.hoveredAt < HOVER_EVERY_MS) return;
    this.hoverAgain();
  }

  /** Asks what is under the cursor, now and then. */
  private hoverAgain(): void {
    const point = this.hover;
    const now = performance.now();
    if (point === undefined || now - this.hoveredAt < HOVER_EVERY_MS) return;
    this.hoveredAt = now;
    void this.viewer.pick(point).then((hit) => {
      if (this.hover !== undefined) this.viewer.store.set({ cursor: hit === null ? null : { point: hit.point, distance: hit.distance } });
    });
    // Once more when the pointer has come to rest.
    window.setTimeout(() => {
      if (this.hover !== point && this.hover !== undefined) this.hoverSoon();
    }, HOVER_EVERY_MS + 5);
  }
}

import type { App } from '../app';
import { lookAt } from '../math/navigate';
import { clamp, radians, type Vec3 } from '../math/vector';
import { GroundPicture } from './ground';
import { drawAircraft, drawBorder, drawFootprint, drawMeasure, drawNodes, drawPath, MOST_DOTS } from './layers';
import { MapFrame, wholeWorld, type Region } from './mapview';

const CLICK_PX = 4;
/** So near to a keyframe it is taken hold of. */
const GRAB_PX = 9;

interface Drag {
  start: [number, number];
  last: [number, number];
  moved: boolean;
  /** The keyframe that is pulled along, or the path's target. */
  held: number | 'target' | undefined;
}

/** Draws the map and takes clicks, drags and the wheel. */
export class MapCanvas {
  private region: Region | undefined;
  private request: number | undefined;
  private readonly ends: (() => void)[] = [];
  private readonly ground: GroundPicture;
  private drag: Drag | undefined;
  private isEnded = false;
  /** Whether the nodes of the quad tree are shown. */
  hasNodes = true;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly app: App,
  ) {
    const redraw = () => this.redraw();
    this.ground = new GroundPicture(app.viewer, redraw);
    this.ends.push(app.viewer.store.subscribe(redraw), app.path.store.subscribe(redraw), app.measuring.store.subscribe(redraw));
    const observer = new ResizeObserver(redraw);
    observer.observe(canvas);
    this.ends.push(() => observer.disconnect(), () => this.ground.end());
    canvas.addEventListener('pointerdown', (event) => this.down(event));
    canvas.addEventListener('pointermove', (event) => this.move(event));
    canvas.addEventListener('pointerup', (event) => this.up(event));
    canvas.addEventListener('pointercancel', () => (this.drag = undefined));
    canvas.addEventListener('wheel', (event) => this.wheel(event), { passive: false });
    this.redraw();
  }

  end(): void {
    this.isEnded = true;
    for (const end of this.ends) end();
  }

  zoom(factor: number, at?: [number, number]): void {
    const frame = this.frame();
    const world = this.app.viewer.store.get().world;
    if (frame === undefined || world === undefined) return;
    const [u, v] = at ?? [frame.width / 2, frame.height / 2];
    const whole = wholeWorld(world, frame.width, frame.height);
    const side = clamp(frame.region.side * factor, whole.side / 64, whole.side);
    const [x, y] = frame.toWorld(u, v);
    const share = side / frame.region.side;
    this.region = side === whole.side ? undefined : { x: x + (frame.region.x - x) * share, y: y + (frame.region.y - y) * share, side };
    this.redraw();
  }

  private frame(): MapFrame | undefined {
    const { world } = this.app.viewer.store.get();
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (world === undefined || width === 0 || height === 0) return undefined;
    return new MapFrame(this.region ?? wholeWorld(world, width, height), width, height);
  }

  private at(event: MouseEvent): [number, number] {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  private down(event: PointerEvent): void {
    this.canvas.setPointerCapture(event.pointerId);
    const at = this.at(event);
    this.drag = { start: at, last: at, moved: false, held: this.near(at) };
  }

  /** The keyframe, or the target, at a point of the map. */
  private near([u, v]: [number, number]): Drag['held'] {
    const frame = this.frame();
    const { keyframes, target } = this.app.path.store.get();
    if (frame === undefined || keyframes.length > MOST_DOTS) return undefined;
    const isNear = (x: number, y: number) => {
      const [a, b] = frame.toMap(x, y);
      return Math.hypot(a - u, b - v) < GRAB_PX;
    };
    if (target !== undefined && isNear(target[0], target[1])) return 'target';
    const found = keyframes.findIndex((key) => isNear(key.x, key.y));
    return found < 0 ? undefined : found;
  }

  private move(event: PointerEvent): void {
    const drag = this.drag;
    const frame = this.frame();
    if (frame === undefined) return;
    const [u, v] = this.at(event);
    if (drag === undefined) {
      this.canvas.style.cursor = this.near([u, v]) === undefined ? '' : 'move';
      return;
    }
    if (Math.hypot(u - drag.start[0], v - drag.start[1]) > CLICK_PX) {
      if (drag.held !== undefined) this.pull(drag, frame.toWorld(u, v));
      drag.moved = true;
    }
    if (drag.moved && drag.held === undefined) {
      const { x, y, side } = frame.region;
      this.region = { x: x - (u - drag.last[0]) / frame.scale, y: y + (v - drag.last[1]) / frame.scale, side };
      this.redraw();
    }
    drag.last = [u, v];
  }

  /** Pulls a keyframe, or the target, to a place; heights stay. */
  private pull({ held, moved }: Drag, [x, y]: [number, number]): void {
    const { path } = this.app;
    const target = path.store.get().target;
    if (typeof held === 'number') path.move(held, { x, y }, moved);
    else if (target !== undefined) path.setTarget([x, y, target[2]], moved);
  }

  private up(event: PointerEvent): void {
    const drag = this.drag;
    this.drag = undefined;
    const frame = this.frame();
    if (drag === undefined || drag.moved || frame === undefined) return;
    const [x, y] = frame.toWorld(...this.at(event));
    void this.clicked(x, y);
  }

  private async clicked(x: number, y: number): Promise<void> {
    const { viewer, measuring, motion } = this.app;
    const heights = await viewer.api.heights([[x, y]]).catch(() => undefined);
    const height = heights?.[0];
    if (typeof height !== 'number') {
      viewer.note('info', 'The world has no ground there');
      return;
    }
    if (measuring.store.get().tool !== 'off') {
      measuring.add([x, y, height]);
      return;
    }
    const pose = viewer.pose;
    if (pose === undefined) return;
    if (!viewer.isPilot) {
      viewer.note('info', 'Another one flies: take over first');
      return;
    }
    // The place comes into the middle of the picture, seen as things are seen now.
    const place: Vec3 = [x, y, height * viewer.exaggeration];
    const elevation = clamp(-pose.pitch, 12, 89);
    const distance = clamp(viewer.clearance / Math.sin(radians(elevation)), 50, viewer.worldSide);
    await motion.goTo({ ...lookAt(place, pose.heading + 180, elevation, distance, pose.vfov), roll: 0 });
  }

  private wheel(event: WheelEvent): void {
    event.preventDefault();
    this.zoom(Math.exp(clamp(event.deltaY, -240, 240) * 0.002), this.at(event));
  }

  redraw(): void {
    this.request ??= requestAnimationFrame(() => {
      this.request = undefined;
      if (!this.isEnded) this.draw();
    });
  }

  private draw(): void {
    const frame = this.frame();
    const context = this.canvas.getContext('2d');
    const { world, map } = this.app.viewer.store.get();
    if (frame === undefined || context === null || world === undefined) return;
    const scale = window.devicePixelRatio;
    const [width, height] = [Math.round(frame.width * scale), Math.round(frame.height * scale)];
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    context.setTransform(scale, 0, 0, scale, 0, 0);
    context.fillStyle = '#0b1015';
    context.fillRect(0, 0, frame.width, frame.height);
    this.ground.draw(context, frame, world);
    drawBorder(context, frame, world);
    if (this.hasNodes && map?.tiles) drawNodes(context, frame, world, map.tiles);
    if (map?.footprint) drawFootprint(context, frame, map.footprint);
    drawPath(context, frame, this.app);
    drawMeasure(context, frame, this.app);
    drawAircraft(context, frame, this.app);
  }
}

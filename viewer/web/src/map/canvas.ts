import type { App } from '../app';
import { lookAt } from '../math/navigate';
import { eyeOf, rayThrough } from '../math/pose';
import { clamp, radians, type Vec3 } from '../math/vector';
import { cameraAbove, footprint, MapFrame, wholeWorld, type Region } from './mapview';

/** Picture of the ground, pixels along its side, and the pause before another one is asked for. */
const GROUND_PX = 512;
const GROUND_PAUSE_MS = 500;
const CLICK_PX = 4;

/** Draws the map and takes clicks, drags and the wheel. */
export class MapCanvas {
  private region: Region | undefined;
  private ground: { bitmap: ImageBitmap; region: Region; exaggeration: number } | undefined;
  private groundTimer: number | undefined;
  private request: number | undefined;
  private readonly ends: (() => void)[] = [];
  private drag: { start: [number, number]; last: [number, number]; moved: boolean } | undefined;
  private isEnded = false;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly app: App,
  ) {
    const redraw = () => this.redraw();
    this.ends.push(app.viewer.store.subscribe(redraw), app.path.store.subscribe(redraw), app.measuring.store.subscribe(redraw));
    const observer = new ResizeObserver(redraw);
    observer.observe(canvas);
    this.ends.push(() => observer.disconnect());
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
    window.clearTimeout(this.groundTimer);
    this.ground?.bitmap.close();
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
    this.drag = { start: this.at(event), last: this.at(event), moved: false };
  }

  private move(event: PointerEvent): void {
    const drag = this.drag;
    const frame = this.frame();
    if (drag === undefined || frame === undefined) return;
    const [u, v] = this.at(event);
    if (Math.hypot(u - drag.start[0], v - drag.start[1]) > CLICK_PX) drag.moved = true;
    if (drag.moved) {
      const { x, y, side } = frame.region;
      this.region = { x: x - (u - drag.last[0]) / frame.scale, y: y + (v - drag.last[1]) / frame.scale, side };
      this.redraw();
    }
    drag.last = [u, v];
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

  private redraw(): void {
    this.request ??= requestAnimationFrame(() => {
      this.request = undefined;
      if (!this.isEnded) this.draw();
    });
  }

  private draw(): void {
    const frame = this.frame();
    const context = this.canvas.getContext('2d');
    if (frame === undefined || context === null) return;
    const scale = window.devicePixelRatio;
    const [width, height] = [Math.round(frame.width * scale), Math.round(frame.height * scale)];
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    context.setTransform(scale, 0, 0, scale, 0, 0);
    context.fillStyle = '#0b1015';
    context.fillRect(0, 0, frame.width, frame.height);
    this.askGround(frame);
    this.drawGround(context, frame);
    this.drawPath(context, frame);
    this.drawMeasure(context, frame);
    this.drawAircraft(context, frame);
  }

  /** Asks for a picture of the ground when the one that is there is of another part of the world. */
  private askGround(frame: MapFrame): void {
    const { world, link } = this.app.viewer.store.get();
    const exaggeration = this.app.viewer.exaggeration;
    const { region } = frame;
    const has = this.ground;
    const isSame = has !== undefined && has.exaggeration === exaggeration && has.region.x === region.x && has.region.y === region.y && has.region.side === region.side;
    if (isSame || world === undefined || link.kind !== 'open') return;
    window.clearTimeout(this.groundTimer);
    this.groundTimer = window.setTimeout(() => {
      // A square that covers the longer side of the map.
      const longer = (region.side * Math.max(frame.width, frame.height)) / Math.min(frame.width, frame.height);
      const { pose, metres } = cameraAbove({ ...region, side: longer }, world, this.app.viewer.worldSide, exaggeration);
      this.app.viewer.api
        .still(pose, GROUND_PX, GROUND_PX)
        .then((blob) => createImageBitmap(blob))
        .then((bitmap) => {
          this.ground?.bitmap.close();
          this.ground = { bitmap, region: { ...region, side: region.side }, exaggeration };
          this.groundMetres = metres;
          this.redraw();
        })
        .catch(() => {
          // The map goes on without; the next change of it asks again.
        });
    }, has === undefined ? 0 : GROUND_PAUSE_MS);
  }

  private groundMetres = 0;

  private drawGround(context: CanvasRenderingContext2D, frame: MapFrame): void {
    const { world } = this.app.viewer.store.get();
    if (this.ground !== undefined) {
      const { bitmap, region } = this.ground;
      const half = this.groundMetres / 2;
      const [u, v] = frame.toMap(region.x - half, region.y + half);
      const side = this.groundMetres * frame.scale;
      context.imageSmoothingQuality = 'high';
      context.drawImage(bitmap, u, v, side, side);
    }
    if (world === undefined) return;
    const [[west, south], [east, north]] = world.bounds;
    const [u, v] = frame.toMap(west, north);
    const [u2, v2] = frame.toMap(east, south);
    // What is beyond the world is sky in the picture; on the map it is nothing.
    context.fillStyle = '#0b1015';
    context.beginPath();
    context.rect(0, 0, frame.width, frame.height);
    context.rect(u2, v, u - u2, v2 - v);
    context.fill('evenodd');
    context.strokeStyle = '#44586a';
    context.lineWidth = 1;
    context.strokeRect(u, v, u2 - u, v2 - v);
  }

  private drawPath(context: CanvasRenderingContext2D, frame: MapFrame): void {
    const { keyframes } = this.app.path.store.get();
    if (keyframes.length === 0) return;
    context.strokeStyle = '#ffd479';
    context.lineWidth = 1.5;
    context.beginPath();
    keyframes.forEach((key, i) => {
      const [u, v] = frame.toMap(key.x, key.y);
      if (i === 0) context.moveTo(u, v);
      else context.lineTo(u, v);
    });
    context.stroke();
    if (keyframes.length > 60) return;
    context.fillStyle = '#ffd479';
    for (const key of keyframes) {
      const [u, v] = frame.toMap(key.x, key.y);
      context.beginPath();
      context.arc(u, v, 3, 0, 7);
      context.fill();
    }
  }

  private drawMeasure(context: CanvasRenderingContext2D, frame: MapFrame): void {
    const { points, tool, profile, marked } = this.app.measuring.store.get();
    if (points.length === 0) return;
    context.strokeStyle = context.fillStyle = '#7ddc9a';
    context.lineWidth = 2;
    context.beginPath();
    for (const [x, y] of points) context.lineTo(...frame.toMap(x, y));
    if (tool === 'area') context.closePath();
    context.stroke();
    const station = marked === undefined ? undefined : profile[marked];
    for (const [x, y] of station === undefined ? points : [...points, [station.x, station.y] as const]) {
      context.beginPath();
      context.arc(...frame.toMap(x, y), 3, 0, 7);
      context.fill();
    }
  }

  private drawAircraft(context: CanvasRenderingContext2D, frame: MapFrame): void {
    const { viewer } = this.app;
    const pose = viewer.pose;
    const size = viewer.picture?.size;
    if (pose === undefined || size === undefined) return;
    const corners = [
      { u: 0, v: size.height },
      { u: 0, v: 0 },
      { u: size.width, v: 0 },
      { u: size.width, v: size.height },
    ];
    const rays = corners.map((corner) => rayThrough(pose, size, corner));
    const seen = footprint(rays, eyeOf(pose), viewer.ground, viewer.worldSide * 0.35);
    context.beginPath();
    for (const [x, y] of seen) context.lineTo(...frame.toMap(x, y));
    context.closePath();
    context.fillStyle = 'rgba(120, 190, 255, 0.22)';
    context.strokeStyle = 'rgba(150, 205, 255, 0.9)';
    context.lineWidth = 1;
    context.fill();
    context.stroke();
    const [u, v] = frame.toMap(pose.x, pose.y);
    context.save();
    context.translate(clamp(u, 8, frame.width - 8), clamp(v, 8, frame.height - 8));
    context.rotate(radians(pose.heading));
    context.beginPath();
    // Fuselage, wings and tail of a tiny aircraft.
    for (const [x, y] of AIRCRAFT) context.lineTo(x, y);
    context.closePath();
    context.fillStyle = '#fff';
    context.strokeStyle = '#0b1015';
    context.lineWidth = 1.5;
    context.stroke();
    context.fill();
    context.restore();
  }
}

const AIRCRAFT: readonly [number, number][] = [
  [0, -10], [1.6, -7], [1.6, -2.5], [9, 2], [9, 4], [1.6, 2], [1.2, 6.5], [3.6, 8.5], [3.6, 10],
  [0, 9], [-3.6, 10], [-3.6, 8.5], [-1.2, 6.5], [-1.6, 2], [-9, 4], [-9, 2], [-1.6, -2.5], [-1.6, -7],
];

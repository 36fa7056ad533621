import type { App } from '../app';
import type { World } from '../link/protocol';
import { clamp, radians } from '../math/vector';
import { eachNode, type MapFrame, type Nodes } from './mapview';

type Context = CanvasRenderingContext2D;

/** Of levels, finest first, as the overlay of the tree in the picture has them. */
const LEVELS = ['255,64,64', '255,200,0', '64,220,64', '0,220,255', '64,96,255', '220,64,255', '255,255,255', '255,140,80'];
/** Keyframes that are shown as such: of a recorded flight there are hundreds. */
export const MOST_DOTS = 60;
/** Samples of the way that are drawn. */
const WAY_SAMPLES = 240;

/** The border of the world; what is beyond it is sky in the picture, and nothing on the map. */
export function drawBorder(context: Context, frame: MapFrame, world: World): void {
  const [[west, south], [east, north]] = world.bounds;
  const [u, v] = frame.toMap(west, north);
  const [u2, v2] = frame.toMap(east, south);
  context.fillStyle = '#0b1015';
  context.beginPath();
  context.rect(0, 0, frame.width, frame.height);
  context.rect(u2, v, u - u2, v2 - v);
  context.fill('evenodd');
  context.strokeStyle = '#44586a';
  context.lineWidth = 1;
  context.strokeRect(u, v, u2 - u, v2 - v);
}

/** Nodes whose tiles are in memory, by level, and those that are wanted, dashed. */
export function drawNodes(context: Context, frame: MapFrame, world: World, nodes: Nodes): void {
  context.save();
  context.lineWidth = 1;
  eachNode(nodes.resident, world, (level, west, south, east, north) => {
    const color = LEVELS[level % LEVELS.length]!;
    const [u, v] = frame.toMap(west, north);
    const [u2, v2] = frame.toMap(east, south);
    // Many small ones would cover the ground.
    const strength = Math.min(0.45, (u2 - u) / 40);
    context.fillStyle = `rgba(${color},0.05)`;
    context.strokeStyle = `rgba(${color},${strength.toFixed(2)})`;
    context.fillRect(u, v, u2 - u, v2 - v);
    context.strokeRect(u + 0.5, v + 0.5, u2 - u - 1, v2 - v - 1);
  });
  context.setLineDash([3, 3]);
  eachNode(nodes.wanted, world, (level, west, south, east, north) => {
    const [u, v] = frame.toMap(west, north);
    const [u2, v2] = frame.toMap(east, south);
    context.strokeStyle = `rgba(${LEVELS[level % LEVELS.length]!},0.95)`;
    context.strokeRect(u + 0.5, v + 0.5, u2 - u - 1, v2 - v - 1);
  });
  context.restore();
}

function dot(context: Context, u: number, v: number, radius = 3): void {
  context.beginPath();
  context.arc(u, v, radius, 0, 7);
  context.fill();
}

export function drawPath(context: Context, frame: MapFrame, { path }: App): void {
  const { keyframes, target } = path.store.get();
  const way = path.spline?.samples(Math.min(WAY_SAMPLES, keyframes.length * 24));
  if (way === undefined) return;
  context.strokeStyle = context.fillStyle = '#ffd479';
  context.lineWidth = 1.5;
  context.beginPath();
  for (const { x, y } of way) context.lineTo(...frame.toMap(x, y));
  context.stroke();
  if (keyframes.length <= MOST_DOTS) for (const key of keyframes) dot(context, ...frame.toMap(key.x, key.y), 3.5);
  if (target === undefined) return;
  const [u, v] = frame.toMap(target[0], target[1]);
  context.beginPath();
  for (const [du, dv] of [[-7, 0], [7, 0], [0, -7], [0, 7]] as const) {
    context.moveTo(u + du * 0.3, v + dv * 0.3);
    context.lineTo(u + du, v + dv);
  }
  context.stroke();
}

export function drawMeasure(context: Context, frame: MapFrame, { measuring }: App): void {
  const { points, tool, profile, marked } = measuring.store.get();
  if (points.length === 0) return;
  context.strokeStyle = context.fillStyle = '#7ddc9a';
  context.lineWidth = 2;
  context.beginPath();
  for (const [x, y] of points) context.lineTo(...frame.toMap(x, y));
  if (tool === 'area') context.closePath();
  context.stroke();
  const station = marked === undefined ? undefined : profile[marked];
  for (const [x, y] of station === undefined ? points : [...points, [station.x, station.y] as const]) dot(context, ...frame.toMap(x, y));
}

/** The ground that the picture shows, as the server has seen it. */
export function drawFootprint(context: Context, frame: MapFrame, footprint: readonly (readonly [number, number])[]): void {
  context.beginPath();
  for (const [x, y] of footprint) context.lineTo(...frame.toMap(x, y));
  context.closePath();
  context.fillStyle = 'rgba(120, 190, 255, 0.22)';
  context.strokeStyle = 'rgba(150, 205, 255, 0.9)';
  context.lineWidth = 1;
  context.fill();
  context.stroke();
}

export function drawAircraft(context: Context, frame: MapFrame, { viewer }: App): void {
  const pose = viewer.pose;
  if (pose === undefined) return;
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

const AIRCRAFT: readonly [number, number][] = [
  [0, -10], [1.6, -7], [1.6, -2.5], [9, 2], [9, 4], [1.6, 2], [1.2, 6.5], [3.6, 8.5], [3.6, 10],
  [0, 9], [-3.6, 10], [-3.6, 8.5], [-1.2, 6.5], [-1.6, 2], [-9, 4], [-9, 2], [-1.6, -2.5], [-1.6, -7],
];

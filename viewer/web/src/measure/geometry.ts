import type { Vec3 } from '../math/vector';

/** A place with the height of the ground there; null where there is none. */
export interface Station {
  x: number;
  y: number;
  /** Metres along the line from its start, in the plane. */
  along: number;
  height: number | null;
}

const step = (a: Vec3, b: Vec3): number => Math.hypot(b[0] - a[0], b[1] - a[1]);

/** Length of a line in the plane. */
export function planLength(points: readonly Vec3[]): number {
  let sum = 0;
  for (let i = 1; i < points.length; i++) sum += step(points[i - 1]!, points[i]!);
  return sum;
}

/** Length over the ground, up and down included. */
export function groundLength(stations: readonly Station[]): number {
  let sum = 0;
  for (let i = 1; i < stations.length; i++) {
    const [a, b] = [stations[i - 1]!, stations[i]!];
    const rise = a.height === null || b.height === null ? 0 : b.height - a.height;
    sum += Math.hypot(b.along - a.along, rise);
  }
  return sum;
}

/** Area of a polygon in the plane, whatever way round it goes. */
export function planArea(points: readonly Vec3[]): number {
  let sum = 0;
  // From the first point, so that coordinates of millions of metres lose no digits.
  const origin = points[0];
  if (origin === undefined) return 0;
  for (let i = 0; i < points.length; i++) {
    const [a, b] = [points[i]!, points[(i + 1) % points.length]!];
    sum += (a[0] - origin[0]) * (b[1] - origin[1]) - (b[0] - origin[0]) * (a[1] - origin[1]);
  }
  return Math.abs(sum) / 2;
}

/** Places along a line, evenly spread over its length, its corners among them. */
export function stationsAlong(points: readonly Vec3[], count: number): Station[] {
  const total = planLength(points);
  if (points.length === 0) return [];
  if (total === 0) return [{ x: points[0]![0], y: points[0]![1], along: 0, height: null }];
  const stations: Station[] = [];
  let before = 0;
  for (let i = 1; i < points.length; i++) {
    const [a, b] = [points[i - 1]!, points[i]!];
    const length = step(a, b);
    const pieces = Math.max(1, Math.round((count * length) / total));
    for (let k = i === 1 ? 0 : 1; k <= pieces; k++) {
      const share = k / pieces;
      stations.push({ x: a[0] + (b[0] - a[0]) * share, y: a[1] + (b[1] - a[1]) * share, along: before + length * share, height: null });
    }
    before += length;
  }
  return stations;
}

/** Ascent and descent along a line. */
export function climbs(stations: readonly Station[]): { up: number; down: number } {
  let [up, down] = [0, 0];
  for (let i = 1; i < stations.length; i++) {
    const [a, b] = [stations[i - 1]!.height, stations[i]!.height];
    if (a === null || b === null) continue;
    if (b > a) up += b - a;
    else down += a - b;
  }
  return { up, down };
}

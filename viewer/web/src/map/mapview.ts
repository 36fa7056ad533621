import type { Pose } from '../math/pose';
import type { World } from '../link/protocol';

/** A part of the world, and how it lies on the map: north is up. */
export interface Region {
  /** Middle. */
  x: number;
  y: number;
  /** Metres along the shorter side of the map. */
  side: number;
}

/** All of the world, with a small margin. */
export function wholeWorld(world: World, width: number, height: number): Region {
  const [[west, south], [east, north]] = world.bounds;
  const shorter = Math.min(width, height);
  const side = Math.max(((east - west) * shorter) / width, ((north - south) * shorter) / height) * 1.04;
  return { x: (west + east) / 2, y: (south + north) / 2, side };
}

/** Places of the world on a map of some size, and back. */
export class MapFrame {
  readonly scale: number;

  constructor(
    readonly region: Region,
    readonly width: number,
    readonly height: number,
  ) {
    this.scale = Math.min(width, height) / region.side;
  }

  toMap(x: number, y: number): [number, number] {
    return [this.width / 2 + (x - this.region.x) * this.scale, this.height / 2 - (y - this.region.y) * this.scale];
  }

  toWorld(u: number, v: number): [number, number] {
    return [this.region.x + (u - this.width / 2) / this.scale, this.region.y - (v - this.height / 2) / this.scale];
  }
}

/**
 * A camera far above that looks straight down: its picture is the map. So far away is it that mountains stand aside by a few
 * pixels at most.
 */
export function cameraAbove(region: Region, world: World, worldSide: number, exaggeration: number): { pose: Pose; metres: number } {
  // What is below this height stands aside to the middle, and leaves a strip of sky at the world's rim: most ground is above.
  const plane = world.heights === null ? 0 : (0.9 * world.heights[0] + 0.1 * world.heights[1]) * exaggeration;
  const above = 1.8 * worldSide;
  // Fields of view below a degree are refused.
  const side = Math.max(region.side, above * 2 * Math.tan(Math.PI / 360) * 1.001);
  const vfov = (2 * Math.atan(side / 2 / above) * 180) / Math.PI;
  return { pose: { x: region.x, y: region.y, z: plane + above, heading: 0, pitch: -90, roll: 0, vfov }, metres: side };
}

/** Nodes of the quad tree: level, m and n of each, one behind the other. */
export interface Nodes {
  resident: readonly number[];
  wanted: readonly number[];
}

/** Calls a function with level and borders of each node. */
export function eachNode(list: readonly number[], world: World, call: (level: number, west: number, south: number, east: number, north: number) => void): void {
  const [[west, south]] = world.bounds;
  for (let i = 0; i + 2 < list.length; i += 3) {
    const [level, m, n] = [list[i]!, list[i + 1]!, list[i + 2]!];
    const [wide, high] = [world.node_side[0] * 2 ** level, world.node_side[1] * 2 ** level];
    call(level, west + m * wide, south + n * high, west + (m + 1) * wide, south + (n + 1) * high);
  }
}

import type { Point } from '../math/pose';
import type { Vec3 } from '../math/vector';
import { Store } from '../state/store';
import type { Viewer } from '../state/viewer';
import { stationsAlong, type Station } from './geometry';

export type Tool = 'off' | 'point' | 'line' | 'area';

export interface MeasureState {
  tool: Tool;
  /** Places on the ground, heights without exaggeration. */
  points: readonly Vec3[];
  /** Heights along the line, when they have come. */
  profile: readonly Station[];
  /** The station that the cursor is at in the profile. */
  marked: number | undefined;
  problem: string | undefined;
}

/** Heights that are asked for along a line. */
const STATIONS = 400;
const MOST_POINTS = 200;

/** The places that a user clicks at, and the heights between them. */
export class Measuring {
  readonly store = new Store<MeasureState>({ tool: 'off', points: [], profile: [], marked: undefined, problem: undefined });
  private asked = 0;

  constructor(private readonly viewer: Viewer) {}

  use(tool: Tool): void {
    this.asked++;
    this.store.set({ tool, points: [], profile: [], marked: undefined, problem: undefined });
  }

  /** A click on the picture; true when a tool took it. */
  click(point: Point): boolean {
    if (this.store.get().tool === 'off') return false;
    void this.viewer.pick(point).then((hit) => {
      if (hit === null) this.viewer.note('info', 'No ground there to measure');
      else this.add(hit.point);
    });
    return true;
  }

  add(place: Vec3): void {
    const { tool, points } = this.store.get();
    if (tool === 'off' || points.length >= MOST_POINTS) return;
    this.setPoints(tool === 'point' ? [place] : [...points, place]);
  }

  removeLast(): void {
    this.setPoints(this.store.get().points.slice(0, -1));
  }

  mark(station: number | undefined): void {
    this.store.set({ marked: station });
  }

  private setPoints(points: readonly Vec3[]): void {
    this.store.set({ points, profile: [], marked: undefined, problem: undefined });
    void this.askHeights(points);
  }

  private async askHeights(points: readonly Vec3[]): Promise<void> {
    const order = ++this.asked;
    const { tool } = this.store.get();
    const line = tool === 'area' && points.length > 2 ? [...points, points[0]!] : points;
    const stations = stationsAlong(line, STATIONS);
    if (stations.length === 0) return;
    try {
      const heights = await this.viewer.api.heights(stations.map(({ x, y }) => [x, y] as const), this.viewer.store.get().limits?.heights);
      if (order === this.asked) this.store.set({ profile: stations.map((station, i) => ({ ...station, height: heights[i] ?? null })) });
    } catch (error) {
      if (order === this.asked) this.store.set({ problem: error instanceof Error ? error.message : String(error) });
    }
  }
}

import { MARGIN, ticks } from '../measure/chart';
import type { Pose, Size } from '../math/pose';
import type { Keyframe } from '../math/spline';

/** A path from the side, in the coordinates of a drawing. */
export interface Side {
  /** Metres along the way. */
  length: number;
  low: number;
  high: number;
  /** The way, and the ground below it closed at the bottom; '' while it is not known. */
  way: string;
  ground: string;
  yTicks: number[];
  xOf(along: number): number;
  yOf(height: number): number;
  /** Metres along the way at a moment. */
  alongAt(t: number): number;
  /** The height that a place of the drawing means. */
  heightAt(y: number): number;
}

/** Of samples of the way, evenly in time; `ground`: heights below them, or none. */
export function sideOf(samples: readonly (Pose & { t: number })[], keyframes: readonly Keyframe[], ground: readonly (number | null)[], { width, height }: Size): Side {
  const along = [0];
  for (let i = 1; i < samples.length; i++) {
    const [a, b] = [samples[i - 1]!, samples[i]!];
    along.push(along[i - 1]! + Math.hypot(b.x - a.x, b.y - a.y));
  }
  const length = along[along.length - 1]!;
  const hasGround = ground.length === samples.length;
  const heights = [...samples, ...keyframes].map(({ z }) => z).concat(hasGround ? ground.filter((value) => value !== null) : []);
  const [lowest, highest] = [Math.min(...heights), Math.max(...heights)];
  const pad = Math.max(20, (highest - lowest) * 0.12);
  const [low, high] = [lowest - pad, highest + pad];
  const inner = { width: width - MARGIN.left - MARGIN.right, height: height - MARGIN.top - MARGIN.bottom };
  const xOf = (value: number) => MARGIN.left + (length > 0 ? value / length : 0) * inner.width;
  const yOf = (value: number) => MARGIN.top + (1 - (value - low) / (high - low)) * inner.height;
  const line = (of: (i: number) => number | null | undefined) =>
    samples
      .map((_, i) => [i, of(i)] as const)
      .filter((entry): entry is readonly [number, number] => entry[1] != null)
      .map(([i, value]) => `${xOf(along[i]!).toFixed(1)},${yOf(value).toFixed(1)}`);
  const below = hasGround ? line((i) => ground[i]) : [];
  const bottom = (MARGIN.top + inner.height).toFixed(1);
  const [start, end] = [samples[0]!.t, samples[samples.length - 1]!.t];
  return {
    length,
    low,
    high,
    way: `M${line((i) => samples[i]!.z).join('L')}`,
    ground: below.length < 2 ? '' : `M${below.join('L')}L${below[below.length - 1]!.split(',')[0]},${bottom}L${below[0]!.split(',')[0]},${bottom}Z`,
    yTicks: ticks(low, high, Math.max(2, Math.floor(inner.height / 32))),
    xOf,
    yOf,
    alongAt(t) {
      const at = end > start ? ((t - start) / (end - start)) * (samples.length - 1) : 0;
      const i = Math.min(samples.length - 1, Math.max(0, Math.floor(at)));
      const next = Math.min(samples.length - 1, i + 1);
      return along[i]! + (along[next]! - along[i]!) * Math.min(1, Math.max(0, at - i));
    },
    heightAt: (y) => low + (1 - (y - MARGIN.top) / inner.height) * (high - low),
  };
}

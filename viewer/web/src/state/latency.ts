import type { PictureHeader } from '../link/protocol';

/** Milliseconds from an input to the picture that shows it, and where they went. */
export interface LatencySummary {
  samples: number;
  medianMs: number;
  p95Ms: number;
  /** Medians of the parts: until the frame was drawn, encoded, and on the screen (both ways of the network, decoding). */
  drawMs: number;
  encodeMs: number;
  restMs: number;
}

interface Sample {
  total: number;
  draw: number;
  encode: number;
}

const KEPT = 120;
/** Poses that are remembered until their picture comes. */
const OPEN_POSES = 600;

/** Intervals that are kept, and the longest that counts as one. */
export const INTERVALS = 200;
const LONGEST_INTERVAL_MS = 1000;

const quantile = (values: number[], q: number): number => {
  const sorted = [...values].sort((a, b) => a - b);
  return sorted[Math.min(sorted.length - 1, Math.floor(q * sorted.length))] ?? 0;
};

/** Measures latency: a pose was sent because of an input at a moment, and its picture is shown at another one. */
export class Latency {
  private readonly sent = new Map<number, number>();
  private samples: Sample[] = [];
  private before: number | undefined;
  /** Milliseconds from picture to picture while pictures come, oldest first. */
  readonly intervals: number[] = [];

  poseSent(id: number, inputAt: number): void {
    this.sent.set(id, inputAt);
    if (this.sent.size > OPEN_POSES) this.sent.delete(this.sent.keys().next().value!);
  }

  pictureShown(header: PictureHeader, now: number): void {
    // A rest is not a slow picture.
    if (this.before !== undefined && now - this.before < LONGEST_INTERVAL_MS) this.intervals.push(now - this.before);
    if (this.intervals.length > INTERVALS) this.intervals.shift();
    this.before = now;
    const inputAt = this.sent.get(header.poseId);
    if (inputAt === undefined) return;
    // A later picture of the same pose is a finer one, no answer to the input.
    for (const id of this.sent.keys()) if (id <= header.poseId) this.sent.delete(id);
    this.samples.push({
      total: now - inputAt,
      draw: header.drawnMs - header.poseMs,
      encode: header.handedMs - header.drawnMs,
    });
    if (this.samples.length > KEPT) this.samples.shift();
  }

  clear(): void {
    this.sent.clear();
  }

  summary(): LatencySummary | undefined {
    if (this.samples.length === 0) return undefined;
    const median = (part: (sample: Sample) => number) => quantile(this.samples.map(part), 0.5);
    return {
      samples: this.samples.length,
      medianMs: median((s) => s.total),
      p95Ms: quantile(this.samples.map((s) => s.total), 0.95),
      drawMs: median((s) => s.draw),
      encodeMs: median((s) => s.encode),
      restMs: median((s) => s.total - s.draw - s.encode),
    };
  }
}

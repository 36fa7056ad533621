import { nearWorld } from './math/navigate';
import { isPose, type Pose } from './math/pose';
import type { LatencySummary } from './state/latency';
import type { Viewer } from './state/viewer';
import type { Motion } from './view/motion';

export interface FrameOfPrograms {
  n: number;
  pose: Pose;
  width: number;
  height: number;
  kind: 'jpeg' | 'png' | 'h264';
  isAtRest: boolean;
  isExact: boolean;
  /** Red, green, blue and 255 of every pixel, rows from the top. */
  pixels: Uint8ClampedArray;
}

/** What other programs do with the page: `window.terravision`, and the same by messages. */
export interface Programs {
  /** The camera of now; null before the server has said where it is. */
  pose(): Pose | null;
  /** Flies there, or jumps with `seconds` 0; resolves on arrival. Keys that are missing stay as they are. */
  goTo(pose: Partial<Pose>, options?: { seconds?: number }): Promise<void>;
  /** Resolves when the shown picture is the final, exact one of the camera of now. */
  settled(): Promise<void>;
  /** The shown picture. */
  frame(): FrameOfPrograms | null;
  latency(): LatencySummary | null;
}

declare global {
  interface Window {
    terravision: Programs;
  }
}

export function programsOf(viewer: Viewer, motion: Motion): Programs {
  return {
    pose: () => viewer.pose ?? null,
    async goTo(change, options) {
      const pose = { ...viewer.pose, ...change };
      if (!isPose(pose)) throw new Error('goTo: expected finite numbers x, y, z, heading, pitch (-90 to 90), roll, vfov (1 to 170)');
      const seconds = options?.seconds;
      if (seconds !== undefined && !(seconds >= 0 && Number.isFinite(seconds))) throw new Error(`goTo: expected seconds from 0, found ${String(seconds)}`);
      const bounds = viewer.store.get().world?.bounds;
      if (bounds !== undefined && nearWorld(pose, bounds) !== pose) throw new Error(`goTo: expected a place near the world, found ${pose.x}, ${pose.y}`);
      if (!viewer.isPilot) throw new Error('goTo: another one is the pilot');
      await motion.goTo(pose, seconds);
    },
    settled: () =>
      new Promise((resolve) => {
        if (viewer.isSettled) return resolve();
        const end = viewer.watchPictures(() => {
          if (!viewer.isSettled) return;
          end();
          resolve();
        });
      }),
    frame() {
      const shown = viewer.picture?.shown;
      const pixels = viewer.picture?.pixels();
      if (shown === undefined || pixels === undefined) return null;
      const { n, pose, width, height, kind, isAtRest, isExact } = shown;
      return { n, pose, width, height, kind, isAtRest, isExact, pixels: pixels.data };
    },
    latency: () => viewer.latency.summary() ?? null,
  };
}

interface Call {
  terravision: 1;
  id: unknown;
  call: keyof Programs;
  args?: unknown[];
}

const isCall = (data: unknown): data is Call =>
  typeof data === 'object' && data !== null && (data as Call).terravision === 1 && typeof (data as Call).call === 'string';

/**
 * Answers the page that embeds this one. Which pages may do so the server decides: browsers show this page in the frames
 * of those alone.
 */
export function answerMessages(programs: Programs): void {
  if (window.parent === window) return;
  window.addEventListener('message', (event) => {
    if (event.source !== window.parent || !isCall(event.data)) return;
    const { id, call, args } = event.data;
    const answer = (result: object) => window.parent.postMessage({ terravision: 1, id, ...result }, event.origin);
    const method = Object.hasOwn(programs, call) ? (programs[call] as (...args: unknown[]) => unknown) : undefined;
    if (method === undefined) {
      answer({ error: `expected one of ${Object.keys(programs).join(', ')}, found ${String(call)}` });
      return;
    }
    Promise.resolve()
      .then(() => method(...(args ?? [])))
      .then(
        (value) => answer({ value: value ?? null }),
        (error: unknown) => answer({ error: error instanceof Error ? error.message : String(error) }),
      );
  });
}

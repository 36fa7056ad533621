import { Spline, type Keyframe } from '../math/spline';
import { turnAbout } from '../math/navigate';
import type { Pose } from '../math/pose';
import { clamp, turn, type Vec3 } from '../math/vector';
import { Store } from '../state/store';
import type { Viewer } from '../state/viewer';
import type { Motion } from '../view/motion';
import type { Path } from './file';

export type Mode = 'free' | 'orbit' | 'planned';

export interface PathState extends Path {
  mode: Mode;
  /** Moment of the path that is shown, seconds. */
  t: number;
  speed: number;
  isPlaying: boolean;
  isRecording: boolean;
  canUndo: boolean;
  /** Why a file was not loaded. */
  problem: string | undefined;
}

/** Seconds from one keyframe to the next, when it is added by hand. */
const KEYFRAME_SECONDS = 4;
/** A recorded flight has a keyframe this often, seconds. */
const RECORD_EVERY = 0.25;
/** Degrees a second of the orbit. */
const ORBIT_SPEED = 9;
const MOST_UNDONE = 50;

/** The flight plan: keyframes, recording, playing. */
export class PathEditor {
  readonly store = new Store<PathState>({
    mode: 'free',
    keyframes: [],
    target: undefined,
    t: 0,
    speed: 1,
    isPlaying: false,
    isRecording: false,
    canUndo: false,
    problem: undefined,
  });
  private past: Path[] = [];
  private flown: { of: Path; spline: Spline } | undefined;
  private recording: number | undefined;

  constructor(
    private readonly viewer: Viewer,
    private readonly motion: Motion,
  ) {}

  get duration(): number {
    const { keyframes } = this.store.get();
    return keyframes.length < 2 ? 0 : keyframes[keyframes.length - 1]!.t - keyframes[0]!.t;
  }

  /** The way through the keyframes; undefined without one. */
  get spline(): Spline | undefined {
    const { keyframes, target } = this.store.get();
    if (keyframes.length === 0) return undefined;
    if (this.flown === undefined || this.flown.of.keyframes !== keyframes || this.flown.of.target !== target) {
      this.flown = { of: { keyframes, target }, spline: new Spline(keyframes, target) };
    }
    return this.flown.spline;
  }

  setMode(mode: Mode): void {
    this.pause();
    this.store.set({ mode });
  }

  /** The camera of now becomes the last keyframe. */
  addKeyframe(): void {
    const pose = this.viewer.pose;
    if (pose === undefined) return;
    const { keyframes } = this.store.get();
    const last = keyframes[keyframes.length - 1];
    const t = last === undefined ? 0 : last.t + KEYFRAME_SECONDS;
    this.change([...keyframes, { ...pose, t }]);
    this.store.set({ t });
    this.viewer.note('info', `Keyframe ${keyframes.length + 1} at ${t} s`);
  }

  /** Puts the camera of now in a keyframe's place. */
  replace(index: number): void {
    const pose = this.viewer.pose;
    if (pose !== undefined) this.change(this.store.get().keyframes.map((key, i) => (i === index ? { ...key, ...pose } : key)));
  }

  /** Puts a keyframe elsewhere; further steps of one hand are undone with the first. */
  move(index: number, change: Partial<Keyframe>, isGoingOn = false): void {
    const keyframes = this.store.get().keyframes.map((key, i) => (i === index ? { ...key, ...change } : key));
    if (isGoingOn) this.store.set({ keyframes });
    else this.change(keyframes);
  }

  /** The camera looks at a place all the time, or where the keyframes do. */
  setTarget(target: Vec3 | undefined, isGoingOn = false): void {
    if (!isGoingOn) this.remember();
    this.store.set({ target });
  }

  /** What is in the middle of the picture becomes the target. */
  async targetMiddle(): Promise<void> {
    const hit = await this.viewer.pick(this.viewer.middle);
    if (hit === null) this.viewer.note('info', 'There is no ground in the middle of the picture');
    else this.setTarget(hit.place);
  }

  /** Eases the way in at its start and out at its end, or no longer. */
  easeEnds(does: boolean): void {
    const { keyframes } = this.store.get();
    this.change(keyframes.map((key, i) => (i === 0 || i === keyframes.length - 1 ? { ...key, rest: does } : key)));
  }

  remove(index: number): void {
    this.change(this.store.get().keyframes.filter((_, i) => i !== index));
  }

  clear(): void {
    this.change([]);
    this.store.set({ target: undefined });
  }

  /** Moves a keyframe in time; between its neighbours, at least a hundredth of a second from each. */
  setTime(index: number, t: number): void {
    const { keyframes } = this.store.get();
    const low = index > 0 ? keyframes[index - 1]!.t + 0.01 : -Infinity;
    const high = index + 1 < keyframes.length ? keyframes[index + 1]!.t - 0.01 : Infinity;
    this.change(keyframes.map((key, i) => (i === index ? { ...key, t: clamp(t, low, high) } : key)));
  }

  /** Stretches the whole path to a duration. */
  retime(seconds: number): void {
    const { keyframes } = this.store.get();
    if (!(seconds > 0) || this.duration === 0) return;
    const [start, factor] = [keyframes[0]!.t, seconds / this.duration];
    this.change(keyframes.map((key) => ({ ...key, t: start + (key.t - start) * factor })));
  }

  /** Takes the path of a file. */
  load({ keyframes, target }: Path): void {
    this.change(keyframes);
    this.store.set({ target, problem: undefined });
    this.setMode('planned');
    this.scrub(keyframes[0]?.t ?? 0);
  }

  /** A file was not loaded. */
  refuse(problem: string): void {
    this.store.set({ problem });
  }

  undo(): void {
    const before = this.past.pop();
    if (before !== undefined) this.store.set({ ...before, canUndo: this.past.length > 0 });
  }

  scrub(t: number): void {
    this.store.set({ t });
    const pose = this.spline?.pose(t);
    if (pose !== undefined) this.viewer.setPose(pose);
  }

  playOrPause(): void {
    if (this.store.get().isPlaying) this.pause();
    else this.play();
  }

  /** Plays the path, or circles what is in the middle of the picture. */
  play(): void {
    const { mode, keyframes } = this.store.get();
    if (mode === 'free' && keyframes.length >= 2) this.store.set({ mode: 'planned' });
    if (this.store.get().mode === 'planned') this.playPath();
    else void this.orbit();
  }

  pause(): void {
    if (this.store.get().isPlaying) this.motion.stop();
  }

  toggleRecording(): void {
    if (this.store.get().isRecording) this.endRecording();
    else this.beginRecording();
  }

  private playPath(): void {
    const { keyframes, t } = this.store.get();
    const [first, last] = [keyframes[0], keyframes[keyframes.length - 1]];
    if (first === undefined || last === undefined || first === last) {
      this.viewer.note('info', 'A path needs two keyframes: fly somewhere, press K, fly on, press K again');
      return;
    }
    let now = t >= last.t || t < first.t ? first.t : t;
    this.begin((_, seconds) => {
      if (now >= last.t) return undefined;
      now = Math.min(last.t, now + seconds * this.store.get().speed);
      this.store.set({ t: now });
      return this.spline?.pose(now);
    });
  }

  private async orbit(): Promise<void> {
    const center = this.viewer.middle;
    const place = (await this.viewer.pick(center))?.place ?? this.viewer.ahead(center);
    if (place === undefined) return;
    this.store.set({ mode: 'orbit' });
    this.begin((pose, seconds) => turnAbout(pose, place, -ORBIT_SPEED * seconds * this.store.get().speed));
  }

  private begin(step: (pose: Pose, seconds: number) => Pose | undefined): void {
    if (!this.viewer.isPilot) return;
    this.motion.play(step, () => this.store.set({ isPlaying: false }));
    this.store.set({ isPlaying: true });
  }

  private beginRecording(): void {
    const start = performance.now();
    const take = () => {
      const pose = this.viewer.pose;
      const { keyframes } = this.store.get();
      const last = keyframes[keyframes.length - 1];
      const t = Number(((performance.now() - start) / 1000).toFixed(3));
      if (pose !== undefined && (last === undefined || t > last.t)) this.store.set({ keyframes: [...keyframes, { ...pose, t }] });
    };
    this.change([]);
    take();
    this.recording = window.setInterval(take, RECORD_EVERY * 1000);
    this.store.set({ isRecording: true });
  }

  private endRecording(): void {
    window.clearInterval(this.recording);
    const keyframes = thinned(this.store.get().keyframes);
    this.store.set({ isRecording: false, keyframes, t: 0 });
    this.viewer.note('info', `Recorded ${keyframes.length} keyframes`);
  }

  private change(keyframes: readonly Keyframe[]): void {
    this.remember();
    this.store.set({ keyframes });
  }

  private remember(): void {
    const { keyframes, target } = this.store.get();
    this.past.push({ keyframes, target });
    if (this.past.length > MOST_UNDONE) this.past.shift();
    this.store.set({ canUndo: true });
  }
}

/** Leaves out keyframes between two that are equal to them: the camera rests there. */
function thinned(keyframes: readonly Keyframe[]): Keyframe[] {
  const isSame = (a: Keyframe | undefined, b: Keyframe) =>
    a !== undefined && Math.hypot(a.x - b.x, a.y - b.y, a.z - b.z) < 1e-3 && Math.abs(turn(a.heading, b.heading)) + Math.abs(a.pitch - b.pitch) < 1e-4;
  return keyframes.filter((key, i) => {
    const next = keyframes[i + 1];
    return next === undefined || !isSame(keyframes[i - 1], key) || !isSame(next, key);
  });
}

import { poseAt, type Keyframe } from '../math/flight';
import { turnAbout } from '../math/navigate';
import type { Pose } from '../math/pose';
import { clamp, turn } from '../math/vector';
import { Store } from '../state/store';
import type { Viewer } from '../state/viewer';
import type { Motion } from '../view/motion';

export type Mode = 'free' | 'orbit' | 'planned';

export interface PathState {
  mode: Mode;
  keyframes: readonly Keyframe[];
  /** Moment of the path that is shown, seconds. */
  t: number;
  speed: number;
  isPlaying: boolean;
  isRecording: boolean;
  canUndo: boolean;
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
    t: 0,
    speed: 1,
    isPlaying: false,
    isRecording: false,
    canUndo: false,
  });
  private past: (readonly Keyframe[])[] = [];
  private recording: number | undefined;

  constructor(
    private readonly viewer: Viewer,
    private readonly motion: Motion,
  ) {}

  get duration(): number {
    const { keyframes } = this.store.get();
    return keyframes.length < 2 ? 0 : keyframes[keyframes.length - 1]!.t - keyframes[0]!.t;
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
    if (pose !== undefined) this.change(this.store.get().keyframes.map((key, i) => (i === index ? { ...pose, t: key.t } : key)));
  }

  remove(index: number): void {
    this.change(this.store.get().keyframes.filter((_, i) => i !== index));
  }

  clear(): void {
    this.change([]);
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

  /** Takes the keyframes of a file. */
  load(keyframes: readonly Keyframe[]): void {
    this.change(keyframes);
    this.setMode('planned');
    this.scrub(keyframes[0]?.t ?? 0);
  }

  undo(): void {
    const keyframes = this.past.pop();
    if (keyframes !== undefined) this.store.set({ keyframes, canUndo: this.past.length > 0 });
  }

  scrub(t: number): void {
    this.store.set({ t });
    const pose = poseAt(this.store.get().keyframes, t);
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
      return poseAt(this.store.get().keyframes, now);
    });
  }

  private async orbit(): Promise<void> {
    const { width, height } = this.viewer.picture!.size;
    const center = { u: width / 2, v: height / 2 };
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
    this.past.push(this.store.get().keyframes);
    if (this.past.length > MOST_UNDONE) this.past.shift();
    this.store.set({ keyframes, canUndo: true });
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

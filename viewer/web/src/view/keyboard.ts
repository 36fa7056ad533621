import { fly, flyAlongAxis, look, speedAt, tiltAbout, turnAbout, zoomTo } from '../math/navigate';
import type { Pose } from '../math/pose';
import type { Vec3 } from '../math/vector';
import type { Viewer } from '../state/viewer';
import type { Motion } from './motion';

/** What single keys do besides moving the camera. */
export interface Commands {
  northUp(): void;
  reset(): void;
  playOrPause(): void;
  addKeyframe(): void;
  help(): void;
  stop(): void;
}

/** Degrees a second of turning and tilting. */
const TURN_SPEED = 50;
const TILT_SPEED = 35;
const FASTER = 4;
/** Distances shrink to this share in a second of zooming. */
const ZOOM_SHARE = 0.35;

type Move = (pose: Pose, seconds: number, metres: number, isShifted: boolean) => Pose;

/** Keys by place on the keyboard, so that W A S D are where hands expect them on every layout. */
export class Keyboard {
  private readonly down = new Set<string>();
  private isShifted = false;
  private middle: Vec3 | undefined;

  constructor(
    private readonly viewer: Viewer,
    private readonly motion: Motion,
    private readonly commands: Commands,
  ) {
    window.addEventListener('keydown', (event) => this.pressed(event));
    window.addEventListener('keyup', (event) => this.released(event));
    window.addEventListener('blur', () => this.releaseAll());
    document.addEventListener('visibilitychange', () => this.releaseAll());
  }

  private readonly moves: Record<string, Move> = {
    ArrowUp: (pose, s, m, shift) => (shift ? this.tilt(pose, TILT_SPEED * s) : fly(pose, m, 0, 0)),
    ArrowDown: (pose, s, m, shift) => (shift ? this.tilt(pose, -TILT_SPEED * s) : fly(pose, -m, 0, 0)),
    ArrowLeft: (pose, s, m, shift) => (shift ? this.turn(pose, -TURN_SPEED * s) : fly(pose, 0, -m, 0)),
    ArrowRight: (pose, s, m, shift) => (shift ? this.turn(pose, TURN_SPEED * s) : fly(pose, 0, m, 0)),
    KeyW: (pose, _, m, shift) => flyAlongAxis(pose, shift ? m * FASTER : m, 0, 0),
    KeyS: (pose, _, m, shift) => flyAlongAxis(pose, shift ? -m * FASTER : -m, 0, 0),
    KeyA: (pose, _, m, shift) => flyAlongAxis(pose, 0, shift ? -m * FASTER : -m, 0),
    KeyD: (pose, _, m, shift) => flyAlongAxis(pose, 0, shift ? m * FASTER : m, 0),
    KeyQ: (pose, _, m, shift) => fly(pose, 0, 0, shift ? -m * FASTER : -m),
    KeyE: (pose, _, m, shift) => fly(pose, 0, 0, shift ? m * FASTER : m),
    PageDown: (pose, _, m, shift) => fly(pose, 0, 0, shift ? -m * FASTER : -m),
    PageUp: (pose, _, m, shift) => fly(pose, 0, 0, shift ? m * FASTER : m),
    Plus: (pose, s) => this.zoom(pose, ZOOM_SHARE ** s),
    Minus: (pose, s) => this.zoom(pose, ZOOM_SHARE ** -s),
  };

  private readonly commandsOf: Record<string, () => void> = {
    KeyN: () => this.commands.northUp(),
    KeyR: () => this.commands.reset(),
    KeyK: () => this.commands.addKeyframe(),
    Space: () => this.commands.playOrPause(),
    Escape: () => this.commands.stop(),
  };

  private keyOf(event: KeyboardEvent): string {
    if (event.key === '+' || event.key === '=') return 'Plus';
    if (event.key === '-') return 'Minus';
    return event.code;
  }

  private pressed(event: KeyboardEvent): void {
    this.isShifted = event.shiftKey;
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented || isForAControl(event)) return;
    const key = this.keyOf(event);
    if (event.key === '?') {
      this.commands.help();
    } else if (key in this.moves) {
      if (event.repeat) {
        event.preventDefault();
        return;
      }
      this.begin(key);
    } else if (key in this.commandsOf) {
      if (!event.repeat) this.commandsOf[key]!();
    } else {
      return;
    }
    event.preventDefault();
  }

  private begin(key: string): void {
    if (this.down.size === 0) {
      this.motion.stop();
      this.middle = undefined;
      void this.viewer.pick(this.viewer.middle).then((hit) => (this.middle = hit?.place));
    }
    this.down.add(key);
    this.motion.hold('keys', (pose, seconds) => this.step(pose, seconds));
  }

  private step(pose: Pose, seconds: number): Pose {
    const metres = speedAt(this.viewer.clearance, this.viewer.worldSide) * seconds;
    let next = pose;
    for (const key of this.down) next = this.moves[key]!(next, seconds, metres, this.isShifted);
    return next;
  }

  private turn(pose: Pose, angle: number): Pose {
    return this.middle === undefined ? look(pose, angle, 0) : turnAbout(pose, this.middle, angle);
  }

  private tilt(pose: Pose, angle: number): Pose {
    return this.middle === undefined ? look(pose, 0, angle) : tiltAbout(pose, this.middle, angle);
  }

  private zoom(pose: Pose, factor: number): Pose {
    const place = this.middle ?? this.viewer.ahead(this.viewer.middle);
    return place === undefined ? pose : zoomTo(pose, place, factor, 3, this.viewer.worldSide * 1.5);
  }

  private released(event: KeyboardEvent): void {
    this.isShifted = event.shiftKey;
    this.down.delete(event.code);
    // The key that types a plus or a minus differs between layouts, and with Shift.
    if (['+', '=', '-', '_', '*'].includes(event.key)) {
      this.down.delete('Plus');
      this.down.delete('Minus');
    }
    if (this.down.size === 0) this.motion.letGo('keys');
  }

  private releaseAll(): void {
    this.down.clear();
    this.motion.letGo('keys');
  }
}

/** Whether a key is for the control that has the focus. */
function isForAControl(event: KeyboardEvent): boolean {
  const target = event.target;
  if (!(target instanceof Element)) return false;
  if (event.key === 'Escape') return target.closest('dialog') !== null;
  if (target.closest('input, select, textarea, dialog, [contenteditable]')) return true;
  if (target.closest('[role=tab], [role=tablist]') && event.key.startsWith('Arrow')) return true;
  return target.closest('button, a, summary') !== null && event.key === ' ';
}

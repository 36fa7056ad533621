import { flyAlongAxis, fly, look, speedAt } from '../math/navigate';
import type { Pose } from '../math/pose';
import { isPilot } from '../state/state';
import type { Viewer } from '../state/viewer';
import type { Motion } from './motion';

/** Sticks rest a little beside the middle. */
const DEAD_ZONE = 0.15;
const TURN_SPEED = 70;
const TILT_SPEED = 50;

const bent = (value: number | undefined): number => {
  const size = Math.abs(value ?? 0);
  if (size < DEAD_ZONE) return 0;
  // Fine near the middle, fast at the rim.
  return Math.sign(value!) * ((size - DEAD_ZONE) / (1 - DEAD_ZONE)) ** 2;
};

/** A gamepad of the standard layout: left stick flies, right stick looks, triggers sink and climb, A is faster. */
export class GamepadHands {
  private wasFlying = false;

  constructor(
    private readonly viewer: Viewer,
    private readonly motion: Motion,
  ) {
    window.addEventListener('gamepadconnected', () => {
      this.viewer.note('info', 'Gamepad: left stick flies, right stick looks, triggers sink and climb, A is faster');
      this.listen();
    });
    // One that watches moves nothing, so its gamepad is let go; it counts again when this page is the pilot.
    viewer.store.subscribe(() => {
      const isFlying = isPilot(viewer.store.get());
      if (isFlying && !this.wasFlying && navigator.getGamepads().some((pad) => pad?.connected)) this.listen();
      this.wasFlying = isFlying;
    });
  }

  private listen(): void {
    this.motion.hold('gamepad', (pose, seconds) => this.step(pose, seconds));
  }

  private step(pose: Pose, seconds: number): Pose {
    const pads = navigator.getGamepads().filter((pad): pad is Gamepad => pad !== null && pad.connected);
    const pad = pads[0];
    if (pad === undefined) {
      this.motion.letGo('gamepad');
      return pose;
    }
    const button = (index: number) => pad.buttons[index]?.value ?? 0;
    const [right, back, turn, tilt] = [0, 1, 2, 3].map((axis) => bent(pad.axes[axis])) as [number, number, number, number];
    const climb = button(7) - button(6);
    if (right === 0 && back === 0 && turn === 0 && tilt === 0 && climb === 0) return pose;
    this.motion.stop();
    const faster = 1 + 3 * button(0);
    const metres = speedAt(this.viewer.clearance, this.viewer.worldSide) * seconds * faster;
    const looked = look(pose, turn * TURN_SPEED * seconds, -tilt * TILT_SPEED * seconds);
    return fly(flyAlongAxis(looked, -back * metres, right * metres, 0), 0, 0, climb * metres);
  }
}

import type { World } from '../link/protocol';
import type { Viewer } from '../state/viewer';
import { cameraAbove, type MapFrame, type Region } from './mapview';

/** Picture of the ground, pixels along its side, and the pause before another one is asked for. */
const GROUND_PX = 512;
const GROUND_PAUSE_MS = 500;

/** The picture of the ground that the map shows: a still from far above, asked for when the map shows another part. */
export class GroundPicture {
  private shown: { bitmap: ImageBitmap; region: Region; metres: number; exaggeration: number } | undefined;
  private timer: number | undefined;

  constructor(
    private readonly viewer: Viewer,
    private readonly changed: () => void,
  ) {}

  end(): void {
    window.clearTimeout(this.timer);
    this.shown?.bitmap.close();
  }

  /** Draws the picture that there is, and asks for another one when it is of another part of the world. */
  draw(context: CanvasRenderingContext2D, frame: MapFrame, world: World): void {
    this.ask(frame, world);
    if (this.shown === undefined) return;
    const { bitmap, region, metres } = this.shown;
    const [u, v] = frame.toMap(region.x - metres / 2, region.y + metres / 2);
    const side = metres * frame.scale;
    context.imageSmoothingQuality = 'high';
    context.drawImage(bitmap, u, v, side, side);
  }

  private ask(frame: MapFrame, world: World): void {
    const exaggeration = this.viewer.exaggeration;
    const { region } = frame;
    const has = this.shown;
    const isSame = has !== undefined && has.exaggeration === exaggeration && has.region.x === region.x && has.region.y === region.y && has.region.side === region.side;
    if (isSame || this.viewer.store.get().link.kind !== 'open') return;
    window.clearTimeout(this.timer);
    this.timer = window.setTimeout(() => void this.fetch(frame, world, exaggeration), has === undefined ? 0 : GROUND_PAUSE_MS);
  }

  private async fetch(frame: MapFrame, world: World, exaggeration: number): Promise<void> {
    const { region, width, height } = frame;
    // A square that covers the longer side of the map.
    const longer = (region.side * Math.max(width, height)) / Math.min(width, height);
    const { pose, metres } = cameraAbove({ ...region, side: longer }, world, this.viewer.worldSide, exaggeration);
    try {
      // From so far above haze would hide the ground, and maps have no time of day.
      const still = await this.viewer.api.still(pose, GROUND_PX, GROUND_PX, { isUnlit: true });
      const bitmap = await createImageBitmap(still);
      this.shown?.bitmap.close();
      this.shown = { bitmap, region: { ...region }, metres, exaggeration };
      this.changed();
    } catch {
      // The map goes on without; the next change of it asks again.
    }
  }
}

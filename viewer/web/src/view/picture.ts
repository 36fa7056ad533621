import type { PictureHeader } from '../link/protocol';
import type { Point, Pose, Size } from '../math/pose';
import { MIDDLE, type Eye } from '../math/stereo';
import { Pane } from './pane';
import { Video } from './video';

/** The eyes of a pair that is shown side by side, the left one first; undefined for a single picture. */
export type Pair = readonly [Eye, Eye] | undefined;

/**
 * The picture: the last one that came, put where it is seen from the camera of now until the next one comes. Of two eyes
 * side by side each half is a pane of its own, since each is turned about its own middle.
 */
export class Picture {
  private readonly whole: Pane;
  private halves: readonly Pane[] = [];
  private header: PictureHeader | undefined;
  private pair: Pair;
  private latest = 0;
  private readonly video = new Video();

  constructor(
    canvas: HTMLCanvasElement,
    private readonly frame: HTMLElement,
  ) {
    this.whole = new Pane(canvas);
  }

  get shown(): PictureHeader | undefined {
    return this.header;
  }

  /** Size of the view, CSS pixels. */
  get size(): Size {
    return { width: Math.max(1, this.frame.clientWidth), height: Math.max(1, this.frame.clientHeight) };
  }

  /** Decodes a picture and draws it; false for one that cannot be decoded, or that a newer one has overtaken. */
  async show(header: PictureHeader, file: ArrayBuffer, pair: Pair): Promise<boolean> {
    const order = ++this.latest;
    const bitmap = header.kind === 'h264' ? await this.video.decode(header, file) : await decode(header, file);
    if (bitmap === undefined || order !== this.latest) {
      bitmap?.close();
      return false;
    }
    // Programs read its pixels here, of a pair too.
    this.whole.draw(bitmap, 0, header);
    this.divide(pair);
    const half = { width: Math.floor(header.width / 2), height: header.height };
    this.halves.forEach((pane, i) => pane.draw(bitmap, i * half.width, half));
    bitmap.close();
    this.header = header;
    return true;
  }

  /** Puts the picture where it is seen from a pose. */
  place(pose: Pose, ground: number): void {
    const header = this.header;
    if (header === undefined) return;
    const size = this.size;
    const half = { width: size.width / 2, height: size.height };
    if (this.pair === undefined) this.whole.place(header.pose, pose, size, ground, MIDDLE);
    else for (const [i, eye] of this.pair.entries()) this.halves[i]!.place(header.pose, pose, half, ground, eye);
  }

  /** The place in the shown picture, from 0 to 1, that is under a point of the view. */
  under(point: Point): Point | undefined {
    if (this.header === undefined) return undefined;
    if (this.pair === undefined) return this.whole.under(point);
    const width = this.size.width / 2;
    const i = point.u < width ? 0 : 1;
    const place = this.halves[i]!.under({ u: point.u - i * width, v: point.v });
    return place === undefined ? undefined : { u: (place.u + i) / 2, v: place.v };
  }

  /** The pixels of the shown picture: red, green, blue and 255. */
  pixels(): ImageData | undefined {
    if (this.header === undefined) return undefined;
    return this.whole.context.getImageData(0, 0, this.header.width, this.header.height);
  }

  /** Shows the picture whole, or each half in a box that cuts it off. */
  private divide(pair: Pair): void {
    const isDivided = this.halves.length > 0;
    this.pair = pair;
    if (isDivided === (pair !== undefined)) return;
    for (const { canvas } of this.halves) canvas.parentElement!.remove();
    this.whole.canvas.hidden = pair !== undefined;
    this.halves = (pair ?? []).map((_, i) => {
      const [box, canvas] = [document.createElement('div'), document.createElement('canvas')];
      box.className = `half ${i === 0 ? 'left' : 'right'}`;
      canvas.className = 'picture';
      box.append(canvas);
      this.whole.canvas.before(box);
      return new Pane(canvas);
    });
  }
}

/** Decodes a file; undefined for one that cannot be decoded. */
async function decode(header: PictureHeader, file: ArrayBuffer): Promise<ImageBitmap | undefined> {
  const blob = new Blob([file], { type: header.kind === 'png' ? 'image/png' : 'image/jpeg' });
  return createImageBitmap(blob, { colorSpaceConversion: 'none', premultiplyAlpha: 'none' }).catch(() => undefined);
}

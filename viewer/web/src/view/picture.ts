import type { PictureHeader } from '../link/protocol';
import { cssMatrix, apply, invert, reprojection, type Matrix3 } from '../math/homography';
import { samePose, type Point, type Pose, type Size } from '../math/pose';

/**
 * The picture: a canvas with the last one that came, which a CSS transform puts where it is seen from the camera of now,
 * until the next one comes.
 */
export class Picture {
  private readonly context: CanvasRenderingContext2D;
  private header: PictureHeader | undefined;
  private matrix: Matrix3 | undefined;
  private latest = 0;

  constructor(
    readonly canvas: HTMLCanvasElement,
    private readonly frame: HTMLElement,
  ) {
    this.context = canvas.getContext('2d', { alpha: false })!;
  }

  get shown(): PictureHeader | undefined {
    return this.header;
  }

  /** Size of the view, CSS pixels. */
  get size(): Size {
    return { width: Math.max(1, this.frame.clientWidth), height: Math.max(1, this.frame.clientHeight) };
  }

  /** Decodes a picture and draws it; false for one that cannot be decoded, or that a newer one has overtaken. */
  async show(header: PictureHeader, file: ArrayBuffer): Promise<boolean> {
    const order = ++this.latest;
    const blob = new Blob([file], { type: header.kind === 'png' ? 'image/png' : 'image/jpeg' });
    let bitmap: ImageBitmap;
    try {
      bitmap = await createImageBitmap(blob, { colorSpaceConversion: 'none', premultiplyAlpha: 'none' });
    } catch {
      return false;
    }
    if (order !== this.latest) {
      bitmap.close();
      return false;
    }
    if (this.canvas.width !== bitmap.width || this.canvas.height !== bitmap.height) {
      this.canvas.width = bitmap.width;
      this.canvas.height = bitmap.height;
    }
    this.context.drawImage(bitmap, 0, 0);
    bitmap.close();
    this.header = header;
    return true;
  }

  /** Puts the picture where it is seen from a pose. */
  place(pose: Pose, ground: number): void {
    const header = this.header;
    if (header === undefined) return;
    const size = this.size;
    const drawn = { width: header.width, height: header.height };
    // Of the same shape up to rounding, and from the same pose: pixel for pixel.
    const isSameShape = Math.abs(drawn.width / drawn.height - size.width / size.height) < 2 / Math.min(drawn.width, drawn.height);
    if (samePose(header.pose, pose) && isSameShape) {
      this.matrix = [size.width / drawn.width, 0, 0, 0, size.height / drawn.height, 0, 0, 0, 1];
      this.setStyle(`scale(${size.width / drawn.width}, ${size.height / drawn.height})`);
    } else {
      this.matrix = reprojection(header.pose, drawn, pose, size, ground);
      this.setStyle(cssMatrix(this.matrix));
    }
  }

  /** The place in the shown picture, from 0 to 1, that is under a point of the view. */
  under(point: Point): Point | undefined {
    if (this.header === undefined || this.matrix === undefined) return undefined;
    const inverse = invert(this.matrix);
    const place = inverse === undefined ? undefined : apply(inverse, point.u, point.v);
    if (place === undefined) return undefined;
    const { u, v } = { u: place.u / this.header.width, v: place.v / this.header.height };
    return u >= 0 && v >= 0 && u <= 1 && v <= 1 ? { u, v } : undefined;
  }

  /** The pixels of the shown picture: red, green, blue and 255. */
  pixels(): ImageData | undefined {
    if (this.header === undefined) return undefined;
    return this.context.getImageData(0, 0, this.header.width, this.header.height);
  }

  private setStyle(transform: string): void {
    if (this.canvas.style.transform !== transform) this.canvas.style.transform = transform;
  }
}

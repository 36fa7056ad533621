import { cssMatrix, apply, invert, reprojection, type Matrix3 } from '../math/homography';
import { samePose, type Point, type Pose, type Size } from '../math/pose';
import type { Eye } from '../math/stereo';

/** A canvas with the picture of an eye, which a CSS transform puts where it is seen from the camera of now. */
export class Pane {
  readonly context: CanvasRenderingContext2D;
  private matrix: Matrix3 | undefined;

  constructor(readonly canvas: HTMLCanvasElement) {
    this.context = canvas.getContext('2d', { alpha: false })!;
  }

  /** Draws a column of a picture, over the whole canvas. */
  draw(picture: ImageBitmap | VideoFrame, left: number, { width, height }: Size): void {
    const { canvas } = this;
    if (canvas.width !== width || canvas.height !== height) {
      canvas.width = width;
      canvas.height = height;
    }
    this.context.drawImage(picture, left, 0, width, height, 0, 0, width, height);
  }

  /** Puts what was drawn from a pose where it is seen from another one, in a view of this size. */
  place(drawn: Pose, seen: Pose, size: Size, ground: number, eye: Eye): void {
    const { width, height } = this.canvas;
    // Of the same shape up to rounding, and from the same pose: pixel for pixel.
    const isSameShape = Math.abs(width / height - size.width / size.height) < 2 / Math.min(width, height);
    if (samePose(drawn, seen) && isSameShape) {
      this.matrix = [size.width / width, 0, 0, 0, size.height / height, 0, 0, 0, 1];
      this.setStyle(`scale(${size.width / width}, ${size.height / height})`);
    } else {
      this.matrix = reprojection(drawn, { width, height }, seen, size, ground, eye);
      this.setStyle(cssMatrix(this.matrix));
    }
  }

  /** The place in the picture, from 0 to 1, that is under a point of the view. */
  under(point: Point): Point | undefined {
    const inverse = this.matrix === undefined ? undefined : invert(this.matrix);
    const place = inverse === undefined ? undefined : apply(inverse, point.u, point.v);
    if (place === undefined) return undefined;
    const { u, v } = { u: place.u / this.canvas.width, v: place.v / this.canvas.height };
    return u >= 0 && v >= 0 && u <= 1 && v <= 1 ? { u, v } : undefined;
  }

  private setStyle(transform: string): void {
    if (this.canvas.style.transform !== transform) this.canvas.style.transform = transform;
  }
}

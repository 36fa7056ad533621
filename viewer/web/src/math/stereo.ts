import { add, scale } from './vector';
import { axesOf, eyeOf, focalOf, project, withEye, type Point, type Pose, type Size } from './pose';
import type { Vec3 } from './vector';

/** An eye: so far to the right of the pose, its picture shifted so that it meets the other one's at a distance. */
export interface Eye {
  readonly right: number;
  readonly convergence: number;
}

/** The eye of a single picture. */
export const MIDDLE: Eye = { right: 0, convergence: Infinity };

/** The eyes of a pair, the left one first. */
export function eyesOf(separation: number, convergence: number): readonly [Eye, Eye] {
  return [
    { right: -separation / 2, convergence },
    { right: separation / 2, convergence },
  ];
}

/** The pose as it is at an eye. */
export const poseOfEye = (pose: Pose, eye: Eye): Pose => (eye.right === 0 ? pose : withEye(pose, add(eyeOf(pose), scale(axesOf(pose).right, eye.right))));

/** How far right of the middle of an eye's picture its line of sight is, in the unit of the picture's size. */
export const shiftOf = (pose: Pose, size: Size, eye: Eye): number => (focalOf(pose, size) * eye.right) / eye.convergence;

/** Where in the picture of an eye a place is; undefined behind the camera. */
export function projectIn(eye: Eye, pose: Pose, size: Size, place: Vec3): (Point & { depth: number }) | undefined {
  const seen = project(poseOfEye(pose, eye), size, place);
  return seen === undefined ? undefined : { ...seen, u: seen.u + shiftOf(pose, size, eye) };
}

import { axesOf, eyeOf, focalOf, rayThrough, withEye, type Point, type Pose, type Size } from './pose';
import { add, clamp, radians, rotate, scale, sub, type Vec3 } from './vector';

/** Least height of the eye above ground, metres; the flight itself lifts what is lower than 2 m. */
export const LEAST_CLEARANCE = 2.5;
/** Farthest east or north of the world, in longer sides of it: at a corner that is less than two of them. */
const FARTHEST = 1.4;
/** Rays that fall less than this (of their length along the axis) hold no ground: a drag there turns. */
const FLATTEST_DRAG = -0.03;

/** Lifts an eye that is in the ground, or too near to it. */
export function aboveGround(pose: Pose, ground: number | undefined): Pose {
  if (ground === undefined || pose.z >= ground + LEAST_CLEARANCE) return pose;
  return { ...pose, z: ground + LEAST_CLEARANCE };
}

/** Keeps an eye about the world: the server refuses poses that are farther from it than twice its longer side. */
export function nearWorld(pose: Pose, [low, high]: readonly [readonly [number, number], readonly [number, number]]): Pose {
  const margin = FARTHEST * Math.max(high[0] - low[0], high[1] - low[1]);
  const [x, y] = [clamp(pose.x, low[0] - margin, high[0] + margin), clamp(pose.y, low[1] - margin, high[1] + margin)];
  return x === pose.x && y === pose.y ? pose : { ...pose, x, y };
}

/** Moves the eye in its level plane so that a place of the ground comes under a point of the picture. */
export function dragGround(pose: Pose, size: Size, place: Vec3, point: Point): Pose | undefined {
  const ray = rayThrough(pose, size, point);
  const fall = pose.z - place[2];
  if (ray[2] > FLATTEST_DRAG || fall <= 0) return undefined;
  const depth = -fall / ray[2];
  return withEye(pose, [place[0] - ray[0] * depth, place[1] - ray[1] * depth, pose.z]);
}

/** Turns the camera about itself so that the direction that was under one point comes under another one. */
export function dragSky(pose: Pose, size: Size, from: Point, to: Point): Pose {
  const perPixel = 180 / Math.PI / focalOf(pose, size);
  return {
    ...pose,
    heading: pose.heading - (to.u - from.u) * perPixel,
    pitch: clamp(pose.pitch + (to.v - from.v) * perPixel, -90, 90),
  };
}

/** Turns the camera about a vertical axis through a place; positive: the camera's heading grows. */
export function turnAbout(pose: Pose, place: Vec3, angle: number): Pose {
  const offset = rotate(sub(eyeOf(pose), place), [0, 0, 1], -radians(angle));
  return { ...withEye(pose, add(place, offset)), heading: pose.heading + angle };
}

/** Tilts the camera about a level axis through a place, across the view; positive: it looks further up. */
export function tiltAbout(pose: Pose, place: Vec3, angle: number): Pose {
  const offset = sub(eyeOf(pose), place);
  const h = radians(pose.heading);
  const across: Vec3 = [Math.cos(h), -Math.sin(h), 0];
  // Not below the place's own height, and never over the top.
  const level = Math.hypot(offset[0], offset[1]);
  const elevation = (Math.atan2(offset[2], level) * 180) / Math.PI;
  const lowest = Math.min(elevation, 1.5);
  const allowed = clamp(angle, -90 - pose.pitch, 90 - pose.pitch);
  const bounded = allowed > 0 ? Math.min(allowed, elevation - lowest) : allowed;
  return { ...withEye(pose, add(place, rotate(offset, across, radians(bounded)))), pitch: pose.pitch + bounded };
}

/** Brings the eye nearer to a place (factor below 1) or away from it; the place stays where it is in the picture. */
export function zoomTo(pose: Pose, place: Vec3, factor: number, least = 3, most = Infinity): Pose {
  const offset = sub(eyeOf(pose), place);
  const distance = Math.hypot(...offset);
  if (!(distance > 0)) return pose;
  const wanted = clamp(distance * factor, Math.min(least, distance), Math.max(most, distance));
  return withEye(pose, add(place, scale(offset, wanted / distance)));
}

/** Metres that the camera flies: ahead and to the right in the level plane, and up. */
export function fly(pose: Pose, ahead: number, right: number, up: number): Pose {
  const h = radians(pose.heading);
  return {
    ...pose,
    x: pose.x + Math.sin(h) * ahead + Math.cos(h) * right,
    y: pose.y + Math.cos(h) * ahead - Math.sin(h) * right,
    z: pose.z + up,
  };
}

/** Metres that the camera flies along its own axis, as an aircraft does. */
export function flyAlongAxis(pose: Pose, ahead: number, right: number, up: number): Pose {
  const { forward } = axesOf(pose);
  const sideways = fly(pose, 0, right, up);
  return withEye(sideways, add(eyeOf(sideways), scale(forward, ahead)));
}

/** Turns the camera about itself. */
export const look = (pose: Pose, heading: number, pitch: number, roll = 0): Pose => ({
  ...pose,
  heading: pose.heading + heading,
  pitch: clamp(pose.pitch + pitch, -90, 90),
  roll: pose.roll + roll,
});

/** Speed of flight, metres a second: half of the height above ground each second, within what the world allows. */
export const speedAt = (clearance: number, worldSide: number): number => clamp(clearance * 0.7, 4, worldSide / 4);

/** A pose that looks at a place from a direction: azimuth of the eye as seen from the place, elevation above the horizon. */
export function lookAt(place: Vec3, azimuth: number, elevation: number, distance: number, vfov: number): Pose {
  const a = radians(azimuth);
  const e = radians(elevation);
  const eye = add(place, scale([Math.sin(a) * Math.cos(e), Math.cos(a) * Math.cos(e), Math.sin(e)], distance));
  return { x: eye[0], y: eye[1], z: eye[2], heading: (azimuth + 180) % 360, pitch: -elevation, roll: 0, vfov };
}

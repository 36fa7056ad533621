import type { Keyframe } from '../math/flight';

/** What docs/camera-paths.md allows, and what a page can hold. */
const MOST_KEYFRAMES = 100_000;

/** A path as `terravision fly --path` reads it. */
export function toJson(keyframes: readonly Keyframe[], epsg: number | null): string {
  const round = (value: number, digits: number) => Number(value.toFixed(digits));
  const lines = keyframes.map((key) => {
    const frame = {
      t: round(key.t, 3),
      x: round(key.x, 3),
      y: round(key.y, 3),
      z: round(key.z, 3),
      heading: round(key.heading, 4),
      pitch: round(key.pitch, 4),
      roll: round(key.roll, 4),
    };
    return `    ${JSON.stringify(frame)}`;
  });
  const crs = epsg === null ? '' : `  "crs": "EPSG:${epsg}",\n`;
  return `{\n${crs}  "vfov_deg": ${round(keyframes[0]?.vfov ?? 60, 3)},\n  "keyframes": [\n${lines.join(',\n')}\n  ]\n}\n`;
}

/** Reads a path of keyframes or frames; throws a sentence that says what is wrong, and where. */
export function fromJson(text: string, vfov: number, epsg: number | null): Keyframe[] {
  const file = parse(text);
  if (typeof file !== 'object' || file === null) throw new Error('expected an object with "keyframes" or "frames"');
  const path = file as Record<string, unknown>;
  if (typeof path.crs === 'string' && epsg !== null && path.crs !== `EPSG:${epsg}`) {
    throw new Error(`"crs": the page flies paths in the world's EPSG:${epsg}, found ${path.crs}; \`terravision path\` converts it`);
  }
  const isTimed = Array.isArray(path.keyframes);
  const list = isTimed ? path.keyframes : path.frames;
  if (!Array.isArray(list)) throw new Error('expected a list "keyframes" or "frames"');
  if (list.length === 0) throw new Error('the path has no frame');
  if (list.length > MOST_KEYFRAMES) throw new Error(`expected at most ${MOST_KEYFRAMES} frames, found ${list.length}`);
  const fps = typeof path.fps === 'number' && path.fps > 0 ? path.fps : 30;
  const angle = typeof path.vfov_deg === 'number' ? path.vfov_deg : vfov;
  if (!(angle >= 1 && angle <= 170)) throw new Error(`"vfov_deg": expected degrees from 1 to 170, found ${angle}`);
  const keyframes = list.map((frame: unknown, i) => keyframe(frame, i, isTimed ? undefined : i / fps, angle));
  const unordered = keyframes.findIndex((key, i) => i > 0 && key.t <= keyframes[i - 1]!.t);
  if (unordered > 0) throw new Error(`frame ${unordered}: "t": expected a time after that of the frame before`);
  return keyframes;
}

function parse(text: string): unknown {
  try {
    return JSON.parse(text);
  } catch (error) {
    const message = error instanceof Error ? error.message : String(error);
    const position = /position (\d+)/.exec(message);
    if (position === null) throw new Error(`not JSON: ${message}`);
    const line = text.slice(0, Number(position[1])).split('\n').length;
    throw new Error(`line ${line}: not JSON: ${message.replace(/ in JSON at position.*/, '')}`);
  }
}

function keyframe(frame: unknown, index: number, t: number | undefined, vfov: number): Keyframe {
  const values = (typeof frame === 'object' && frame !== null ? frame : {}) as Record<string, unknown>;
  const number = (key: string, otherwise?: number): number => {
    const value = values[key] ?? otherwise;
    if (typeof value !== 'number' || !Number.isFinite(value)) {
      throw new Error(`frame ${index}: "${key}": expected a number, found ${JSON.stringify(value) ?? 'nothing'}`);
    }
    return value;
  };
  const pitch = number('pitch');
  if (Math.abs(pitch) > 90) throw new Error(`frame ${index}: "pitch": expected degrees from -90 to 90, found ${pitch}`);
  return {
    t: t ?? number('t'),
    x: number('x'),
    y: number('y'),
    z: number('z'),
    heading: number('heading'),
    pitch,
    roll: number('roll', 0),
    vfov,
  };
}

import { lonLatOf } from '../math/lonlat';
import type { Pose } from '../math/pose';
import type { Keyframe } from '../math/spline';
import { degrees, type Vec3 } from '../math/vector';

/** What a page can hold. */
const MOST_KEYFRAMES = 100_000;

/** A path of the page: keyframes, and what the camera looks at all the time. */
export interface Path {
  keyframes: readonly Keyframe[];
  target: Vec3 | undefined;
}

const round = (value: number, digits: number) => Number(value.toFixed(digits));

/** A path as `terravision fly --path` reads it. */
export function toJson({ keyframes, target }: Path, epsg: number | null): string {
  const lines = keyframes.map((key) => {
    const frame = {
      t: round(key.t, 3),
      x: round(key.x, 3),
      y: round(key.y, 3),
      z: round(key.z, 3),
      heading: round(key.heading, 4),
      pitch: round(key.pitch, 4),
      roll: round(key.roll, 4),
      ...(key.rest ? { rest: true } : {}),
    };
    return `    ${JSON.stringify(frame)}`;
  });
  const crs = epsg === null ? '' : `  "crs": "EPSG:${epsg}",\n`;
  const looks = target === undefined ? '' : `  "target": ${JSON.stringify(target.map((value) => round(value, 3)))},\n`;
  return `{\n${crs}${looks}  "vfov_deg": ${round(keyframes[0]?.vfov ?? 60, 3)},\n  "keyframes": [\n${lines.join(',\n')}\n  ]\n}\n`;
}

/** A path that the server has read: keyframes or frames in the world's CRS. */
export function fromServer(text: string, vfov: number): Path {
  interface Entry extends Omit<Pose, 'roll' | 'vfov'> {
    t?: number;
    roll?: number;
    rest?: boolean;
  }
  const path = JSON.parse(text) as { keyframes?: Entry[]; frames?: Entry[]; fps?: number; vfov_deg?: number; target?: [number, number, number] };
  const list = path.keyframes ?? path.frames ?? [];
  if (list.length > MOST_KEYFRAMES) throw new Error(`the page holds ${MOST_KEYFRAMES} keyframes, the path has ${list.length}`);
  const keyframes = list.map(({ t, x, y, z, heading, pitch, roll, rest }, i) => ({
    t: t ?? i / (path.fps ?? 30),
    x,
    y,
    z,
    heading,
    pitch,
    roll: roll ?? 0,
    vfov: path.vfov_deg ?? vfov,
    ...(rest ? { rest } : {}),
  }));
  return { keyframes, target: path.target };
}

/**
 * Keyframes as a tour of Google Earth; undefined where the page does not know the world's longitudes and latitudes. KML knows
 * no target and no rest at a moment: it has the poses alone.
 */
export function toKml(keyframes: readonly Keyframe[], name: string, epsg: number | null): string | undefined {
  const steps: string[] = [];
  let before: number | undefined;
  for (const key of keyframes) {
    const place = lonLatOf(epsg, key.x, key.y);
    const ahead = lonLatOf(epsg, key.x, key.y + 1);
    if (place === undefined || ahead === undefined) return undefined;
    // Where grid north points, from true north.
    const north = degrees(Math.atan2((ahead.lon - place.lon) * Math.cos((place.lat * Math.PI) / 180), ahead.lat - place.lat));
    const heading = (((key.heading + north) % 360) + 360) % 360;
    const camera = [
      `<longitude>${round(place.lon, 8)}</longitude><latitude>${round(place.lat, 8)}</latitude><altitude>${round(key.z, 2)}</altitude>`,
      `<heading>${round(heading, 4)}</heading><tilt>${round(key.pitch + 90, 4)}</tilt><roll>${round(key.roll, 4)}</roll>`,
      '<altitudeMode>absolute</altitudeMode>',
    ];
    const duration = before === undefined ? 0 : round(key.t - before, 3);
    steps.push(`<gx:FlyTo><gx:duration>${duration}</gx:duration><gx:flyToMode>smooth</gx:flyToMode><Camera>${camera.join('')}</Camera></gx:FlyTo>`);
    before = key.t;
  }
  const title = name.replace(/[<&]/g, (c) => (c === '<' ? '&lt;' : '&amp;'));
  return [
    '<?xml version="1.0" encoding="UTF-8"?>',
    '<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2">',
    `<gx:Tour><name>${title}</name><gx:Playlist>`,
    ...steps,
    '</gx:Playlist></gx:Tour></kml>\n',
  ].join('\n');
}

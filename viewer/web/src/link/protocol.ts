import type { Pose } from '../math/pose';

/** The protocol that this page speaks; docs/viewer.md describes it. */
export const PROTOCOL = 1;

export type Stereo = 'off' | 'side-by-side' | 'anaglyph';

export interface Settings {
  facet_px: number | null;
  texel_px: number | null;
  fps: number | null;
  technique: 'auto' | 'mesh' | 'rays' | null;
  exaggeration: number | null;
  overlay: 'none' | 'tree' | null;
  /** As `--sun` takes it. */
  sun: string | null;
  shadows: boolean | null;
  /** Metres; 0 for clear air. */
  haze: number | null;
  stereo: Stereo | null;
  eye_separation: number | null;
  convergence: number | null;
}

export interface World {
  name: string;
  crs: string;
  epsg: number | null;
  bounds: [[number, number], [number, number]];
  heights: [number, number] | null;
  body: string;
  post_spacing_m: number;
  /** Sides of a node of level 0, in the units of the CRS. */
  node_side: [number, number];
  is_geographic: boolean;
  start: Pose;
}

export interface Limits {
  size: [[number, number], [number, number]];
  message_bytes: number;
  messages_per_s: number;
  clients: number;
  heights: number;
}

export interface Person {
  id: number;
  name: string | null;
}

export type Flight = 'starting' | 'flying' | 'restarting' | 'failed' | 'resting';

export interface StateMessage {
  flight: Flight;
  reason: string | null;
  size: [number, number];
  settings: Settings;
  pilot: number | null;
  people: Person[];
}

export interface Welcome extends StateMessage {
  type: 'welcome';
  protocol: number;
  version: string;
  you: number;
  is_read_only: boolean;
  world: World;
  limits: Limits;
}

export interface FiguresMessage {
  type: 'figures';
  fps: number;
  sent_fps: number;
  bytes_per_s: number;
  encode_ms: number | null;
  pose_to_picture_ms: number | null;
  clients: number;
  flight: Record<string, number> | null;
}

export interface Picked {
  type: 'picked';
  id: number;
  n: number;
  point: [number, number, number] | null;
  distance_m: number | null;
}

/** A film that the server makes or keeps. */
export interface Film {
  id: number;
  name: string;
  size: [number, number];
  fps: number;
  quality: FilmQuality;
  state: 'drawing' | 'done' | 'failed';
  /** Frames that are drawn, of how many. */
  drawn?: number;
  frames?: number;
  bytes?: number;
  text?: string | null;
}

export type FilmQuality = 'default' | 'best' | 'finest';

export interface FilmsMessage {
  type: 'films';
  films: Film[];
  bytes: number;
  most_bytes: number;
}

/** What the map shows live; null where the server does not know it. */
export interface MapMessage {
  type: 'map';
  tiles: { resident: number[]; wanted: number[]; left_out: number } | null;
  footprint: [number, number][] | null;
}

export type ServerMessage =
  | Welcome
  | ({ type: 'state' } & StateMessage)
  | FiguresMessage
  | Picked
  | FilmsMessage
  | MapMessage
  | { type: 'notice'; level: 'info' | 'warning'; text: string }
  | { type: 'pong'; id: number; time_ms: number }
  | { type: 'probe'; time_ms: number }
  | { type: 'error'; code: string; text: string; about: string }
  | { type: 'bye'; code: string; text: string };

export type ClientMessage =
  | { type: 'hello'; protocol: number; token?: string; name?: string; size: [number, number]; dpr: number; watch?: boolean; h264?: boolean }
  | ({ type: 'pose'; id: number } & Pose)
  | { type: 'size'; size: [number, number]; dpr: number }
  | ({ type: 'settings' } & Partial<Settings>)
  | { type: 'ack'; n: number; ms?: number; failed?: boolean }
  | { type: 'pick'; id: number; u: number; v: number; n?: number }
  | { type: 'map'; wanted: boolean }
  | { type: 'take-over' }
  | { type: 'release' }
  | { type: 'ping'; id: number }
  | { type: 'probed'; time_ms: number };

/** What stands before the bytes of a picture. */
export interface PictureHeader {
  n: number;
  kind: 'jpeg' | 'png' | 'h264';
  isAtRest: boolean;
  hasAllTiles: boolean;
  isLossless: boolean;
  /** The bytes are those of `terravision still` at the pose. */
  isExact: boolean;
  /** Of video: nothing before it is needed to decode it. */
  isKey: boolean;
  quality: number;
  frame: number;
  width: number;
  height: number;
  poseId: number;
  poseClient: number;
  pose: Pose;
  poseMs: number;
  drawnMs: number;
  handedMs: number;
  flight: number;
}

const MAGIC = 0x46505654; // TVPF
const LEAST_HEADER = 128;
const KINDS = ['jpeg', 'png', 'h264'] as const;

/** Reads the header of a binary message, and where the file begins; undefined for what is not a picture. */
export function readPicture(message: ArrayBuffer): { header: PictureHeader; file: ArrayBuffer } | undefined {
  if (message.byteLength < LEAST_HEADER) return undefined;
  const view = new DataView(message);
  const length = view.getUint16(6, true);
  if (view.getUint32(0, true) !== MAGIC || view.getUint16(4, true) !== 1) return undefined;
  if (length < LEAST_HEADER || length > message.byteLength) return undefined;
  const flags = view.getUint8(13);
  const f64 = (offset: number) => view.getFloat64(offset, true);
  const header: PictureHeader = {
    n: view.getUint32(8, true),
    kind: KINDS[view.getUint8(12)] ?? 'jpeg',
    isAtRest: (flags & 1) !== 0,
    hasAllTiles: (flags & 2) !== 0,
    isLossless: (flags & 4) !== 0,
    isExact: (flags & 8) !== 0,
    isKey: (flags & 16) !== 0,
    quality: view.getUint16(14, true),
    frame: Number(view.getBigUint64(16, true)),
    width: view.getUint32(24, true),
    height: view.getUint32(28, true),
    poseId: view.getUint32(32, true),
    poseClient: view.getUint32(36, true),
    pose: { x: f64(40), y: f64(48), z: f64(56), heading: f64(64), pitch: f64(72), roll: f64(80), vfov: f64(88) },
    poseMs: f64(96),
    drawnMs: f64(104),
    handedMs: f64(112),
    flight: view.getUint32(120, true),
  };
  return { header, file: message.slice(length) };
}

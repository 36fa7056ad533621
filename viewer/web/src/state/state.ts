import type { FiguresMessage, FilmsMessage, MapMessage, Limits, Person, PictureHeader, Settings, World, Flight } from '../link/protocol';
import type { Pose } from '../math/pose';
import type { Vec3 } from '../math/vector';
import type { LatencySummary } from './latency';

/** How the page stands with the server. */
export type Link =
  | { kind: 'connecting' }
  | { kind: 'open' }
  | { kind: 'lost' }
  | { kind: 'refused'; code: string; text: string };

export interface Note {
  id: number;
  level: 'info' | 'warning';
  text: string;
}

/** What the page shows. */
export interface State {
  link: Link;
  version: string;
  world: World | undefined;
  limits: Limits | undefined;
  settings: Settings | undefined;
  isReadOnly: boolean;
  flight: Flight;
  flightReason: string | null;
  you: number | undefined;
  pilot: number | null;
  people: Person[];
  /** The camera of this page, some times a second. */
  pose: Pose | undefined;
  /** Height of the ground as drawn under the camera, and whether the camera is over the world. */
  groundBelow: number | undefined;
  isOverWorld: boolean;
  /** What is under the cursor; null: sky, or no data. */
  cursor: { point: Vec3; distance: number } | null;
  shown: PictureHeader | undefined;
  figures: FiguresMessage | undefined;
  latency: LatencySummary | undefined;
  films: FilmsMessage | undefined;
  map: MapMessage | undefined;
  notes: Note[];
}

export const EMPTY: State = {
  link: { kind: 'connecting' },
  version: '',
  world: undefined,
  limits: undefined,
  settings: undefined,
  isReadOnly: false,
  flight: 'starting',
  flightReason: null,
  you: undefined,
  pilot: null,
  people: [],
  pose: undefined,
  groundBelow: undefined,
  isOverWorld: true,
  cursor: null,
  shown: undefined,
  figures: undefined,
  latency: undefined,
  films: undefined,
  map: undefined,
  notes: [],
};

/** Whether this page moves the camera. */
export const isPilot = (state: State): boolean => state.you !== undefined && state.pilot === state.you;

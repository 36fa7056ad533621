import type { World } from '../link/protocol';
import { lonLatOf } from '../math/lonlat';

/** How it is said where the sun stands. */
export type SunKind = 'off' | 'auto' | 'angles' | 'time';

/** Of a setting, as `--sun` takes it. */
export function kindOfSun(sun: string | null): SunKind {
  const text = (sun ?? 'off').toLowerCase();
  if (text === 'off' || text === 'auto') return text;
  return text.includes(',') ? 'angles' : 'time';
}

/** Where the sun stands when a way to say it is chosen: in the north west, or where it is this morning. */
export function nextSun(kind: SunKind, world: World | undefined, now: Date): string {
  if (kind === 'angles') return '315,45';
  if (kind !== 'time') return kind;
  const hours = zoneHours(world);
  const day = new Date(now.getTime() + hours * 3.6e6).toISOString().slice(0, 10);
  return `${day}T09:00${offset(hours)}`;
}

/** Hours that clocks are ahead of UTC in the middle of the world, by its longitude; 0 where the page does not know it. */
function zoneHours(world: World | undefined): number {
  if (world === undefined) return 0;
  const [x, y] = [0, 1].map((axis) => (world.bounds[0][axis]! + world.bounds[1][axis]!) / 2) as [number, number];
  const lon = world.is_geographic ? x : lonLatOf(world.epsg, x, y)?.lon;
  return lon === undefined ? 0 : Math.round(lon / 15);
}

const offset = (hours: number): string => (hours === 0 ? 'Z' : `${hours < 0 ? '-' : '+'}${String(Math.abs(hours)).padStart(2, '0')}:00`);

/** Another date and time of day in the same zone. */
export const withClock = (sun: string, clock: string): string => clock.slice(0, 16) + (zoneText(sun) || 'Z');

/** The zone that a time is in, for people. */
export function zoneOf(sun: string): string {
  const zone = zoneText(sun);
  return zone === '' || /^z$/i.test(zone) ? 'UTC' : `UTC${zone.replace('-', '−')}`;
}

const zoneText = (sun: string): string => /(z|[+-]\d\d:?(\d\d)?)$/i.exec(sun.slice(11))?.[0] ?? '';

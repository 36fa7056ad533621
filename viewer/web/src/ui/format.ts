import { lonLatOf } from '../math/lonlat';
import type { Vec3 } from '../math/vector';
import type { World } from '../link/protocol';

const grouped = (digits: number) => new Intl.NumberFormat('en', { minimumFractionDigits: digits, maximumFractionDigits: digits });

/** A number with thin spaces between thousands. */
export const number = (value: number, digits = 0): string => grouped(digits).format(value).replace(/,/g, '\u202f');

export const metres = (value: number): string => {
  if (Math.abs(value) >= 10_000) return `${number(value / 1000, 1)} km`;
  return `${number(value, Math.abs(value) < 10 ? 1 : 0)} m`;
};

export const squareMetres = (value: number): string => (value >= 1e5 ? `${number(value / 1e6, value >= 1e8 ? 1 : 3)} km²` : `${number(value)} m²`);

export const bytes = (value: number): string => {
  if (value >= 1e9) return `${number(value / 1e9, 1)} GB`;
  if (value >= 1e6) return `${number(value / 1e6, 1)} MB`;
  return `${number(value / 1e3, 0)} kB`;
};

export const milliseconds = (value: number): string => `${number(value, value < 10 ? 1 : 0)} ms`;

/** A place in the world's CRS. */
export const place = (x: number, y: number, world: World | undefined): string =>
  world?.is_geographic ? `${y.toFixed(5)}°, ${x.toFixed(5)}°` : `E ${number(x)}  N ${number(y)}`;

/** Longitude and latitude where the page can work them out. */
export function lonLat(point: Vec3, world: World | undefined): string | undefined {
  const found = lonLatOf(world?.epsg ?? null, point[0], point[1]);
  if (found === undefined) return undefined;
  const { lon, lat } = found;
  return `${Math.abs(lat).toFixed(5)}° ${lat < 0 ? 'S' : 'N'}, ${Math.abs(lon).toFixed(5)}° ${lon < 0 ? 'W' : 'E'}`;
}

import type { World } from '../link/protocol';
import type { Vec3 } from '../math/vector';
import { groundLength, planArea, planLength, type Station } from './geometry';
import type { Tool } from './measuring';

const round = (value: number): number => Number(value.toFixed(3));

/**
 * What was measured, as GeoJSON in the world's CRS. RFC 7946 knows longitudes and latitudes only; GIS programs read the
 * member `crs` of the version before it.
 */
export function toGeoJson(tool: Tool, points: readonly Vec3[], profile: readonly Station[], world: World): string {
  const positions = points.map((point) => point.map(round));
  const geometry =
    tool === 'area' && positions.length > 2
      ? { type: 'Polygon', coordinates: [[...positions, positions[0]]] }
      : positions.length > 1
        ? { type: 'LineString', coordinates: positions }
        : { type: 'Point', coordinates: positions[0] ?? [] };
  const properties: Record<string, number> = { length_m: round(planLength(points)), length_over_ground_m: round(groundLength(profile)) };
  if (tool === 'area') properties.area_m2 = round(planArea(points));
  const crs = world.epsg === null ? {} : { crs: { type: 'name', properties: { name: `urn:ogc:def:crs:EPSG::${world.epsg}` } } };
  const feature = { type: 'Feature', properties, geometry };
  return `${JSON.stringify({ type: 'FeatureCollection', ...crs, features: [feature] }, null, 1)}\n`;
}

/** The profile: a line for each station. */
export function toCsv(profile: readonly Station[]): string {
  const lines = profile.map(({ along, x, y, height }) => [round(along), round(x), round(y), height === null ? '' : round(height)].join(','));
  return `distance_m,x,y,height_m\n${lines.join('\n')}\n`;
}

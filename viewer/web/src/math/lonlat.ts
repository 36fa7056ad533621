import { degrees } from './vector';

/** WGS 84. */
const SEMI_MAJOR = 6378137;
const FLATTENING = 1 / 298.257223563;

/** Longitude and latitude of a place, for the CRSs whose formulas are short: UTM on WGS 84, and Web Mercator. */
export function lonLatOf(epsg: number | null, x: number, y: number): { lon: number; lat: number } | undefined {
  if (epsg === null) return undefined;
  if (epsg === 3857) {
    return { lon: degrees(x / SEMI_MAJOR), lat: degrees(2 * Math.atan(Math.exp(y / SEMI_MAJOR)) - Math.PI / 2) };
  }
  const isNorth = epsg > 32600 && epsg <= 32660;
  const isSouth = epsg > 32700 && epsg <= 32760;
  if (!isNorth && !isSouth) return undefined;
  return fromTransverseMercator(x - 500_000, isSouth ? y - 10_000_000 : y, ((epsg % 100) - 1) * 6 - 177);
}

/** Krüger's series to the third order of n: below a millimetre within a UTM zone (Karney 2011, equations 15 to 17 and 36). */
function fromTransverseMercator(x: number, y: number, meridian: number): { lon: number; lat: number } {
  const n = FLATTENING / (2 - FLATTENING);
  const radius = (SEMI_MAJOR / (1 + n)) * (1 + n ** 2 / 4 + n ** 4 / 64);
  const beta = [n / 2 - (2 / 3) * n ** 2 + (37 / 96) * n ** 3, n ** 2 / 48 + n ** 3 / 15, (17 / 480) * n ** 3];
  const delta = [2 * n - (2 / 3) * n ** 2 - 2 * n ** 3, (7 / 3) * n ** 2 - (8 / 5) * n ** 3, (56 / 15) * n ** 3];
  const xi = y / (0.9996 * radius);
  const eta = x / (0.9996 * radius);
  let [a, b] = [xi, eta];
  beta.forEach((value, i) => {
    const k = 2 * (i + 1);
    a -= value * Math.sin(k * xi) * Math.cosh(k * eta);
    b -= value * Math.cos(k * xi) * Math.sinh(k * eta);
  });
  const chi = Math.asin(Math.sin(a) / Math.cosh(b));
  let lat = chi;
  delta.forEach((value, i) => (lat += value * Math.sin(2 * (i + 1) * chi)));
  return { lon: meridian + degrees(Math.atan2(Math.sinh(b), Math.cos(a))), lat: degrees(lat) };
}


import type { Station } from './geometry';

/** A profile in the coordinates of a drawing. */
export interface Chart {
  width: number;
  height: number;
  /** Lines of the ground: one for each piece without gaps. */
  lines: string[];
  /** The same, closed at the bottom. */
  areas: string[];
  xTicks: { at: number; label: string }[];
  yTicks: { at: number; label: string }[];
  xOf(along: number): number;
  yOf(height: number): number;
}

export const MARGIN = { left: 46, right: 10, top: 8, bottom: 20 };

/** Round numbers from low to high, about as many as asked. */
export function ticks(low: number, high: number, count: number): number[] {
  const span = high - low;
  if (!(span > 0)) return [low];
  const raw = span / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  const unit = [1, 2, 5, 10].map((k) => k * power).find((k) => k >= raw) ?? 10 * power;
  const found: number[] = [];
  for (let k = Math.ceil(low / unit); k * unit <= high + unit * 1e-9; k++) found.push(Number((k * unit).toPrecision(12)));
  return found;
}

export const kilometres = (metres: number): string => (metres >= 1000 ? `${Number((metres / 1000).toFixed(2))} km` : `${Number(metres.toFixed(1))} m`);

export function chartOf(profile: readonly Station[], width: number, height: number): Chart | undefined {
  const known = profile.filter((station): station is Station & { height: number } => station.height !== null);
  const last = profile[profile.length - 1];
  if (known.length < 2 || last === undefined) return undefined;
  const heights = known.map((station) => station.height);
  const [lowest, highest] = [Math.min(...heights), Math.max(...heights)];
  const pad = Math.max(1, (highest - lowest) * 0.08);
  const [low, high] = [lowest - pad, highest + pad];
  const inner = { width: width - MARGIN.left - MARGIN.right, height: height - MARGIN.top - MARGIN.bottom };
  const xOf = (along: number) => MARGIN.left + (along / last.along) * inner.width;
  const yOf = (value: number) => MARGIN.top + (1 - (value - low) / (high - low)) * inner.height;
  const pieces: string[][] = [[]];
  for (const { along, height: value } of profile) {
    if (value === null) pieces.push([]);
    else pieces[pieces.length - 1]!.push(`${xOf(along).toFixed(1)},${yOf(value).toFixed(1)}`);
  }
  const drawn = pieces.filter((piece) => piece.length > 1);
  const bottom = (MARGIN.top + inner.height).toFixed(1);
  return {
    width,
    height,
    lines: drawn.map((piece) => `M${piece.join('L')}`),
    areas: drawn.map((piece) => `M${piece.join('L')}L${piece[piece.length - 1]!.split(',')[0]},${bottom}L${piece[0]!.split(',')[0]},${bottom}Z`),
    xTicks: ticks(0, last.along, Math.max(2, Math.floor(inner.width / 90))).map((value) => ({ at: xOf(value), label: kilometres(value) })),
    yTicks: ticks(low, high, Math.max(2, Math.floor(inner.height / 32))).map((value) => ({ at: yOf(value), label: `${value}` })),
    xOf,
    yOf,
  };
}

/** The chart as a file of its own. */
export function toSvg(profile: readonly Station[], title: string): string {
  const chart = chartOf(profile, 900, 300);
  if (chart === undefined) return '<svg xmlns="http://www.w3.org/2000/svg"/>\n';
  const escaped = title.replace(/[<&]/g, (c) => (c === '<' ? '&lt;' : '&amp;'));
  const grid = chart.yTicks.map(
    ({ at, label }) =>
      `<path d="M${MARGIN.left},${at.toFixed(1)}H${chart.width - MARGIN.right}" stroke="#ddd"/><text x="${MARGIN.left - 6}" y="${(at + 4).toFixed(1)}" text-anchor="end">${label}</text>`,
  );
  const below = chart.xTicks.map(({ at, label }) => `<text x="${at.toFixed(1)}" y="${chart.height - 4}" text-anchor="middle">${label}</text>`);
  return [
    `<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 ${chart.width} ${chart.height}" font-family="sans-serif" font-size="11" fill="#333">`,
    `<title>${escaped}</title><rect width="100%" height="100%" fill="#fff"/>`,
    ...grid,
    ...below,
    ...chart.areas.map((d) => `<path d="${d}" fill="#cfe3f5"/>`),
    ...chart.lines.map((d) => `<path d="${d}" fill="none" stroke="#1f6fb2" stroke-width="1.5"/>`),
    '</svg>\n',
  ].join('\n');
}

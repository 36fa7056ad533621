import { useEffect, useRef } from 'preact/hooks';
import type { App } from '../app';
import type { Station } from '../measure/geometry';
import { MIDDLE, projectIn, type Eye } from '../math/stereo';
import type { Vec3 } from '../math/vector';

const SVG = 'http://www.w3.org/2000/svg';

/**
 * What is being measured, over the picture, and in a pair what is under the cursor: moves with the camera, so it is drawn
 * without the component's help.
 */
export function MeasureOverlay({ app }: { app: App }) {
  const drawing = useRef<SVGSVGElement>(null);
  useEffect(() => {
    let request: number | undefined;
    const redraw = () => {
      request ??= requestAnimationFrame(() => {
        request = undefined;
        draw(drawing.current, app);
      });
    };
    const ends = [app.viewer.watchMoves(redraw), app.measuring.store.subscribe(redraw), app.viewer.store.subscribe(redraw)];
    redraw();
    return () => {
      for (const end of ends) end();
      if (request !== undefined) cancelAnimationFrame(request);
    };
  }, [app]);
  return <svg ref={drawing} class="overlay" aria-hidden="true" />;
}

function draw(drawing: SVGSVGElement | null, app: App): void {
  const { viewer } = app;
  if (drawing === null || viewer.pose === undefined || viewer.picture === undefined) return;
  const { pair, eye: size } = viewer;
  const eyes: readonly Eye[] = pair ?? [MIDDLE];
  // Each eye in a box of its own: what is outside of its half is not seen.
  const boxes = eyes.map((eye, i) => {
    const box = element('svg', { x: String(i * size.width), width: String(size.width), height: String(size.height) });
    box.append(...shapes(app, eye));
    return box;
  });
  drawing.replaceChildren(...boxes);
}

/** What an eye sees of it. */
function shapes(app: App, eye: Eye): SVGElement[] {
  const { viewer } = app;
  const { points, tool, profile, marked } = app.measuring.store.get();
  const at = (point: Vec3) => projectIn(eye, viewer.pose!, viewer.eye, [point[0], point[1], point[2] * viewer.exaggeration]);
  const circle = (point: Vec3, r: string, kind: string) => {
    const place = at(point);
    return place === undefined ? [] : [element('circle', { cx: place.u.toFixed(1), cy: place.v.toFixed(1), r, class: kind })];
  };
  const line = outline(points, profile, tool === 'area').map(at);
  const path = line.map((point, i) => (point === undefined ? '' : `${i > 0 && line[i - 1] !== undefined ? 'L' : 'M'}${point.u.toFixed(1)},${point.v.toFixed(1)}`)).join('');
  const station = marked === undefined ? undefined : profile[marked];
  const { cursor } = viewer.store.get();
  return [
    ...(path === '' ? [] : ['halo', 'line'].map((kind) => element('path', { d: path, class: kind }))),
    ...points.flatMap((point) => circle(point, '5', 'point')),
    ...(station === undefined || station.height === null ? [] : circle([station.x, station.y, station.height], '7', 'mark')),
    // The pointer is over one half: what it points at is marked for both eyes.
    ...(eye === MIDDLE || cursor === null ? [] : circle(cursor.point, '8', 'here')),
  ];
}

/** Along the ground once its heights are known, straight until then. */
function outline(points: readonly Vec3[], profile: readonly Station[], isClosed: boolean): Vec3[] {
  if (profile.length > 1) return profile.filter(({ height }) => height !== null).map(({ x, y, height }) => [x, y, height!]);
  return isClosed && points.length > 2 ? [...points, points[0]!] : [...points];
}

function element(name: string, attributes: Record<string, string>): SVGElement {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

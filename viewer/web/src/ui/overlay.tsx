import { useEffect, useRef } from 'preact/hooks';
import type { App } from '../app';
import type { Station } from '../measure/geometry';
import { project } from '../math/pose';
import type { Vec3 } from '../math/vector';

const SVG = 'http://www.w3.org/2000/svg';

/** What is being measured, over the picture: moves with the camera, so it is drawn without the component's help. */
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
    const ends = [app.viewer.watchMoves(redraw), app.measuring.store.subscribe(redraw)];
    redraw();
    return () => {
      for (const end of ends) end();
      if (request !== undefined) cancelAnimationFrame(request);
    };
  }, [app]);
  return <svg ref={drawing} class="overlay" aria-hidden="true" />;
}

function draw(drawing: SVGSVGElement | null, app: App): void {
  const pose = app.viewer.pose;
  const size = app.viewer.picture?.size;
  if (drawing === null || pose === undefined || size === undefined) return;
  const { points, tool, profile, marked } = app.measuring.store.get();
  const shape = document.createDocumentFragment();
  const at = (point: Vec3) => project(pose, size, [point[0], point[1], point[2] * app.viewer.exaggeration]);
  const line = outline(points, profile, tool === 'area').map(at);
  const path = line.map((point, i) => (point === undefined ? '' : `${i > 0 && line[i - 1] !== undefined ? 'L' : 'M'}${point.u.toFixed(1)},${point.v.toFixed(1)}`)).join('');
  for (const kind of ['halo', 'line']) shape.append(element('path', { d: path, class: kind }));
  for (const place of points.map(at)) {
    if (place !== undefined) shape.append(element('circle', { cx: place.u.toFixed(1), cy: place.v.toFixed(1), r: '5' }));
  }
  const station = marked === undefined ? undefined : profile[marked];
  const mark = station === undefined || station.height === null ? undefined : at([station.x, station.y, station.height]);
  if (mark !== undefined) shape.append(element('circle', { cx: mark.u.toFixed(1), cy: mark.v.toFixed(1), r: '7', class: 'mark' }));
  drawing.replaceChildren(shape);
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

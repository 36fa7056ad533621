import { useEffect, useRef, useState } from 'preact/hooks';
import type { App } from '../app';
import { kilometres, MARGIN, ticks } from '../measure/chart';
import { useStore } from '../state/store';
import { sideOf, type Side } from '../paths/side';
import { metres } from './format';

/** Samples of the way, and the pause before the ground below a new one is asked for. */
const SAMPLES = 160;
const GROUND_PAUSE_MS = 250;
/** Keyframes that can be taken hold of: of more there would be no room for hands. */
const MOST_HANDLES = 60;

/** A keyframe that is pulled: the scale as it was taken, and how many units below its middle the hand took it. */
interface Hold {
  index: number;
  side: Side;
  beside: number;
  moved: boolean;
}

/** The path from the side: height over distance, above the ground. Keyframes are pulled up and down. */
export function SideView({ app }: { app: App }) {
  const { keyframes, target, t } = useStore(app.path.store, (state) => state);
  const drawing = useRef<SVGSVGElement>(null);
  // While a keyframe is pulled, the scale stays. Moves come before the page is drawn anew: they ask the reference.
  const hold = useRef<Hold | undefined>(undefined);
  const [held, setHeld] = useState<Hold | undefined>(undefined);
  const take = (taken: Hold | undefined) => setHeld((hold.current = taken));
  const ground = useGround(app);
  const spline = app.path.spline;
  useEffect(() => take(undefined), [keyframes.length, target === undefined]);
  if (spline === undefined) return null;
  const isNarrow = window.innerWidth <= 640;
  const size = { width: isNarrow ? 366 : 560, height: 150 };
  const fresh = sideOf(spline.samples(SAMPLES), keyframes, ground, size);
  const side = held === undefined ? fresh : { ...fresh, yOf: held.side.yOf, heightAt: held.side.heightAt, yTicks: held.side.yTicks };

  const rowOf = (event: PointerEvent) => {
    const box = drawing.current!.getBoundingClientRect();
    return ((event.clientY - box.top) / box.height) * size.height;
  };
  const pull = (event: PointerEvent) => {
    const { current } = hold;
    if (current === undefined) return;
    app.path.move(current.index, { z: current.side.heightAt(rowOf(event) - current.beside) }, current.moved);
    current.moved = true;
  };
  const key = (event: KeyboardEvent, index: number) => {
    const way = { ArrowUp: 1, ArrowDown: -1 }[event.key];
    if (way === undefined) return;
    event.preventDefault();
    event.stopPropagation();
    const step = ((side.high - side.low) / 40) * (event.shiftKey ? 5 : 1);
    app.path.move(index, { z: keyframes[index]!.z + way * step });
  };
  return (
    <div class="profile side">
      <svg ref={drawing} viewBox={`0 0 ${size.width} ${size.height}`} role="group" aria-label="The path from the side: height over distance" onPointerMove={pull} onPointerUp={() => take(undefined)}>
        {side.yTicks.map((value) => (
          <g key={value}>
            <path class="grid" d={`M${MARGIN.left},${side.yOf(value)}H${size.width - MARGIN.right}`} />
            <text x={MARGIN.left - 6} y={side.yOf(value) + 4} text-anchor="end">
              {value}
            </text>
          </g>
        ))}
        {ticks(0, side.length, isNarrow ? 3 : 5).map((value) => (
          <text key={value} x={side.xOf(value)} y={size.height - 5} text-anchor="middle">
            {kilometres(value)}
          </text>
        ))}
        {side.ground !== '' && <path class="ground" d={side.ground} />}
        <path class="way" d={side.way} />
        <path class="mark" d={`M${side.xOf(side.alongAt(t))},${MARGIN.top}V${size.height - MARGIN.bottom}`} />
        {keyframes.slice(0, keyframes.length > MOST_HANDLES ? 0 : MOST_HANDLES).map((frame, index) => (
          <circle
            key={index}
            class="handle"
            role="slider"
            tabIndex={0}
            aria-label={`Height of keyframe ${index + 1}`}
            aria-valuemin={Math.round(side.low)}
            aria-valuemax={Math.round(side.high)}
            aria-valuenow={Math.round(frame.z)}
            aria-valuetext={metres(frame.z)}
            cx={side.xOf(side.alongAt(frame.t))}
            cy={side.yOf(frame.z)}
            r="7"
            onPointerDown={(event) => {
              event.currentTarget.setPointerCapture(event.pointerId);
              take({ index, side, beside: rowOf(event) - side.yOf(frame.z), moved: false });
            }}
            onKeyDown={(event) => key(event, index)}
          />
        ))}
      </svg>
      <p class="hint">Pull keyframes up and down here, and to another place on the map.</p>
    </div>
  );
}

/** Heights of the ground below the samples of the way, as drawn; empty until they have come. */
function useGround(app: App): readonly (number | null)[] {
  const { keyframes } = useStore(app.path.store, (state) => state);
  const exaggeration = useStore(app.viewer.store, () => app.viewer.exaggeration);
  const [ground, setGround] = useState<readonly (number | null)[]>([]);
  // What is above the ground decides nothing about what is below.
  const places = keyframes.map(({ x, y, t }) => `${x} ${y} ${t}`).join();
  useEffect(() => {
    let isCurrent = true;
    const timer = window.setTimeout(() => {
      const samples = app.path.spline?.samples(SAMPLES) ?? [];
      app.viewer.api
        .heights(samples.map(({ x, y }) => [x, y] as const))
        .then((heights) => isCurrent && setGround(heights.map((height) => (height === null ? null : height * exaggeration))))
        .catch(() => {
          // The way is shown without the ground.
        });
    }, GROUND_PAUSE_MS);
    return () => {
      isCurrent = false;
      window.clearTimeout(timer);
    };
  }, [app, places, exaggeration]);
  return ground;
}

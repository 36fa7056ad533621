import { useEffect, useRef } from 'preact/hooks';
import type { App } from '../app';
import { INTERVALS } from '../state/latency';
import { useStore } from '../state/store';
import { Figure } from './controls';
import { bytes, milliseconds, number } from './format';

/** What the flight says about itself, and what the page measures. */
export function FiguresTab({ app }: { app: App }) {
  const { figures, latency } = useStore(app.viewer.store, (state) => state);
  const flight = figures?.flight ?? {};
  const metric = (name: string): number | undefined => flight[`terravision_${name}`] ?? flight[name];
  const pool = (name: string, kind: string) => metric(`${name}{pool="${kind}"}`);
  const share = (used: number | undefined, all: number | undefined) =>
    used === undefined || all === undefined ? undefined : `${number(used)} of ${number(all)}`;
  const rows: [string, string | undefined][] = [
    ['Tiles resident', share(metric('frame_tiles_resident'), metric('frame_tiles_wanted'))],
    ['In flight', metric('tiles_in_flight')?.toString()],
    ['Elevation pool', share(pool('pool_slots_used', 'elevation'), pool('pool_slots', 'elevation'))],
    ['Color pool', share(pool('pool_slots_used', 'color'), pool('pool_slots', 'color'))],
    ['Frames late / skipped', join(metric('frames_late_total'), metric('frames_skipped_total'))],
    ['Memory', memoryOf(flight)],
  ];
  return (
    <div class="columns">
      <section class="group wide" aria-label="Frame times">
        <h2>Time from picture to picture</h2>
        <FrameTimes app={app} />
      </section>
      <section class="group" aria-label="Stream">
        <h2>Stream</h2>
        <dl class="figures">
          <Figure name="Drawn">{figures === undefined ? '…' : `${figures.fps.toFixed(1)} /s`}</Figure>
          <Figure name="Received">{figures === undefined ? '…' : `${figures.sent_fps.toFixed(1)} /s, ${bytes(figures.bytes_per_s)}/s`}</Figure>
          <Figure name="Latency">{latency === undefined ? '…' : milliseconds(latency.medianMs)}</Figure>
          <Figure name="· 95 % below">{latency === undefined ? '…' : milliseconds(latency.p95Ms)}</Figure>
          <Figure name="· drawing">{latency === undefined ? '…' : milliseconds(latency.drawMs)}</Figure>
          <Figure name="· encoding">{latency === undefined ? '…' : milliseconds(latency.encodeMs)}</Figure>
          <Figure name="· link, decoding">{latency === undefined ? '…' : milliseconds(latency.restMs)}</Figure>
        </dl>
      </section>
      <section class="group" aria-label="Flight">
        <h2>Flight</h2>
        <dl class="figures">
          {rows
            .filter(([, value]) => value !== undefined)
            .map(([name, value]) => (
              <Figure key={name} name={name}>
                {value}
              </Figure>
            ))}
          {figures?.flight == null && <Figure name="Metrics">none yet</Figure>}
        </dl>
      </section>
    </div>
  );
}

const join = (a: number | undefined, b: number | undefined): string | undefined =>
  a === undefined || b === undefined ? undefined : `${number(a)} / ${number(b)}`;

function memoryOf(flight: Record<string, number>): string | undefined {
  const name = Object.keys(flight).find((key) => /memory.*bytes/.test(key));
  return name === undefined ? undefined : bytes(flight[name]!);
}

/** The last intervals as bars; a line marks the target rate. */
function FrameTimes({ app }: { app: App }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  useEffect(() => {
    const draw = () => paint(canvas.current, app.viewer.latency.intervals, app.viewer.store.get().settings?.fps ?? undefined);
    const end = app.viewer.watchPictures(() => requestAnimationFrame(draw));
    draw();
    return end;
  }, [app]);
  return <canvas ref={canvas} class="times" role="img" aria-label="Milliseconds from picture to picture, newest at the right" />;
}

const TOP_MS = 100;

function paint(canvas: HTMLCanvasElement | null, intervals: readonly number[], fps: number | undefined): void {
  const context = canvas?.getContext('2d');
  if (canvas == null || context == null) return;
  const scale = window.devicePixelRatio;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = Math.round(width * scale);
  canvas.height = Math.round(height * scale);
  context.scale(scale, scale);
  const yOf = (ms: number) => height - 4 - (Math.min(ms, TOP_MS) / TOP_MS) * (height - 10);
  context.font = '11px system-ui, sans-serif';
  for (const ms of [0, 50, 100]) {
    context.fillStyle = '#2a3743';
    context.fillRect(0, Math.round(yOf(ms)), width - 46, 1);
    context.fillStyle = '#9fb0c0';
    context.fillText(`${ms} ms`, width - 42, yOf(ms) + (ms === 100 ? 8 : 3));
  }
  const bar = (width - 50) / INTERVALS;
  intervals.forEach((ms, i) => {
    const x = width - 50 - (intervals.length - i) * bar;
    context.fillStyle = ms > 66 ? '#f0b54a' : '#5fb3f0';
    context.fillRect(x, yOf(ms), Math.max(1, bar - 0.5), height - 4 - yOf(ms));
  });
  if (fps !== undefined) {
    context.fillStyle = '#7ddc9a';
    context.fillRect(0, Math.round(yOf(1000 / fps)), width - 46, 1);
  }
}

import { useState } from 'preact/hooks';
import type { App } from '../app';
import type { Settings } from '../link/protocol';
import { isPilot } from '../state/state';
import { useStore } from '../state/store';
import { kindOfSun, nextSun, withClock, zoneOf, type SunKind } from '../state/sun';
import { Choice, NumberField } from './controls';

const KINDS: readonly (readonly [SunKind, string])[] = [
  ['off', 'Off'],
  ['auto', 'Auto'],
  ['angles', 'Angles'],
  ['time', 'Time'],
];
/** How far one sees when haze is first chosen, metres. */
const USUAL_HAZE_M = 30_000;

interface PartProps {
  settings: Settings;
  canChange: boolean;
  change(part: Partial<Settings>): void;
}

/** The sun, its shadows, and the air. */
export function LightTab({ app }: { app: App }) {
  const settings = useStore(app.viewer.store, (state) => state.settings);
  const canChange = useStore(app.viewer.store, (state) => isPilot(state) && !state.isReadOnly);
  if (settings === undefined) return <p class="hint">The server has not said yet how it draws.</p>;
  const part = { settings, canChange, change: (part: Partial<Settings>) => app.viewer.changeSettings(part) };
  return (
    <div class="columns">
      <Sun app={app} {...part} />
      <Air {...part} />
      <section class="group" aria-label="About light">
        <h2>What it changes</h2>
        <p class="hint">
          The sun lights the ground by its slopes. A photograph has the light of its own day in it already, so a sun adds to that; ground that is coloured by height is coloured
          anew. A change starts the flight again, which takes about a second. Stills and films have the same light.
        </p>
      </section>
    </div>
  );
}

function Sun({ app, settings, canChange, change }: PartProps & { app: App }) {
  const world = useStore(app.viewer.store, (state) => state.world);
  const { sun } = settings;
  const kind = kindOfSun(sun);
  const isOnEarth = world === undefined || world.body === 'Earth' || world.body === 'unknown';
  const place = { sun: sun ?? 'off', canChange, change: (sun: string) => change({ sun }) };
  return (
    <section class="group" aria-label="Sun">
      <h2>Sun</h2>
      <Choice
        label="Sun"
        value={kind}
        options={isOnEarth ? KINDS : KINDS.filter(([kind]) => kind !== 'time')}
        isDisabled={!canChange}
        change={(next) => next !== kind && place.change(nextSun(next, world, new Date()))}
      />
      {kind === 'auto' && <p class="hint">In the north west, 45° high, as relief maps have it.</p>}
      {kind === 'angles' && <Angles {...place} />}
      {kind === 'time' && <Time {...place} />}
      {kind !== 'off' && (
        <label class="check">
          <input type="checkbox" disabled={!canChange} checked={settings.shadows === true} onChange={() => change({ shadows: settings.shadows !== true })} />
          Ground throws shadows
        </label>
      )}
    </section>
  );
}

interface PlaceProps {
  sun: string;
  canChange: boolean;
  change(sun: string): void;
}

function Angles({ sun, canChange, change }: PlaceProps) {
  const [azimuth, altitude] = sun.split(',').map(Number) as [number, number];
  const field = (label: string, value: number, most: number, text: (value: number) => string) => (
    <NumberField label={label} unit="°" digits={1} step={5} low={-most} high={most} isDisabled={!canChange} value={value} change={(value) => value !== null && change(text(value))} />
  );
  return (
    <div class="fields two">
      {field('Azimuth', azimuth, 360, (value) => `${value},${altitude}`)}
      {field('Altitude', altitude, 90, (value) => `${azimuth},${value}`)}
    </div>
  );
}

/** A date and a time of day, taken with Enter or when the field is left: every change starts the flight again. */
function Time({ sun, canChange, change }: PlaceProps) {
  const [typed, setTyped] = useState<string | undefined>(undefined);
  const shown = sun.slice(0, 16).replace(/[ t]/, 'T');
  const take = () => {
    if (typed !== undefined && typed !== '' && typed !== shown) change(withClock(sun, typed));
    setTyped(undefined);
  };
  return (
    <label class="field">
      <span class="field-label">Date and time</span>
      <span class="field-box">
        <input
          type="datetime-local"
          disabled={!canChange}
          value={typed ?? shown}
          min="1950-01-01T00:00"
          max="2050-12-31T23:59"
          onInput={(event) => setTyped(event.currentTarget.value)}
          onKeyDown={(event) => event.key === 'Enter' && take()}
          onBlur={take}
        />
        <span class="field-unit">{zoneOf(sun)}</span>
      </span>
    </label>
  );
}

function Air({ settings: { haze }, canChange, change }: PartProps) {
  const hasHaze = (haze ?? 0) > 0;
  return (
    <section class="group" aria-label="Air">
      <h2>Air</h2>
      <Choice
        label="Air"
        value={hasHaze ? 'haze' : 'clear'}
        options={[
          ['clear', 'Clear'],
          ['haze', 'Haze'],
        ]}
        isDisabled={!canChange}
        change={(air) => (air === 'haze') !== hasHaze && change({ haze: hasHaze ? 0 : USUAL_HAZE_M })}
      />
      {hasHaze && (
        <div class="fields one">
          <NumberField
            label="Visibility"
            unit="km"
            digits={1}
            step={5}
            low={0.1}
            high={1e6}
            isDisabled={!canChange}
            value={haze! / 1000}
            change={(km) => km !== null && change({ haze: Math.round(km * 1000) })}
          />
        </div>
      )}
    </section>
  );
}

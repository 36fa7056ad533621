import type { App } from '../app';
import { useStore } from '../state/store';
import { isPilot } from '../state/state';
import type { Pose } from '../math/pose';
import type { Mode } from '../paths/editor';
import { Button, Choice, Figure, NumberField } from './controls';
import { lonLat, metres } from './format';
import { Icon } from './icons';

const MODES: readonly (readonly [Mode, string])[] = [
  ['free', 'Free'],
  ['orbit', 'Orbit'],
  ['planned', 'Planned'],
];

/** The camera: how it is moved, and its six degrees of freedom and field of view. */
export function FlyTab({ app }: { app: App }) {
  return (
    <div class="columns">
      <Navigation app={app} />
      <PoseFields app={app} />
      <Readings app={app} />
    </div>
  );
}

function Navigation({ app }: { app: App }) {
  const { mode, isPlaying, speed, t, keyframes } = useStore(app.path.store, (state) => state);
  const canFly = useStore(app.viewer.store, isPilot);
  const [first, last] = [keyframes[0], keyframes[keyframes.length - 1]];
  return (
    <section class="group" aria-label="Navigation">
      <h2>Navigation</h2>
      <Choice label="Navigation mode" value={mode} options={MODES} isDisabled={!canFly} change={(next) => app.path.setMode(next)} />
      {mode === 'free' ? (
        <p class="hint">Drag the ground, turn the wheel, or fly with W A S D. All hands: press ?</p>
      ) : (
        <div class="row">
          <Button label={isPlaying ? 'Pause' : 'Play'} isPrimary isDisabled={!canFly} click={() => app.path.playOrPause()}>
            <Icon name={isPlaying ? 'pause' : 'play'} />
            {isPlaying ? 'Pause' : 'Play'}
          </Button>
          <label class="slider">
            <span>Speed {speed.toFixed(speed < 1 ? 2 : 1)}×</span>
            <input
              type="range"
              min={-2}
              max={3}
              step={0.25}
              value={Math.log2(speed)}
              aria-valuetext={`${speed.toFixed(2)} times`}
              onInput={(event) => app.path.store.set({ speed: 2 ** Number(event.currentTarget.value) })}
            />
          </label>
        </div>
      )}
      {mode === 'orbit' && <p class="hint">Circles what is in the middle of the picture.</p>}
      {mode === 'planned' && first !== undefined && last !== undefined && first !== last && (
        <label class="slider">
          <span>
            {(t - first.t).toFixed(1)} of {(last.t - first.t).toFixed(1)} s
          </span>
          <input
            type="range"
            min={first.t}
            max={last.t}
            step="any"
            value={t}
            disabled={!canFly}
            aria-label="Moment of the path"
            aria-valuetext={`${(t - first.t).toFixed(1)} seconds`}
            onInput={(event) => {
              app.path.pause();
              app.path.scrub(Number(event.currentTarget.value));
            }}
          />
        </label>
      )}
      {mode === 'planned' && keyframes.length < 2 && <p class="hint">A path needs two keyframes: press K at each place, or load a file under Path.</p>}
    </section>
  );
}

const FIELDS: readonly { key: keyof Pose; label: string; unit: string; digits: number; step: number; low?: number; high?: number }[] = [
  { key: 'x', label: 'X, east', unit: 'm', digits: 1, step: 10 },
  { key: 'y', label: 'Y, north', unit: 'm', digits: 1, step: 10 },
  { key: 'z', label: 'Z, height', unit: 'm', digits: 1, step: 10 },
  { key: 'heading', label: 'Heading', unit: '°', digits: 2, step: 1 },
  { key: 'pitch', label: 'Pitch', unit: '°', digits: 2, step: 1, low: -90, high: 90 },
  { key: 'roll', label: 'Roll', unit: '°', digits: 2, step: 1 },
  { key: 'vfov', label: 'Field of view', unit: '°', digits: 1, step: 1, low: 1, high: 170 },
];

function PoseFields({ app }: { app: App }) {
  const pose = useStore(app.viewer.store, (state) => state.pose);
  const canFly = useStore(app.viewer.store, isPilot);
  const isGeographic = useStore(app.viewer.store, (state) => state.world?.is_geographic ?? false);
  return (
    <section class="group wide" aria-label="Camera">
      <h2>Camera</h2>
      <div class="fields">
        {FIELDS.map(({ key, ...field }) => {
          const inDegrees = isGeographic && (key === 'x' || key === 'y');
          return (
            <NumberField
              key={key}
              {...field}
              {...(inDegrees ? { unit: '°', digits: 6, step: 0.001 } : {})}
              value={pose?.[key]}
              isDisabled={!canFly || pose === undefined}
              change={(value) => {
                app.motion.stop();
                if (value !== null && app.viewer.pose !== undefined) app.viewer.setPose({ ...app.viewer.pose, [key]: value });
              }}
            />
          );
        })}
      </div>
    </section>
  );
}

function Readings({ app }: { app: App }) {
  const { pose, groundBelow, world, isOverWorld } = useStore(app.viewer.store, (state) => state);
  const position = pose === undefined ? undefined : lonLat([pose.x, pose.y, pose.z], world);
  return (
    <section class="group" aria-label="View">
      <h2>View</h2>
      <dl class="figures">
        <Figure name="Above ground">
          {pose === undefined || groundBelow === undefined ? (isOverWorld ? '…' : 'no ground here') : metres(pose.z - groundBelow)}
        </Figure>
        {position !== undefined && <Figure name="Position">{position}</Figure>}
        <Figure name="CRS">{world === undefined ? '…' : world.epsg === null ? world.crs : `EPSG:${world.epsg}`}</Figure>
      </dl>
      <div class="row wrap">
        <Button click={() => void app.actions.copyLink()} title="Copy a link to this view">
          <Icon name="link" />
          Link
        </Button>
        <Button click={() => void app.actions.copyCommand()} title="Copy the terravision still command of this view">
          <Icon name="command" />
          Command
        </Button>
        <Button click={() => void app.actions.savePicture()} title="Save this view as PNG, at the best quality">
          <Icon name="save" />
          PNG
        </Button>
      </div>
    </section>
  );
}

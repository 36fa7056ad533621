import { useRef } from 'preact/hooks';
import type { App } from '../app';
import { isPilot } from '../state/state';
import { useStore } from '../state/store';
import { Button, NumberField } from './controls';
import { FilmGroup } from './films';
import { place } from './format';
import { Icon } from './icons';
import { Keyframes } from './keyframes';

export function PathTab({ app }: { app: App }) {
  return (
    <div class="columns">
      <PathGroup app={app} />
      <Keyframes app={app} />
      <FilmGroup app={app} />
    </div>
  );
}

function PathGroup({ app }: { app: App }) {
  const { keyframes, isPlaying, isRecording, problem } = useStore(app.path.store, (state) => state);
  const canFly = useStore(app.viewer.store, isPilot);
  const isFlyable = keyframes.length >= 2;
  return (
    <section class="group tools" aria-label="Path">
      <h2>Path</h2>
      <div class="row wrap">
        <Button isPrimary title="The camera of now becomes a keyframe (K)" click={() => app.path.addKeyframe()}>
          <Icon name="plus" />
          Keyframe
        </Button>
        <Button title="Record what you fly" isDisabled={!canFly} class={isRecording ? 'recording' : ''} click={() => app.path.toggleRecording()}>
          <Icon name="record" />
          {isRecording ? 'Stop' : 'Record'}
        </Button>
        <Button
          label={isPlaying ? 'Pause' : 'Play'}
          isDisabled={!isFlyable || !canFly}
          click={() => {
            if (!isPlaying) app.path.store.set({ mode: 'planned' });
            app.path.playOrPause();
          }}
        >
          <Icon name={isPlaying ? 'pause' : 'play'} />
        </Button>
      </div>
      <FileButtons app={app} />
      {problem !== undefined && (
        <p class="problem" role="alert">
          {problem}
        </p>
      )}
      <Shape app={app} />
    </section>
  );
}

function FileButtons({ app }: { app: App }) {
  const { keyframes, canUndo } = useStore(app.path.store, (state) => state);
  const file = useRef<HTMLInputElement>(null);
  const isEmpty = keyframes.length === 0;
  return (
    <>
      <div class="row wrap">
        <Button title="Load a path: JSON, KML, KMZ, GPX, CZML or GeoJSON" click={() => file.current?.click()}>
          <Icon name="load" />
          Load
        </Button>
        <Button title="Save as a path that terravision fly reads" isDisabled={isEmpty} click={() => app.actions.savePath()}>
          <Icon name="save" />
          Save
        </Button>
        <Button title="Save as a tour of Google Earth" isDisabled={isEmpty} click={() => app.actions.saveKml()}>
          KML
        </Button>
        <Button label="Undo" isDisabled={!canUndo} click={() => app.path.undo()}>
          <Icon name="undo" />
        </Button>
        <Button label="Remove all keyframes" isDisabled={isEmpty} click={() => app.path.clear()}>
          <Icon name="remove" />
        </Button>
      </div>
      <input
        ref={file}
        class="hidden"
        type="file"
        accept=".json,.geojson,.czml,.kml,.kmz,.gpx,.gz,.zip"
        aria-label="Path file"
        tabIndex={-1}
        onChange={(event) => {
          const chosen = event.currentTarget.files?.[0];
          // The file is read before the field is emptied for the next one.
          if (chosen !== undefined) void app.actions.loadPath(chosen);
          event.currentTarget.value = '';
        }}
      />
    </>
  );
}

/** Duration, rests at the ends, and what the camera looks at. */
function Shape({ app }: { app: App }) {
  const { keyframes, target } = useStore(app.path.store, (state) => state);
  const world = useStore(app.viewer.store, (state) => state.world);
  if (keyframes.length < 2) return null;
  const isEased = [keyframes[0], keyframes[keyframes.length - 1]].every((key) => key!.rest);
  return (
    <>
      <div class="row short">
        <NumberField label="Duration" unit="s" digits={1} step={1} low={0.1} value={app.path.duration} change={(value) => value !== null && app.path.retime(value)} />
        <label class="check">
          <input type="checkbox" checked={isEased} onChange={() => app.path.easeEnds(!isEased)} />
          Ease in and out
        </label>
      </div>
      <div class="row wrap">
        <Button title="The camera looks all the time at what is in the middle of the picture now" click={() => void app.path.targetMiddle()}>
          <Icon name="target" />
          Look at the middle
        </Button>
        {target !== undefined && (
          <Button title="The camera looks where the keyframes do" click={() => app.path.setTarget(undefined)}>
            No target
          </Button>
        )}
      </div>
      {target !== undefined && <p class="hint">Looks at {place(target[0], target[1], world)}</p>}
    </>
  );
}

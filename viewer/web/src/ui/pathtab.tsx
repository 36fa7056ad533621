import { useRef } from 'preact/hooks';
import type { App } from '../app';
import { isPilot } from '../state/state';
import { useStore } from '../state/store';
import { Button, NumberField } from './controls';
import { metres } from './format';
import { Icon } from './icons';

/** Keyframes shown in the list: a recorded flight has hundreds. */
const MOST_ROWS = 200;

export function PathTab({ app }: { app: App }) {
  const { keyframes, isPlaying, isRecording, canUndo } = useStore(app.path.store, (state) => state);
  const canFly = useStore(app.viewer.store, isPilot);
  const file = useRef<HTMLInputElement>(null);
  const isFlyable = keyframes.length >= 2;
  return (
    <div class="columns">
      <section class="group" aria-label="Path">
        <h2>Path</h2>
        <div class="row wrap">
          <Button isPrimary title="The camera of now becomes a keyframe (K)" click={() => app.path.addKeyframe()}>
            <Icon name="plus" />
            Keyframe
          </Button>
          <Button title="Record what you fly" isDisabled={!canFly} class={isRecording ? 'recording' : ''} click={() => app.path.toggleRecording()}>
            <Icon name="record" />
            {isRecording ? 'Stop recording' : 'Record'}
          </Button>
          <Button
            isDisabled={!isFlyable || !canFly}
            click={() => {
              if (!isPlaying) app.path.store.set({ mode: 'planned' });
              app.path.playOrPause();
            }}
          >
            <Icon name={isPlaying ? 'pause' : 'play'} />
            {isPlaying ? 'Pause' : 'Play'}
          </Button>
        </div>
        <div class="row wrap">
          <Button title="Save as a path that terravision fly reads" isDisabled={keyframes.length === 0} click={() => app.actions.savePath()}>
            <Icon name="save" />
            Save
          </Button>
          <Button title="Load a path (JSON)" click={() => file.current?.click()}>
            <Icon name="load" />
            Load
          </Button>
          <Button label="Undo" isDisabled={!canUndo} click={() => app.path.undo()}>
            <Icon name="undo" />
          </Button>
          <Button label="Remove all keyframes" isDisabled={keyframes.length === 0} click={() => app.path.clear()}>
            <Icon name="remove" />
          </Button>
        </div>
        <input
          ref={file}
          class="hidden"
          type="file"
          accept=".json,application/json"
          aria-label="Path file"
          tabIndex={-1}
          onChange={(event) => {
            const chosen = event.currentTarget.files?.[0];
            event.currentTarget.value = '';
            if (chosen !== undefined) void app.actions.loadPath(chosen);
          }}
        />
        {isFlyable && (
          <div class="fields one">
            <NumberField label="Duration" unit="s" digits={1} step={1} low={0.1} value={app.path.duration} change={(value) => value !== null && app.path.retime(value)} />
          </div>
        )}
      </section>
      <section class="group wide" aria-label="Keyframes">
        <h2>{keyframes.length === 0 ? 'Keyframes' : `${keyframes.length} keyframes`}</h2>
        {keyframes.length === 0 ? (
          <p class="hint">Fly somewhere and press K, fly on and press K again: the camera then flies from one to the other. Or record a flight, or load one.</p>
        ) : (
          <KeyframeList app={app} />
        )}
      </section>
    </div>
  );
}

function KeyframeList({ app }: { app: App }) {
  const { keyframes } = useStore(app.path.store, (state) => state);
  const canFly = useStore(app.viewer.store, isPilot);
  return (
    <ol class="keyframes" tabIndex={0} aria-label="Keyframes">
      {keyframes.slice(0, MOST_ROWS).map((key, index) => (
        <li key={index}>
          <NumberField label={`Time of keyframe ${index + 1}`} unit="s" digits={2} step={0.5} value={key.t} change={(t) => t !== null && app.path.setTime(index, t)} />
          <span class="where">
            {metres(key.z)} · {key.heading.toFixed(0)}°
          </span>
          <Button
            label={`Fly to keyframe ${index + 1}`}
            isDisabled={!canFly}
            click={() => {
              app.path.store.set({ t: key.t });
              void app.motion.goTo(key);
            }}
          >
            <Icon name="target" />
          </Button>
          <Button label={`Keyframe ${index + 1} becomes the camera of now`} click={() => app.path.replace(index)}>
            <Icon name="record" />
          </Button>
          <Button label={`Remove keyframe ${index + 1}`} click={() => app.path.remove(index)}>
            <Icon name="remove" />
          </Button>
        </li>
      ))}
      {keyframes.length > MOST_ROWS && <li class="hint">… and {keyframes.length - MOST_ROWS} more</li>}
    </ol>
  );
}

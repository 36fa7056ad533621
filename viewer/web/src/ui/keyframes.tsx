import { useState } from 'preact/hooks';
import type { App } from '../app';
import { isPilot } from '../state/state';
import { useStore } from '../state/store';
import { Button, Choice, NumberField } from './controls';
import { metres } from './format';
import { Icon } from './icons';
import { SideView } from './sideview';

/** Keyframes shown in the list: a recorded flight has hundreds. */
const MOST_ROWS = 200;

/** The keyframes, as a list or from the side. */
export function Keyframes({ app }: { app: App }) {
  const count = useStore(app.path.store, (state) => state.keyframes.length);
  const [view, setView] = useState<'list' | 'side'>('list');
  return (
    <section class="group wide" aria-label="Keyframes">
      <div class="row spread">
        <h2>{count === 0 ? 'Keyframes' : `${count} keyframes`}</h2>
        {count > 0 && (
          <Choice
            label="How keyframes are shown"
            value={view}
            options={[
              ['list', 'List'],
              ['side', 'Side view'],
            ]}
            change={(value: 'list' | 'side') => setView(value)}
          />
        )}
      </div>
      {count === 0 && <p class="hint">Fly somewhere and press K, fly on and press K again: the camera then flies from one to the other. Or record a flight, or load one.</p>}
      {count > 0 && (view === 'list' ? <KeyframeList app={app} /> : <SideView app={app} />)}
    </section>
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
          <button
            type="button"
            class="button"
            aria-pressed={key.rest === true}
            aria-label={`Rest at keyframe ${index + 1}`}
            title="Rest here: ease in and out"
            onClick={() => app.path.move(index, { rest: key.rest !== true })}
          >
            <Icon name="rest" />
          </button>
          <Button
            label={`Fly to keyframe ${index + 1}`}
            isDisabled={!canFly}
            click={() => {
              app.path.store.set({ t: key.t });
              void app.motion.goTo(app.path.spline?.pose(key.t) ?? key);
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

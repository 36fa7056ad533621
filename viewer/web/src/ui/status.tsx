import type { App } from '../app';
import { samePose } from '../math/pose';
import { isPilot, type State } from '../state/state';
import { useStore } from '../state/store';
import { Button } from './controls';
import { metres, milliseconds, place, lonLat } from './format';

interface Condition {
  kind: 'good' | 'busy' | 'bad';
  text: string;
  detail?: string;
}

/** What the page is doing, in a few words that are true. */
function conditionOf(state: State): Condition {
  const { link, flight, flightReason, shown } = state;
  if (link.kind === 'refused') return { kind: 'bad', text: link.code === 'no-websocket' ? 'No connection' : 'Refused', detail: link.text };
  if (link.kind === 'connecting') return { kind: 'busy', text: 'Connecting …' };
  if (link.kind === 'lost') return { kind: 'bad', text: 'Link lost, trying again …', detail: 'The picture is the last one that came. The page goes on by itself when the server is back.' };
  if (flight === 'failed') return { kind: 'bad', text: 'The flight failed', detail: flightReason ?? '' };
  if (flight === 'starting') return { kind: 'busy', text: 'Starting the flight …' };
  if (flight === 'resting') return { kind: 'busy', text: 'Waking the flight …' };
  if (flight === 'restarting') return { kind: 'busy', text: 'Starting the flight again …', detail: flightReason ?? '' };
  if (shown === undefined) return { kind: 'busy', text: 'Waiting for the first picture …' };
  if (!state.isOverWorld) return { kind: 'busy', text: 'Beside the world', detail: 'There are no data under the camera. R flies back to the start.' };
  const isOfNow = state.pose === undefined || samePose(shown.pose, state.pose);
  return { kind: 'good', text: !isOfNow ? 'Live' : shown.isExact ? 'Exact' : shown.isAtRest ? 'At rest' : 'Live' };
}

export function Status({ app }: { app: App }) {
  const state = useStore(app.viewer.store, (value) => value);
  const condition = conditionOf(state);
  const { figures, latency } = state;
  // Rates and latency are those of a moving camera.
  const isLive = condition.text === 'Live';
  return (
    <div class={`status ${condition.kind}`}>
      <span class="lamp" aria-hidden="true" />
      <span role="status" title={condition.detail}>
        {condition.text}
      </span>
      {isLive && figures !== undefined && <span class="number">{figures.sent_fps.toFixed(0)} /s</span>}
      {isLive && latency !== undefined && (
        <span class="number" title="From an input to the picture that shows it, median">
          {milliseconds(latency.medianMs)}
        </span>
      )}
    </div>
  );
}

/** A sentence over the picture where the lamp alone would not do. */
export function Problem({ app }: { app: App }) {
  const condition = conditionOf(useStore(app.viewer.store, (value) => value));
  if (condition.kind === 'good' || !condition.detail) return null;
  return (
    <div class={`problem-bar ${condition.kind}`} data-floating>
      <strong>{condition.text}</strong> {condition.detail}
    </div>
  );
}

/** Who flies, when it is not this page; and how many are here. */
export function People({ app }: { app: App }) {
  const state = useStore(app.viewer.store, (value) => value);
  const { people, pilot, you, isReadOnly, link } = state;
  if (link.kind !== 'open' || you === undefined) return null;
  if (isReadOnly) return <span class="people">Watching: nobody may move the camera</span>;
  if (isPilot(state)) return people.length > 1 ? <span class="people">You fly · {people.length - 1} watching</span> : null;
  const name = people.find((person) => person.id === pilot)?.name;
  return (
    <span class="people">
      <span>{pilot === null ? 'Nobody flies' : `${name || 'Another one'} flies`}</span>
      <Button isPrimary click={() => app.viewer.takeOver()}>
        Take over
      </Button>
    </span>
  );
}

/** What is under the cursor. */
export function Cursor({ app }: { app: App }) {
  const cursor = useStore(app.viewer.store, (state) => state.cursor);
  const world = useStore(app.viewer.store, (state) => state.world);
  if (cursor === null) return null;
  const { point, distance } = cursor;
  const geographic = lonLat(point, world);
  return (
    <div class="cursor" data-floating>
      <span>{place(point[0], point[1], world)}</span>
      <strong>{point[2].toFixed(1)} m</strong>
      {geographic !== undefined && <span class="extra">{geographic}</span>}
      <span class="extra">{metres(distance)} away</span>
    </div>
  );
}

export function Notes({ app }: { app: App }) {
  const notes = useStore(app.viewer.store, (state) => state.notes);
  return (
    <div class="notes" role="log" aria-live="polite" data-floating>
      {notes.map((note) => (
        <div key={note.id} class={`note ${note.level}`}>
          <span>{note.text}</span>
          <button type="button" aria-label="Dismiss" onClick={() => app.viewer.dismiss(note.id)}>
            ×
          </button>
        </div>
      ))}
    </div>
  );
}

import { useState } from 'preact/hooks';
import type { App } from '../app';
import type { Film, FilmQuality } from '../link/protocol';
import { useStore } from '../state/store';
import { sentence } from './actions';
import { Button, Choice, NumberField } from './controls';
import { bytes } from './format';
import { Icon } from './icons';

const SIZES = { window: undefined, '720p': [1280, 720], '1080p': [1920, 1080] } as const;
type SizeName = keyof typeof SIZES;

/** Films of the path: made by the server in exact mode, and downloaded. */
export function FilmGroup({ app }: { app: App }) {
  const count = useStore(app.path.store, (state) => state.keyframes.length);
  const { films, shown, isReadOnly, link } = useStore(app.viewer.store, (state) => state);
  const [size, setSize] = useState<SizeName>('720p');
  const [fps, setFps] = useState(30);
  const [quality, setQuality] = useState<FilmQuality>('default');
  const [problem, setProblem] = useState<string | undefined>(undefined);
  const isDrawing = films?.films.some((film) => film.state === 'drawing') ?? false;
  const order = async () => {
    setProblem(undefined);
    const { width, height } = shown ?? { width: 1280, height: 720 };
    const [wide, high] = SIZES[size] ?? [width, height];
    const moment = new Date().toLocaleTimeString([], { hour: '2-digit', minute: '2-digit' });
    const name = `${app.viewer.store.get().world?.name ?? 'Film'} ${moment}`;
    try {
      await app.viewer.api.orderFilm({ name, size: [wide, high], fps, quality, path: app.actions.pathJson() });
    } catch (error) {
      setProblem(sentence(error));
    }
  };
  return (
    <section class="group" aria-label="Film">
      <h2>Film</h2>
      <Choice
        label="Size of the film"
        value={size}
        options={[
          ['window', 'Window'],
          ['720p', '720p'],
          ['1080p', '1080p'],
        ]}
        change={(value: SizeName) => setSize(value)}
      />
      <div class="row short">
        <Choice
          label="Quality of the film"
          value={quality}
          options={[
            ['default', 'Usual'],
            ['best', 'Best'],
          ]}
          change={(value: FilmQuality) => setQuality(value)}
        />
        <NumberField label="Rate" unit="/s" digits={0} step={5} low={1} high={120} value={fps} change={(value) => value !== null && setFps(value)} />
      </div>
      <Button isPrimary isDisabled={count === 0 || isDrawing || isReadOnly || link.kind !== 'open'} click={() => void order()}>
        <Icon name="film" />
        Render film
      </Button>
      {problem !== undefined && (
        <p class="problem" role="alert">
          {problem}
        </p>
      )}
      {films !== undefined && films.films.length > 0 && (
        <ul class="films" aria-label="Films">
          {films.films
            .map((film) => <FilmRow key={film.id} app={app} film={film} />)
            .reverse()}
        </ul>
      )}
    </section>
  );
}

function FilmRow({ app, film }: { app: App; film: Film }) {
  const remove = () => void app.viewer.api.removeFilm(film.id).catch((error: unknown) => app.viewer.note('warning', sentence(error)));
  const { drawn = 0, frames = 0 } = film;
  const share = frames > 0 ? drawn / frames : 0;
  return (
    <li>
      <span class="film-name" title={`${film.size[0]} × ${film.size[1]}, ${film.fps} /s`}>
        {film.name}
      </span>
      {film.state === 'drawing' && (
        <>
          <progress value={share} max={1} aria-label={`Progress of ${film.name}`} />
          <span class="film-fact">{frames > 0 ? `${drawn} of ${frames}` : 'begins …'}</span>
        </>
      )}
      {film.state === 'done' && (
        <a class="button" href={app.viewer.api.filmAddress(film.id)} download title="Download the film">
          <Icon name="save" />
          {bytes(film.bytes ?? 0)}
        </a>
      )}
      <Button label={film.state === 'drawing' ? `Cancel ${film.name}` : `Remove ${film.name}`} click={remove}>
        <Icon name={film.state === 'drawing' ? 'close' : 'remove'} />
      </Button>
      {film.state === 'failed' && <p class="problem">{film.text}</p>}
      {film.state === 'done' && film.text != null && <p class="hint">{film.text}</p>}
    </li>
  );
}

import type { App } from '../app';
import type { Settings, Stereo } from '../link/protocol';
import { isPilot } from '../state/state';
import { useStore } from '../state/store';
import { Choice, Figure, NumberField } from './controls';

/** How the picture is made. A change starts the flight anew, which takes about a second. */
export function PictureTab({ app }: { app: App }) {
  const settings = useStore(app.viewer.store, (state) => state.settings);
  const canChange = useStore(app.viewer.store, (state) => isPilot(state) && !state.isReadOnly);
  if (settings === undefined) return <p class="hint">The server has not said yet how it draws.</p>;
  const change = (part: Partial<Settings>) => app.viewer.changeSettings(part);
  const field = (label: string, key: 'facet_px' | 'texel_px' | 'fps' | 'exaggeration' | 'eye_separation' | 'convergence', unit: string, digits: number, step: number, low: number, high: number, placeholder = 'as started') => (
    <NumberField
      label={label}
      unit={unit}
      digits={digits}
      step={step}
      low={low}
      high={high}
      canBeEmpty
      placeholder={placeholder}
      isDisabled={!canChange}
      value={settings[key]}
      change={(value) => change({ [key]: value })}
    />
  );
  return (
    <div class="columns">
      <section class="group" aria-label="Detail">
        <h2>Detail while moving</h2>
        <div class="fields two">
          {field('r_z, facets', 'facet_px', 'px', 1, 1, 0.5, 100)}
          {field('r_c, texels', 'texel_px', 'px', 2, 0.25, 0.25, 32)}
          {field('Target rate', 'fps', '/s', 0, 5, 1, 60)}
          {field('Heights times', 'exaggeration', '×', 1, 0.5, 0, 100)}
        </div>
        <p class="hint">Smaller facets and texels are finer and cost more. At rest the picture becomes exact by itself.</p>
      </section>
      <section class="group" aria-label="Drawing">
        <h2>Drawing</h2>
        <Choice
          label="Technique"
          value={settings.technique ?? 'auto'}
          options={[
            ['auto', 'Automatic'],
            ['mesh', 'Mesh'],
            ['rays', 'Rays'],
          ]}
          isDisabled={!canChange}
          change={(technique) => change({ technique })}
        />
        <h3>Quad tree</h3>
        <Choice
          label="Overlay of the quad tree"
          value={settings.overlay ?? 'none'}
          options={[
            ['none', 'Hidden'],
            ['tree', 'Shown, by level'],
          ]}
          isDisabled={!canChange}
          change={(overlay) => change({ overlay })}
        />
      </section>
      <section class="group" aria-label="Stereo">
        <h2>Stereo</h2>
        <Choice
          label="Stereo"
          value={settings.stereo ?? 'off'}
          options={[
            ['off', 'Off'],
            ['side-by-side', 'Side by side'],
            ['anaglyph', 'Red-cyan'],
          ]}
          isDisabled={!canChange}
          change={(stereo: Stereo) => void app.actions.setStereo(stereo)}
        />
        {settings.stereo != null && settings.stereo !== 'off' && (
          <>
            <div class="fields two">
              {field('Eyes apart', 'eye_separation', 'm', 1, 1, 0, settings.convergence ?? 1e6, ((settings.convergence ?? 0) / 30).toFixed(1))}
              {field('Pictures meet at', 'convergence', 'm', 0, 50, 0.01, 1e6)}
            </div>
            <p class="hint">What is nearer than where the pictures meet stands out of the screen.</p>
          </>
        )}
      </section>
      <Now app={app} />
    </div>
  );
}

function Now({ app }: { app: App }) {
  const { shown, figures } = useStore(app.viewer.store, (state) => state);
  const metric = (name: string) => figures?.flight?.[`terravision_${name}`] ?? figures?.flight?.[name];
  const [facets, texels] = [metric('facet_pixels'), metric('texel_pixels')];
  return (
    <section class="group" aria-label="This picture">
      <h2>This picture</h2>
      <dl class="figures">
        <Figure name="Size">{shown === undefined ? '…' : `${shown.width} × ${shown.height}`}</Figure>
        <Figure name="Kind">{shown === undefined ? '…' : shown.isExact ? 'exact, PNG' : shown.kind === 'png' ? 'PNG' : shown.kind === 'h264' ? 'H.264' : `JPEG ${shown.quality}`}</Figure>
        {facets !== undefined && <Figure name="r_z now">{facets.toFixed(1)} px</Figure>}
        {texels !== undefined && <Figure name="r_c now">{texels.toFixed(2)} px</Figure>}
        <Figure name="Tiles">{shown === undefined ? '…' : shown.hasAllTiles ? 'all there' : 'some are coming'}</Figure>
      </dl>
    </section>
  );
}

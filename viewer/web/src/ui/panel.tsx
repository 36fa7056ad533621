import { useRef, useState } from 'preact/hooks';
import type { ComponentType } from 'preact';
import type { App } from '../app';
import { WorldMap } from '../map/map';
import { Button } from './controls';
import { FiguresTab } from './figurestab';
import { FlyTab } from './flytab';
import { Icon } from './icons';
import { LightTab } from './lighttab';
import { MeasureTab } from './measuretab';
import { PathTab } from './pathtab';
import { PictureTab } from './picturetab';

const TABS: readonly { id: string; name: string; Content: ComponentType<{ app: App }> }[] = [
  { id: 'fly', name: 'Fly', Content: FlyTab },
  { id: 'picture', name: 'Picture', Content: PictureTab },
  { id: 'light', name: 'Light', Content: LightTab },
  { id: 'measure', name: 'Measure', Content: MeasureTab },
  { id: 'path', name: 'Path', Content: PathTab },
  { id: 'figures', name: 'Figures', Content: FiguresTab },
];

/** The control panel below the picture, with the map at its right; on small screens the map comes above the fields. */
export function Panel({ app }: { app: App }) {
  const [open, setOpen] = useState('fly');
  const [isFolded, setFolded] = useState(false);
  const tabs = useRef<HTMLDivElement>(null);
  const chosen = TABS.find((tab) => tab.id === open) ?? TABS[0]!;

  const choose = (id: string) => {
    if (open === 'measure' && id !== 'measure') app.measuring.use('off');
    setFolded(false);
    setOpen(id);
  };
  const key = (event: KeyboardEvent) => {
    const way = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (way === undefined) return;
    event.preventDefault();
    const next = TABS[(TABS.indexOf(chosen) + way + TABS.length) % TABS.length]!;
    choose(next.id);
    tabs.current?.querySelector<HTMLElement>(`#tab-${next.id}`)?.focus();
  };
  return (
    <div class={`panel${isFolded ? ' folded' : ''}`} role="region" aria-label="Control panel">
      <div class="tabs">
        <div ref={tabs} role="tablist" aria-label="Parts of the control panel" onKeyDown={key}>
          {TABS.map(({ id, name }) => (
            <button
              type="button"
              role="tab"
              key={id}
              id={`tab-${id}`}
              aria-selected={id === chosen.id}
              aria-controls="tab-content"
              tabIndex={id === chosen.id ? 0 : -1}
              onClick={() => choose(id)}
            >
              {name}
            </button>
          ))}
        </div>
        <Button label={isFolded ? 'Show the panel' : 'Hide the panel'} class="round fold" click={() => setFolded(!isFolded)}>
          <Icon name={isFolded ? 'unfold' : 'fold'} />
        </Button>
      </div>
      <div class="panel-body">
        <div id="tab-content" class="tab-content" role="tabpanel" aria-labelledby={`tab-${chosen.id}`} tabIndex={0}>
          {!isFolded && <chosen.Content app={app} />}
        </div>
        <WorldMap app={app} />
      </div>
    </div>
  );
}

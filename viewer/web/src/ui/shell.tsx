import { useEffect, useRef, useState } from 'preact/hooks';
import type { App } from '../app';
import { useStore } from '../state/store';
import { Button } from './controls';
import { CopyByHand, Help, TokenForm } from './dialogs';
import { HandButtons } from './hands';
import { Icon } from './icons';
import { MeasureOverlay } from './overlay';
import { Panel } from './panel';
import { Cursor, Notes, People, Problem, Status } from './status';

interface ShellProps {
  app: App;
  /** Called once with the parts of the page that are moved from outside. */
  ready(view: HTMLElement, canvas: HTMLCanvasElement, help: () => void): void;
}

/** The page: the picture above, the control panel below. */
export function Shell({ app, ready }: ShellProps) {
  const view = useRef<HTMLElement>(null);
  const canvas = useRef<HTMLCanvasElement>(null);
  const [isHelpOpen, setHelpOpen] = useState(false);
  const tool = useStore(app.measuring.store, (state) => state.tool);
  const world = useStore(app.viewer.store, (state) => state.world);
  useEffect(() => ready(view.current!, canvas.current!, () => setHelpOpen(true)), []);
  useEffect(() => {
    document.title = world === undefined ? 'TerraVision' : `${world.name} · TerraVision`;
  }, [world]);
  return (
    <>
      <main ref={view} class={`view${tool === 'off' ? '' : ' measuring'}`} tabIndex={0} aria-label="The terrain. Arrow keys pan, W A S D fly, question mark lists all keys.">
        <canvas ref={canvas} class="picture" />
        <MeasureOverlay app={app} />
        <header class="top" data-floating>
          <h1>{world?.name ?? 'TerraVision'}</h1>
          <Status app={app} />
          <span class="space" />
          <People app={app} />
          <Button label="Hands and keys (?)" class="round" click={() => setHelpOpen(true)}>
            <Icon name="help" />
          </Button>
        </header>
        <Problem app={app} />
        <HandButtons app={app} />
        <Cursor app={app} />
        <Notes app={app} />
        <TokenForm app={app} />
      </main>
      <Panel app={app} />
      {isHelpOpen && <Help close={() => setHelpOpen(false)} />}
      <CopyByHand />
    </>
  );
}

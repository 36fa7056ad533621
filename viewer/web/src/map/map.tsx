import { useEffect, useRef, useState } from 'preact/hooks';
import type { App } from '../app';
import { Button } from '../ui/controls';
import { Icon } from '../ui/icons';
import { MapCanvas } from './canvas';

/** The world from above with the aircraft; a click goes there, or measures while a tool is chosen. */
export function WorldMap({ app }: { app: App }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const map = useRef<MapCanvas | undefined>(undefined);
  useEffect(() => {
    const made = new MapCanvas(canvas.current!, app);
    map.current = made;
    const noMore = app.viewer.showMap();
    return () => {
      made.end();
      noMore();
    };
  }, [app]);
  const [hasNodes, setHasNodes] = useState(true);
  useEffect(() => {
    map.current!.hasNodes = hasNodes;
    map.current!.redraw();
  }, [hasNodes]);
  return (
    <section class="map" aria-label="Map">
      <canvas
        ref={canvas}
        class="map-canvas"
        role="img"
        aria-label="Map of the world from above, with the aircraft, what it sees, and the tiles in memory by level. A click flies there; by keyboard the camera's fields do."
      />
      <div class="map-buttons">
        <Button label="Zoom the map in" click={() => map.current?.zoom(0.5)}>
          <Icon name="plus" />
        </Button>
        <Button label="Zoom the map out" click={() => map.current?.zoom(2)}>
          <Icon name="minus" />
        </Button>
        <button
          type="button"
          class="button"
          aria-label="Tiles in memory"
          title="Tiles in memory, by level; dashed: on their way"
          aria-pressed={hasNodes}
          onClick={() => setHasNodes(!hasNodes)}
        >
          <Icon name="grid" />
        </button>
      </div>
    </section>
  );
}

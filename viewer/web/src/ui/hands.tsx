import type { App } from '../app';
import { isPilot } from '../state/state';
import { useStore } from '../state/store';
import { Button } from './controls';
import { Icon } from './icons';

/** Buttons for what the mouse and the keys do, for those who have neither. */
export function HandButtons({ app }: { app: App }) {
  const canFly = useStore(app.viewer.store, isPilot);
  const heading = useStore(app.viewer.store, (state) => state.pose?.heading ?? 0);
  const { actions } = app;
  return (
    <div class="hands" role="group" aria-label="Move the camera" data-floating>
      <Button label="North up (N)" class="round compass" isDisabled={!canFly} click={() => void actions.northUp()}>
        <svg class="icon" viewBox="0 0 24 24" aria-hidden="true" style={{ transform: `rotate(${-heading.toFixed(1)}deg)` }}>
          <path class="north" d="M12 3l4 9H8z" />
          <path class="south" d="M12 21l-4-9h8z" />
        </svg>
      </Button>
      <div class="pair">
        <Button label="Turn left" class="round" isDisabled={!canFly} click={() => void actions.turn(-15, 0)}>
          <Icon name="left" />
        </Button>
        <Button label="Turn right" class="round" isDisabled={!canFly} click={() => void actions.turn(15, 0)}>
          <Icon name="right" />
        </Button>
      </div>
      <div class="pair">
        <Button label="Tilt up" class="round" isDisabled={!canFly} click={() => void actions.turn(0, 10)}>
          <Icon name="up" />
        </Button>
        <Button label="Tilt down" class="round" isDisabled={!canFly} click={() => void actions.turn(0, -10)}>
          <Icon name="down" />
        </Button>
      </div>
      <div class="pair">
        <Button label="Zoom in (+)" class="round" isDisabled={!canFly} click={() => void actions.zoom(0.6)}>
          <Icon name="plus" />
        </Button>
        <Button label="Zoom out (-)" class="round" isDisabled={!canFly} click={() => void actions.zoom(1 / 0.6)}>
          <Icon name="minus" />
        </Button>
      </div>
      <Button label="Back to the start (R)" class="round" isDisabled={!canFly} click={() => actions.reset()}>
        <Icon name="home" />
      </Button>
    </div>
  );
}

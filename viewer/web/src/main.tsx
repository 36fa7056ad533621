import { render } from 'preact';
import type { App } from './app';
import { Measuring } from './measure/measuring';
import { PathEditor } from './paths/editor';
import { answerMessages, programsOf } from './programs';
import { fromHash, toHash } from './state/address';
import { isPilot } from './state/state';
import { Viewer } from './state/viewer';
import { Actions } from './ui/actions';
import { Shell } from './ui/shell';
import { GamepadHands } from './view/gamepad';
import { Keyboard } from './view/keyboard';
import { Motion } from './view/motion';
import { Picture } from './view/picture';
import { Pointer } from './view/pointer';

const RELOADED = 'terravision-reloaded';

/** The server is of another version than this page: a new page is fetched; once, should that not help. */
function reload(): void {
  if (sessionStorage.getItem(RELOADED) !== null) return;
  sessionStorage.setItem(RELOADED, '1');
  window.location.reload();
}

function makeApp(): App {
  const viewer = new Viewer(window.location, reload);
  const motion = new Motion(viewer);
  const path = new PathEditor(viewer, motion);
  return { viewer, motion, path, measuring: new Measuring(viewer), actions: new Actions(viewer, motion, path) };
}

function connectHands(app: App, view: HTMLElement, canvas: HTMLCanvasElement, help: () => void): void {
  const { viewer, motion, path, actions } = app;
  const refused = () => {
    const { link, isReadOnly } = viewer.store.get();
    if (link.kind === 'open' && !isReadOnly) viewer.note('info', 'Another one flies: "Take over" makes you the pilot');
  };
  const pointer = new Pointer(view, viewer, motion, refused);
  app.measuring.store.subscribe(() => {
    const isOff = app.measuring.store.get().tool === 'off';
    pointer.clickTool = isOff ? undefined : (point) => app.measuring.click(point);
  });
  new Keyboard(viewer, motion, {
    northUp: () => void actions.northUp(),
    reset: () => actions.reset(),
    playOrPause: () => path.playOrPause(),
    addKeyframe: () => path.addKeyframe(),
    help,
    stop: () => actions.stop(),
  });
  new GamepadHands(viewer, motion);
  viewer.start(new Picture(canvas, view), fromHash(window.location.hash));
  new ResizeObserver(() => viewer.resized()).observe(view);
  keepAddress(app);
}

/** The address has the view once the camera rests, so that reloading the page or keeping the address keeps it. */
function keepAddress({ viewer, motion }: App): void {
  let timer: number | undefined;
  let written = window.location.hash;
  viewer.watchMoves(() => {
    window.clearTimeout(timer);
    timer = window.setTimeout(() => {
      if (viewer.pose === undefined || !isPilot(viewer.store.get())) return;
      written = toHash(viewer.pose);
      history.replaceState(null, '', written);
    }, 700);
  });
  window.addEventListener('hashchange', () => {
    const pose = fromHash(window.location.hash);
    if (pose !== undefined && window.location.hash !== written) void motion.goTo(pose);
  });
}

const app = makeApp();
window.terravision = programsOf(app.viewer, app.motion);
answerMessages(window.terravision);
app.viewer.watchPictures(() => sessionStorage.removeItem(RELOADED));
render(<Shell app={app} ready={(view, canvas, help) => connectHands(app, view, canvas, help)} />, document.getElementById('app')!);

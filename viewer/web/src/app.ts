import type { Measuring } from './measure/measuring';
import type { PathEditor } from './paths/editor';
import type { Viewer } from './state/viewer';
import type { Motion } from './view/motion';
import type { Actions } from './ui/actions';

/** All that the parts of the page work with. */
export interface App {
  readonly viewer: Viewer;
  readonly motion: Motion;
  readonly path: PathEditor;
  readonly measuring: Measuring;
  readonly actions: Actions;
}

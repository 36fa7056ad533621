import { useEffect, useRef, useState } from 'preact/hooks';
import type { ComponentChildren } from 'preact';
import type { App } from '../app';
import { useStore } from '../state/store';
import { Button } from './controls';
import { Icon } from './icons';

interface DialogProps {
  title: string;
  close(): void;
  children: ComponentChildren;
}

function Dialog({ title, close, children }: DialogProps) {
  const dialog = useRef<HTMLDialogElement>(null);
  useEffect(() => {
    dialog.current?.showModal();
  }, []);
  return (
    <dialog ref={dialog} aria-label={title} onClose={close} onClick={(event) => event.target === dialog.current && dialog.current?.close()}>
      <div class="dialog">
        <header>
          <h2>{title}</h2>
          <Button label="Close" class="round" click={() => dialog.current?.close()}>
            <Icon name="close" />
          </Button>
        </header>
        {children}
      </div>
    </dialog>
  );
}

const HANDS: readonly (readonly [string, string])[] = [
  ['Drag', 'hold the ground and pull it along'],
  ['Right drag, or Ctrl + drag', 'turn and tilt about the place under the cursor'],
  ['Wheel', 'zoom to the cursor'],
  ['Double click', 'fly there'],
  ['Arrows', 'pan; with Shift turn and tilt'],
  ['W A S D', 'fly ahead, left, back, right; with Shift faster'],
  ['Q E, or Page Down, Page Up', 'sink and climb'],
  ['+ −', 'zoom'],
  ['N', 'north up'],
  ['R', 'back to the start'],
  ['Space', 'play and pause'],
  ['K', 'add a keyframe'],
  ['Esc', 'stop'],
  ['One finger', 'pan'],
  ['Two fingers', 'pinch to zoom, twist to turn, up or down together to tilt'],
  ['Gamepad', 'left stick flies, right stick looks, triggers sink and climb'],
];

export function Help({ close }: { close(): void }) {
  return (
    <Dialog title="Hands and keys" close={close}>
      <dl class="keys">
        {HANDS.map(([hand, does]) => (
          <div key={hand}>
            <dt>{hand}</dt>
            <dd>{does}</dd>
          </div>
        ))}
      </dl>
    </Dialog>
  );
}

/** A text to copy by hand: without a secure context pages may not use the clipboard. */
export function CopyByHand() {
  const [text, setText] = useState<string | undefined>(undefined);
  useEffect(() => {
    const show = (event: Event) => setText((event as CustomEvent<string>).detail);
    window.addEventListener('terravision-copy', show);
    return () => window.removeEventListener('terravision-copy', show);
  }, []);
  if (text === undefined) return null;
  return (
    <Dialog title="Copy" close={() => setText(undefined)}>
      <p class="hint">The browser lets pages copy only over https or on this machine. Press Ctrl + C:</p>
      <textarea readOnly rows={5} value={text} aria-label="Text to copy" ref={(area) => area?.select()} />
    </Dialog>
  );
}

/** Asks for the token that the server wants. */
export function TokenForm({ app }: { app: App }) {
  const link = useStore(app.viewer.store, (state) => state.link);
  const [token, setToken] = useState('');
  if (link.kind !== 'refused' || link.code !== 'wrong-token') return null;
  return (
    <form
      class="token"
      data-floating
      onSubmit={(event) => {
        event.preventDefault();
        app.viewer.useToken(token.trim());
      }}
    >
      <h2>This server asks for a token</h2>
      <p class="hint">It is at the end of the address that terravision serve prints: ?token=…</p>
      <label class="field">
        <span class="field-label">Token</span>
        <span class="field-box">
          <input value={token} autocomplete="off" spellcheck={false} onInput={(event) => setToken(event.currentTarget.value)} />
        </span>
      </label>
      <button type="submit" class="button primary">
        Open
      </button>
    </form>
  );
}

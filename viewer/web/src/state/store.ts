import { useEffect, useState } from 'preact/hooks';

/** A value that tells when it changes. */
export class Store<T extends object> {
  private readonly listeners = new Set<() => void>();

  constructor(private value: T) {}

  get(): T {
    return this.value;
  }

  set(change: Partial<T>): void {
    const isSame = (Object.keys(change) as (keyof T)[]).every((key) => Object.is(this.value[key], change[key]));
    if (isSame) return;
    this.value = { ...this.value, ...change };
    for (const listener of [...this.listeners]) listener();
  }

  subscribe(listener: () => void): () => void {
    this.listeners.add(listener);
    return () => this.listeners.delete(listener);
  }
}

/** A part of a store, in a component that is drawn anew when that part changes. */
export function useStore<T extends object, P>(store: Store<T>, part: (value: T) => P): P {
  const [, redraw] = useState(0);
  const chosen = part(store.get());
  useEffect(() => {
    let last = part(store.get());
    // The part may have changed between drawing and this effect.
    if (!Object.is(last, chosen)) redraw((n) => n + 1);
    return store.subscribe(() => {
      const next = part(store.get());
      if (Object.is(next, last)) return;
      last = next;
      redraw((n) => n + 1);
    });
  }, [store]);
  return chosen;
}

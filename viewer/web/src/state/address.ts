import { isPose, type Pose } from '../math/pose';

const KEYS = ['x', 'y', 'z', 'heading', 'pitch', 'roll', 'vfov'] as const;

/** A view in a page's address: millimetres and ten-thousandths of a degree. */
export function toHash(pose: Pose): string {
  const digits = (key: keyof Pose) => (key === 'x' || key === 'y' || key === 'z' ? 3 : 4);
  return `#${KEYS.map((key) => `${key}=${Number(pose[key].toFixed(digits(key)))}`).join('&')}`;
}

/** The view that an address asks for. */
export function fromHash(hash: string): Pose | undefined {
  const values = new URLSearchParams(hash.replace(/^#/, ''));
  if (!values.has('x') || !values.has('y')) return undefined;
  const pose: Record<string, number> = { roll: 0, vfov: 60 };
  for (const key of KEYS) {
    const text = values.get(key);
    if (text !== null) pose[key] = text.trim() === '' ? NaN : Number(text);
  }
  return isPose(pose) ? pose : undefined;
}

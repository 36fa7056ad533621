import type { Pose } from '../math/pose';
import type { FilmQuality } from './protocol';

export interface FilmOrder {
  name: string;
  size: [number, number];
  fps: number;
  quality: FilmQuality;
  /** JSON of the path. */
  path: string;
}

/** What the server answers when it refuses. */
export class Refusal extends Error {
  constructor(
    readonly status: number,
    readonly code: string,
    text: string,
  ) {
    super(text);
  }
}

/** The token of this page's address; '' where none is needed. */
export const tokenOf = (search: string): string => new URLSearchParams(search).get('token') ?? '';

export class Api {
  constructor(private token: string) {}

  useToken(token: string): void {
    this.token = token;
  }

  /** Heights of the ground at places; null outside of the world. Long lists go in pieces. */
  async heights(places: readonly (readonly [number, number])[], most = 4096): Promise<(number | null)[]> {
    const heights: (number | null)[] = [];
    for (let from = 0; from < places.length; from += most) {
      const response = await this.fetch('/api/heights', {
        method: 'POST',
        headers: { 'content-type': 'application/json' },
        body: JSON.stringify(places.slice(from, from + most)),
      });
      heights.push(...((await response.json()) as (number | null)[]));
    }
    return heights;
  }

  /** The picture that `terravision still` draws at a pose: of both eyes where the flight shows two, or without sun and haze. */
  async still(pose: Pose, width: number, height: number, { hasStereo = false, isUnlit = false } = {}): Promise<Blob> {
    const query = new URLSearchParams();
    for (const key of ['x', 'y', 'z', 'heading', 'pitch', 'roll', 'vfov'] as const) query.set(key, String(pose[key]));
    query.set('width', String(width));
    query.set('height', String(height));
    if (hasStereo) query.set('stereo', '1');
    if (isUnlit) query.set('light', '0');
    return (await this.fetch(`/api/still.png?${query}`)).blob();
  }

  /** A path file of any kind as JSON keyframes in the world's coordinates. */
  async convertPath(name: string, file: Blob): Promise<string> {
    return (await this.fetch(`/api/path?${new URLSearchParams({ name })}`, { method: 'POST', body: file })).text();
  }

  /** Begins with a film of a path. */
  async orderFilm(order: FilmOrder): Promise<void> {
    // The path is JSON already.
    const { path, ...rest } = order;
    const body = `${JSON.stringify(rest).slice(0, -1)},"path":${path}}`;
    await this.fetch('/api/films', { method: 'POST', headers: { 'content-type': 'application/json' }, body });
  }

  /** Cancels a film that is being made, or removes it. */
  async removeFilm(id: number): Promise<void> {
    await this.fetch(`/api/films/${id}`, { method: 'DELETE' });
  }

  /** Where a film is. */
  filmAddress(id: number): string {
    return `/api/films/${id}.mp4${this.token === '' ? '' : `?${new URLSearchParams({ token: this.token })}`}`;
  }

  private async fetch(path: string, init: RequestInit = {}): Promise<Response> {
    const headers = new Headers(init.headers);
    if (this.token !== '') headers.set('authorization', `Bearer ${this.token}`);
    const response = await fetch(path, { ...init, headers });
    if (response.ok) return response;
    const body = (await response.json().catch(() => undefined)) as { error?: { code: string; text: string } } | undefined;
    throw new Refusal(response.status, body?.error?.code ?? 'failed', body?.error?.text ?? response.statusText);
  }
}

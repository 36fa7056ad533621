import type { BrowserContext, WebSocketRoute } from 'playwright-core';
import { createServer, type Server } from 'node:http';
import { readFile } from 'node:fs/promises';
import type { AddressInfo } from 'node:net';
import { join } from 'node:path';
import type { ClientMessage, ServerMessage, Welcome } from '../../src/link/protocol';
import type { Pose } from '../../src/math/pose';
import { WEB } from './browser';
import { writePng } from './png';

/** As the server is to send it (docs/viewer.md): the page has to work under it. */
const POLICY = "default-src 'self'; img-src 'self' blob: data:; object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'self'";
const TYPES: Record<string, string> = { html: 'text/html', js: 'text/javascript', css: 'text/css', svg: 'image/svg+xml' };

export const START: Pose = { x: 500_000, y: 5_193_000, z: 3200, heading: 10, pitch: -14, roll: 0, vfov: 60 };

const WELCOME: Welcome = {
  type: 'welcome',
  protocol: 1,
  version: '1.0.0',
  you: 1,
  is_read_only: false,
  world: {
    name: 'fake.tv',
    crs: 'WGS 84 / UTM zone 32N',
    epsg: 32632,
    bounds: [[489760, 5189760], [510240, 5210240]],
    heights: [445.1, 3212.2],
    body: 'Earth',
    post_spacing_m: 10,
    node_side: [80, 80],
    is_geographic: false,
    start: START,
  },
  limits: { size: [[16, 16], [3840, 2160]], message_bytes: 16384, messages_per_s: 240, clients: 64, heights: 4096 },
  settings: { facet_px: null, texel_px: null, fps: 30, technique: 'auto', exaggeration: 1, overlay: 'none', sun: null, shadows: null, haze: null, stereo: null, eye_separation: null, convergence: 4000 },
  flight: 'flying',
  reason: null,
  size: [960, 540],
  pilot: 1,
  people: [{ id: 1, name: null }],
};

/** A server that says what a test wants: for states that a real one is in for a moment only, or never. */
export class Fake {
  private server: Server | undefined;
  private socket: WebSocketRoute | undefined;
  private n = 0;
  readonly received: ClientMessage[] = [];
  welcome: Welcome = structuredClone(WELCOME);
  /** Refuses connections while true. */
  isGone = false;
  /** Called with every message that is not answered here. */
  answer: (message: ClientMessage) => ServerMessage | undefined = () => undefined;
  still: Buffer = writePng(64, 36, (x, y) => (y < 12 ? [120, 160, 205] : [60 + x, 90 + y, 60]));
  isExact = true;
  /** What was asked of films. */
  readonly films: string[] = [];

  async start(): Promise<string> {
    this.server = createServer((request, response) => void this.serve(request.url ?? '/', request.method ?? 'GET', response));
    await new Promise<void>((resolve) => this.server!.listen(0, '127.0.0.1', resolve));
    return `http://127.0.0.1:${(this.server.address() as AddressInfo).port}/`;
  }

  async stop(): Promise<void> {
    this.server!.closeAllConnections();
    await new Promise((resolve) => this.server!.close(resolve));
  }

  /** Takes the WebSockets of a browser's pages. */
  async attach(context: BrowserContext): Promise<void> {
    await context.routeWebSocket(/\/api\/socket/, (socket) => {
      if (this.isGone) {
        void socket.close();
        return;
      }
      this.socket = socket;
      socket.onMessage((text) => this.receive(JSON.parse(String(text)) as ClientMessage));
    });
  }

  send(message: ServerMessage): void {
    this.socket?.send(JSON.stringify(message));
  }

  /** Sends a state that differs from the welcome in some keys. */
  state(change: Partial<Welcome>): void {
    const { flight, reason, size, settings, pilot, people } = { ...this.welcome, ...change };
    this.send({ type: 'state', flight, reason, size, settings, pilot, people });
  }

  async cut(): Promise<void> {
    await this.socket?.close();
  }

  picture(pose: Pose, poseId: number): void {
    const file = this.still;
    const flags = this.isExact ? 15 : 2;
    this.message(pose, poseId, file, { kind: 1, flags, width: file.readUInt32BE(16), height: file.readUInt32BE(20) });
  }

  /** Sends a picture as H.264: the decoder's configuration behind its length, and the access unit. Its number. */
  video(pose: Pose, file: Buffer, { isKey, width, height }: { isKey: boolean; width: number; height: number }): number {
    this.message(pose, 0, file, { kind: 2, flags: isKey ? 18 : 2, width, height });
    return this.n;
  }

  private message(pose: Pose, poseId: number, file: Buffer, { kind, flags, width, height }: { kind: number; flags: number; width: number; height: number }): void {
    const header = Buffer.alloc(128);
    header.write('TVPF', 0, 'latin1');
    header.writeUInt16LE(1, 4);
    header.writeUInt16LE(128, 6);
    header.writeUInt32LE(++this.n, 8);
    header.writeUInt8(kind, 12);
    header.writeUInt8(flags, 13);
    header.writeUInt32LE(width, 24);
    header.writeUInt32LE(height, 28);
    header.writeUInt32LE(poseId, 32);
    [pose.x, pose.y, pose.z, pose.heading, pose.pitch, pose.roll, pose.vfov, 0, 8, 10].forEach((value, i) => header.writeDoubleLE(value, 40 + 8 * i));
    this.socket?.send(Buffer.concat([header, file]));
  }

  private receive(message: ClientMessage): void {
    this.received.push(message);
    if (message.type === 'hello') {
      const answer = this.answer(message);
      this.send(answer ?? this.welcome);
      if (answer === undefined) this.picture(this.welcome.world.start, 0);
      return;
    }
    if (message.type === 'pose') {
      const { type: _, id, ...pose } = message;
      this.picture(pose, id);
    }
    const answer = this.answer(message);
    if (answer !== undefined) this.send(answer);
    else if (message.type === 'pick') this.send({ type: 'picked', id: message.id, n: this.n, point: [500_400, 5_198_000, 1200], distance_m: 5400 });
  }

  private async serve(url: string, method: string, response: import('node:http').ServerResponse): Promise<void> {
    const path = new URL(url, 'http://localhost').pathname;
    response.setHeader('content-security-policy', POLICY);
    if (path === '/embedding.html') {
      response.setHeader('content-type', 'text/html');
      response.end('<!doctype html><title>embeds</title><iframe src="/" title="the page" width="800" height="600"></iframe>');
    } else if (path === '/api/still.png') {
      response.setHeader('content-type', 'image/png');
      response.end(this.still);
    } else if (path === '/api/heights' && method === 'POST') {
      let text = '';
      for await (const part of response.req) text += String(part);
      const places = JSON.parse(text) as [number, number][];
      const isInside = ([x, y]: [number, number]) => x > 489760 && x < 510240 && y > 5189760 && y < 5210240;
      response.setHeader('content-type', 'application/json');
      response.end(JSON.stringify(places.map((place) => (isInside(place) ? 1200 + 300 * Math.sin(place[0] / 900) : null))));
    } else if (path === '/api/path' && method === 'POST') {
      let text = '';
      for await (const part of response.req) text += String(part);
      const name = new URL(url, 'http://localhost').searchParams.get('name')!;
      const isBad = name.startsWith('bad');
      response.statusCode = isBad ? 400 : 200;
      response.setHeader('content-type', 'application/json');
      response.end(isBad ? JSON.stringify({ error: { code: 'bad-path', text: `${name} is not valid JSON: expected value at line 2 column 10` } }) : text);
    } else if (path.startsWith('/api/films')) {
      this.films.push(`${method} ${path}`);
      response.statusCode = method === 'POST' ? 507 : 204;
      response.end(method === 'POST' ? JSON.stringify({ error: { code: 'no-room', text: 'the films of this server take 4.0 GB: remove one first' } }) : undefined);
    } else {
      const file = path === '/' ? 'index.html' : path.slice(1);
      const bytes = await readFile(join(WEB, 'dist', file)).catch(() => undefined);
      response.setHeader('content-type', TYPES[file.split('.').pop()!] ?? 'application/octet-stream');
      response.statusCode = bytes === undefined ? 404 : 200;
      response.end(bytes);
    }
  }
}

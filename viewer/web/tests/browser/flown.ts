import assert from 'node:assert/strict';
import { readFile } from 'node:fs/promises';
import { join } from 'node:path';
import { after } from 'node:test';
import type { Browser, Page } from 'playwright-core';
import type {} from '../../src/programs';
import type { Pose } from '../../src/math/pose';
import { launch, open, OUT, until } from './browser';
import { readPng, type Pixels } from './png';
import { makeWorld, Serve, terravision } from './serve';

/** A picture that a page shows. */
export interface Shown {
  pose: Pose;
  kind: string;
  isExact: boolean;
  pixels: Pixels;
}

/** What a page has asked of points of the picture over its link of now, and what it was answered. */
interface Asked {
  sent: number;
  answered: number;
}

function countAsked(page: Page): Asked {
  const asked = { sent: 0, answered: 0 };
  page.on('websocket', (socket) => {
    asked.sent = asked.answered = 0;
    const is = (payload: string | Buffer, type: string) => typeof payload === 'string' && payload.includes(`"type":"${type}"`);
    socket.on('framesent', ({ payload }) => is(payload, 'pick') && asked.sent++);
    socket.on('framereceived', ({ payload }) => is(payload, 'picked') && asked.answered++);
  });
  return asked;
}

/** An angle between two headings, degrees from -180 to 180. */
export const turned = (from: number, to: number): number => ((to - from + 540) % 360) - 180;
/** How far the eyes of two poses are from each other. */
export const between = (a: Pose, b: Pose): number => Math.hypot(a.x - b.x, a.y - b.y, a.z - b.z);

/** A real server, a real flight, and a page of it. */
export class Flown {
  private constructor(
    readonly browser: Browser,
    readonly world: string,
    public serve: Serve,
    readonly page: Page,
    /** What went wrong so far: it fails the test at its end. */
    readonly complaints: string[],
    private readonly asked: Asked,
  ) {}

  /** Where the camera was at first. */
  start!: Pose;

  /** Starts it; its log is called `name`. */
  static async begin(name: string, ...flags: string[]): Promise<Flown> {
    const world = await makeWorld();
    const serve = await Serve.start(world, name, '--size', '640x360', ...flags);
    const browser = await launch();
    let asked: Asked | undefined;
    const options = { viewport: { width: 900, height: 640 }, acceptDownloads: true, hasTouch: true };
    const { page, complaints } = await open(browser, serve.address, options, (page) => {
      asked = countAsked(page);
      // A machine that is busy looks like a slow link: these tests are about JPEG.
      void page.addInitScript(() => Reflect.deleteProperty(window, 'VideoDecoder'));
    });
    const flown = new Flown(browser, world, serve, page, complaints, asked!);
    await until('the first picture', () => page.evaluate(() => window.terravision.frame() !== null), 60);
    flown.start = await flown.pose();
    return flown;
  }

  async end(): Promise<void> {
    await this.browser.close();
    await this.serve.stop();
  }

  /** Does what makes the page ask what is under a point, and waits until it has been told. */
  async told(act: () => Promise<unknown>): Promise<void> {
    const { sent } = this.asked;
    await act();
    await until('the server has said what is there', () => this.asked.sent > sent && this.asked.answered >= this.asked.sent);
  }

  async pose(): Promise<Pose> {
    return (await this.page.evaluate(() => window.terravision.pose()))!;
  }

  /** Waits until pictures of the camera of now are shown. */
  async caughtUp(on: Page = this.page): Promise<void> {
    await until('the picture is that of the camera', () =>
      on.evaluate(() => {
        const [shown, now] = [window.terravision.frame()?.pose, window.terravision.pose()];
        return shown !== undefined && now !== null && (['x', 'y', 'z', 'heading', 'pitch'] as const).every((key) => Math.abs(shown[key] - now[key]) < 1e-6);
      }),
    );
  }

  /** Waits until the page says that pictures come. */
  async connected(seconds: number): Promise<void> {
    await until('the page is connected', async () => /Live|At rest|Exact/.test(await this.page.locator('.status [role=status]').innerText()), seconds);
  }

  async jump(to: Partial<Pose>): Promise<void> {
    await this.page.evaluate((to) => window.terravision.goTo(to, { seconds: 0 }), to);
    await this.caughtUp();
  }

  async atStart(): Promise<void> {
    await this.jump(this.start);
  }

  /** What the page says is under a point of the picture: easting, northing, height. */
  async under(u: number, v: number): Promise<[number, number, number]> {
    const { page } = this;
    const cursor = page.locator('.cursor');
    // What it said of another point goes first.
    await page.mouse.move(u, 630);
    await cursor.waitFor({ state: 'detached' });
    await this.told(() => page.mouse.move(u, v));
    await cursor.waitFor();
    const [place, height] = (await page.locator('.cursor > *').allInnerTexts()).map((text) => text.replace(/\s/g, ''));
    const found = /^E(-?\d+)N(-?\d+)$/.exec(place!);
    assert.ok(found, `no place under the cursor: ${place}`);
    return [Number(found[1]), Number(found[2]), parseFloat(height!)];
  }

  /** The picture that is shown. */
  shown(on: Page = this.page): Promise<Shown> {
    return shownOn(on);
  }

  /** A picture that is shown while a key is held. */
  async shownWhile(key: { code: string; key: string }): Promise<Shown> {
    const frame = await this.page.evaluate(async (key) => {
      const begun = performance.now();
      const before = window.terravision.frame()!.n;
      window.dispatchEvent(new KeyboardEvent('keydown', key));
      for (;;) {
        await new Promise((resolve) => requestAnimationFrame(resolve));
        const { n, pose, kind, isExact, width, height, pixels } = window.terravision.frame()!;
        // Some pictures later: facets of the first ones are as fine as at rest.
        if (performance.now() - begun < 900 || n < before + 5 || kind !== 'jpeg') continue;
        window.dispatchEvent(new KeyboardEvent('keyup', key));
        let text = '';
        for (let i = 0; i < pixels.length; i += 0x8000) text += String.fromCharCode(...pixels.subarray(i, i + 0x8000));
        return { pose, kind, isExact, width, height, text: btoa(text) };
      }
    }, key);
    return pictureOf(frame);
  }

  /** The picture of `terravision still` at a pose. */
  async still(at: Pose, { width, height }: { width: number; height: number }, ...flags: string[]): Promise<Pixels> {
    const file = join(OUT, `still-${process.pid}.png`);
    await terravision(
      'still', this.world, `--eye=${at.x},${at.y},${at.z}`, `--heading=${at.heading}`, `--pitch=${at.pitch}`, `--roll=${at.roll}`, `--vfov=${at.vfov}`,
      '--size', `${width}x${height}`, ...flags, '-o', file,
    );
    return readPng(await readFile(file));
  }

  /** Heights of the ground, from the server. */
  heights(places: readonly (readonly [number, number])[]): Promise<number[]> {
    return this.page.evaluate(async (places) => (await (await fetch('/api/heights', { method: 'POST', body: JSON.stringify(places) })).json()) as number[], places);
  }

  /** The world's lower and upper corner. */
  bounds(): Promise<[[number, number], [number, number]]> {
    return this.page.evaluate(async () => ((await (await fetch('/api/info')).json()) as { world: { bounds: [[number, number], [number, number]] } }).world.bounds);
  }
}

/** A flight for all tests of a file; its log is called `name`. */
export async function flight(name: string): Promise<{ flown: Flown; page: Page; start: Pose }> {
  const flown = await Flown.begin(name);
  after(() => flown.end());
  return { flown, page: flown.page, start: flown.start };
}

/** The picture that a page shows. */
export async function shownOn(page: Page): Promise<Shown> {
  const frame = await page.evaluate(() => {
    const { pose, kind, isExact, width, height, pixels } = window.terravision.frame()!;
    let text = '';
    for (let i = 0; i < pixels.length; i += 0x8000) text += String.fromCharCode(...pixels.subarray(i, i + 0x8000));
    return { pose, kind, isExact, width, height, text: btoa(text) };
  });
  return pictureOf(frame);
}

function pictureOf(frame: { pose: Pose; kind: string; isExact: boolean; width: number; height: number; text: string }): Shown {
  const rgba = Buffer.from(frame.text, 'base64');
  const rgb = new Uint8Array(frame.width * frame.height * 3);
  for (let i = 0; i < frame.width * frame.height; i++) rgb.set(rgba.subarray(4 * i, 4 * i + 3), 3 * i);
  return { pose: frame.pose, kind: frame.kind, isExact: frame.isExact, pixels: { width: frame.width, height: frame.height, rgb } };
}


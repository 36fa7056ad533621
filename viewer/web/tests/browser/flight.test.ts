// The page with a real server and a real flight: hands, pictures, paths, measuring, people.
import assert from 'node:assert/strict';
import { readFile, writeFile } from 'node:fs/promises';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import type { Browser, Page } from 'playwright-core';
import type {} from '../../src/programs';
import type { Pose } from '../../src/math/pose';
import { launch, open, OUT, until, type WatchedPage } from './browser';
import { compare, readPng, type Pixels } from './png';
import { makeWorld, Serve, terravision } from './serve';

let browser: Browser;
let serve: Serve;
let world: string;
let watched: WatchedPage;
let page: Page;
let start: Pose;

before(async () => {
  world = await makeWorld();
  serve = await Serve.start(world, 'serve-flight', '--size', '640x360');
  browser = await launch();
  watched = await open(browser, serve.address, { viewport: { width: 900, height: 640 }, acceptDownloads: true, hasTouch: true });
  page = watched.page;
  await until('the first picture', () => page.evaluate(() => window.terravision.frame() !== null), 60);
  start = await pose();
});
after(async () => {
  await browser?.close();
  await serve?.stop();
});

const pose = async (): Promise<Pose> => (await page.evaluate(() => window.terravision.pose()))!;
/** Waits until pictures of the camera of now are shown. */
const caughtUp = (on: Page = page) =>
  until('the picture is that of the camera', () =>
    on.evaluate(() => {
      const [shown, now] = [window.terravision.frame()?.pose, window.terravision.pose()];
      return shown !== undefined && now !== null && (['x', 'y', 'z', 'heading', 'pitch'] as const).every((key) => Math.abs(shown[key] - now[key]) < 1e-6);
    }),
  );
const jump = async (to: Partial<Pose>) => {
  await page.evaluate((to) => window.terravision.goTo(to, { seconds: 0 }), to);
  await caughtUp();
};
const atStart = () => jump(start);
/** What the page says is under a point of the picture. */
const under = async (u: number, v: number): Promise<[number, number, number]> => {
  await page.mouse.move(u, v);
  await page.waitForTimeout(350);
  await page.mouse.move(u + 0.4, v);
  await page.waitForTimeout(350);
  await page.locator('.cursor').waitFor();
  const [place, height] = (await page.locator('.cursor > *').allInnerTexts()).map((text) => text.replace(/\s/g, ''));
  const found = /^E(-?\d+)N(-?\d+)$/.exec(place!);
  assert.ok(found, `no place under the cursor: ${place}`);
  return [Number(found[1]), Number(found[2]), parseFloat(height!)];
};
const shownPixels = async (on: Page = page): Promise<{ pose: Pose; kind: string; isExact: boolean; pixels: Pixels }> => {
  const frame = await on.evaluate(() => {
    const { pose, kind, isExact, width, height, pixels } = window.terravision.frame()!;
    let text = '';
    for (let i = 0; i < pixels.length; i += 0x8000) text += String.fromCharCode(...pixels.subarray(i, i + 0x8000));
    return { pose, kind, isExact, width, height, text: btoa(text) };
  });
  const rgba = Buffer.from(frame.text, 'base64');
  const rgb = new Uint8Array(frame.width * frame.height * 3);
  for (let i = 0; i < frame.width * frame.height; i++) rgb.set(rgba.subarray(4 * i, 4 * i + 3), 3 * i);
  return { ...frame, pixels: { width: frame.width, height: frame.height, rgb } };
};
const stillAt = async (at: Pose, width: number, height: number): Promise<Pixels> => {
  const file = join(OUT, 'still.png');
  await terravision(
    'still', world, `--eye=${at.x},${at.y},${at.z}`, `--heading=${at.heading}`, `--pitch=${at.pitch}`, `--roll=${at.roll}`, `--vfov=${at.vfov}`,
    '--size', `${width}x${height}`, '-o', file,
  );
  return readPng(await readFile(file));
};

test('loads: the world, a picture, no request to another host', async () => {
  assert.match(await page.title(), /TerraVision/);
  await until('it says what it does', async () => /Live|At rest|Exact/.test(await page.locator('.status [role=status]').innerText()));
  await page.getByRole('tab', { name: 'Figures' }).click();
  await until('figures have come', async () => /Drawn\s*[\d.]+ \/s/.test(await page.locator('.tab-content').innerText()));
  await page.getByRole('tab', { name: 'Fly' }).click();
});

test('at rest the picture is that of `terravision still`, byte for byte', async () => {
  await jump({ heading: start.heading + 30, pitch: -21, roll: 4 });
  await page.evaluate(() => window.terravision.settled());
  const shown = await shownPixels();
  assert.ok(shown.isExact);
  const still = await stillAt(shown.pose, shown.pixels.width, shown.pixels.height);
  assert.deepEqual(compare(shown.pixels, still), { largest: 0, mean: 0 });
});

test('while moving it is that of `terravision still` within what JPEG and larger facets change', async (t) => {
  await atStart();
  await page.evaluate(
    () =>
      new Promise<void>((resolve) => {
        window.addEventListener('keyup', () => resolve(), { once: true });
        window.dispatchEvent(new KeyboardEvent('keydown', { code: 'KeyD', key: 'd' }));
        setTimeout(() => window.dispatchEvent(new KeyboardEvent('keyup', { code: 'KeyD', key: 'd' })), 900);
      }),
  );
  const shown = await shownPixels();
  assert.equal(shown.kind, 'jpeg');
  const { width, height } = shown.pixels;
  const { mean } = compare(shown.pixels, await stillAt(shown.pose, width, height));
  // A picture of a moment before or after, turned by less than a degree, is another one by far.
  const turned = { ...shown.pose, heading: shown.pose.heading + 0.7 };
  const beside = compare(shown.pixels, await stillAt(turned, width, height)).mean;
  t.diagnostic(`mean difference ${mean.toFixed(2)} of 255, and ${beside.toFixed(2)} to a picture that is turned by 0.7 degrees`);
  // How coarse facets are while moving depends on how much of the processor the flight gets.
  assert.ok(mean < 14 && mean < 0.8 * beside, `mean difference ${mean}, ${beside} to a turned picture`);
});

test('keys move, turn, tilt and zoom', async () => {
  // Arrows are for the tabs while those have the focus.
  await page.locator('main').focus();
  const h = (start.heading * Math.PI) / 180;
  const ahead = (to: Pose) => (to.x - start.x) * Math.sin(h) + (to.y - start.y) * Math.cos(h);
  const right = (to: Pose) => (to.x - start.x) * Math.cos(h) - (to.y - start.y) * Math.sin(h);
  const turned = (to: Pose) => ((to.heading - start.heading + 540) % 360) - 180;
  /** Holds a key until it has done what it is for, on a machine however busy; afterwards the camera rests. */
  const hold = async (key: string, does: (to: Pose) => boolean, shift = false) => {
    await atStart();
    if (shift) await page.keyboard.down('Shift');
    await page.keyboard.down(key);
    await until(`${shift ? 'Shift and ' : ''}${key} has moved the camera`, async () => does(await pose()), 10);
    await page.keyboard.up(key);
    if (shift) await page.keyboard.up('Shift');
    await caughtUp();
    const rested = await pose();
    assert.ok(does(rested));
    await page.waitForTimeout(100);
    assert.ok(Math.abs((await pose()).x - rested.x) < 1e-6, `${key} goes on`);
  };
  await hold('ArrowUp', (to) => ahead(to) > 10);
  await hold('ArrowLeft', (to) => right(to) < -10);
  await hold('KeyS', (to) => ahead(to) < -10);
  await hold('KeyD', (to) => right(to) > 10);
  await hold('PageUp', (to) => to.z > start.z + 10);
  await hold('KeyQ', (to) => to.z < start.z - 10);
  await hold('ArrowRight', (to) => turned(to) > 3, true);
  await hold('ArrowDown', (to) => to.pitch < start.pitch - 3, true);
  await hold('+', (to) => Math.hypot(to.x - start.x, to.y - start.y, to.z - start.z) > 10 && to.z < start.z);
  await page.keyboard.press('n');
  await until('north is up', async () => Math.abs(((await pose()).heading + 180) % 360 - 180) < 1e-6);
  await page.keyboard.press('r');
  await until('it is back at the start', async () => Math.abs((await pose()).x - start.x) < 1e-6);
});

test('the ground is never entered', async () => {
  await atStart();
  await page.keyboard.down('Shift');
  await page.keyboard.down('KeyQ');
  await page.waitForTimeout(4000);
  await page.keyboard.up('KeyQ');
  await page.keyboard.up('Shift');
  await caughtUp();
  const { x, y, z } = await pose();
  const [ground] = await page.evaluate(async ([x, y]) => (await (await fetch('/api/heights', { method: 'POST', body: JSON.stringify([[x, y]]) })).json()) as number[], [x, y] as const);
  assert.ok(z > ground! + 1.9, `the eye is at ${z}, the ground at ${ground}`);
});

test('a drag holds the ground under the cursor', async () => {
  await atStart();
  const [u, v] = [450, 300];
  const taken = await under(u, v);
  await page.mouse.down();
  await page.waitForTimeout(1000);
  for (let i = 1; i <= 12; i++) await page.mouse.move(u + 8 * i, v - 4 * i, { steps: 2 });
  await page.mouse.up();
  await caughtUp();
  const held = await under(u + 96, v - 48);
  const far = Math.hypot(taken[0] - start.x, taken[1] - start.y);
  // A few pixels of a slope seen from the side.
  assert.ok(Math.hypot(held[0] - taken[0], held[1] - taken[1]) < far / 40, `${taken} was taken, ${held} is under the cursor`);
});

test('a right drag turns about the place under the cursor', async () => {
  await atStart();
  const [u, v] = [450, 300];
  const before = await under(u, v);
  const distance = (to: Pose) => Math.hypot(to.x - before[0], to.y - before[1], to.z - before[2]);
  await page.mouse.down({ button: 'right' });
  await page.waitForTimeout(1000);
  await page.mouse.move(u + 100, v + 20, { steps: 10 });
  await page.mouse.up({ button: 'right' });
  const turned = await pose();
  assert.ok(Math.abs(((turned.heading - start.heading + 540) % 360) - 180 - 30) < 1.5, `turned from ${start.heading} to ${turned.heading}`);
  assert.ok(turned.pitch < start.pitch - 3);
  assert.ok(Math.abs(distance(turned) / distance(start) - 1) < 0.02);
});

test('the wheel zooms to the cursor, a double click flies there', async () => {
  await atStart();
  const [u, v] = [600, 320];
  const before = await under(u, v);
  const distance = (to: Pose) => Math.hypot(to.x - before[0], to.y - before[1], to.z - before[2]);
  for (let i = 0; i < 4; i++) await page.mouse.wheel(0, -120);
  await until('it is nearer', async () => distance(await pose()) < distance(start) * 0.5);
  await page.waitForTimeout(500);
  await caughtUp();
  const zoomed = await under(u, v);
  assert.ok(Math.hypot(zoomed[0] - before[0], zoomed[1] - before[1]) < distance(start) / 40, `${before} was under the cursor, ${zoomed} is`);
  await atStart();
  await page.mouse.dblclick(u, v);
  await until('it has flown there', async () => distance(await pose()) < distance(start) * 0.45, 10);
});

test('fingers pan, zoom, turn and tilt', async () => {
  const touch = await page.context().newCDPSession(page);
  const send = (type: 'touchStart' | 'touchMove' | 'touchEnd', points: [number, number][]) =>
    touch.send('Input.dispatchTouchEvent', { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
  const gesture = async (from: [number, number][], to: [number, number][]) => {
    await atStart();
    await send('touchStart', from);
    // Until the server has said what the fingers hold.
    await page.waitForTimeout(1000);
    for (let i = 1; i <= 10; i++) {
      await send('touchMove', from.map(([x, y], k) => [x + ((to[k]![0] - x) * i) / 10, y + ((to[k]![1] - y) * i) / 10]));
      await page.waitForTimeout(20);
    }
    await send('touchEnd', []);
    await caughtUp();
    return pose();
  };
  const panned = await gesture([[450, 300]], [[450, 360]]);
  assert.ok(Math.hypot(panned.x - start.x, panned.y - start.y) > 5);
  assert.equal(panned.heading, start.heading);
  const pinched = await gesture([[400, 300], [500, 300]], [[350, 300], [550, 300]]);
  assert.ok(Math.hypot(pinched.x - start.x, pinched.y - start.y, pinched.z - start.z) > 20);
  const twisted = await gesture([[380, 300], [520, 300]], [[400, 240], [500, 360]]);
  assert.ok(Math.abs(((twisted.heading - start.heading + 540) % 360) - 180) > 15);
  const tilted = await gesture([[400, 260], [500, 260]], [[400, 340], [500, 340]]);
  assert.ok(tilted.pitch < start.pitch - 5);
  assert.ok(Math.abs(((tilted.heading - start.heading + 540) % 360) - 180) < 1);
});

test('a gamepad flies and looks', async () => {
  await atStart();
  await page.evaluate(() => {
    const pad = { connected: true, axes: [0, -1, 0.8, 0], buttons: Array.from({ length: 16 }, () => ({ value: 0, pressed: false })) };
    Object.assign(window, { pad });
    navigator.getGamepads = () => [pad as unknown as Gamepad];
    window.dispatchEvent(new Event('gamepadconnected'));
  });
  await page.waitForTimeout(500);
  await page.evaluate(() => (window as unknown as { pad: { axes: number[] } }).pad.axes.fill(0));
  await page.waitForTimeout(100);
  const flown = await pose();
  assert.ok(Math.hypot(flown.x - start.x, flown.y - start.y) > 5);
  assert.ok((flown.heading - start.heading + 360) % 360 > 3);
  await page.evaluate(() => ((window as unknown as { pad: { connected: boolean } }).pad.connected = false));
});

test('a path is recorded from keyframes, played, saved, and flown by `terravision`', async () => {
  await atStart();
  await page.keyboard.press('k');
  await jump({ x: start.x + 400, heading: start.heading + 20 });
  await page.keyboard.press('k');
  await page.getByRole('tab', { name: 'Path' }).click();
  await page.getByLabel('Duration').fill('3');
  await page.getByLabel('Duration').press('Enter');
  await page.getByRole('button', { name: 'Play', exact: true }).click();
  await until('it flies', async () => {
    const { x } = await pose();
    return x > start.x + 5 && x < start.x + 395;
  });
  await until('it has arrived', async () => Math.abs((await pose()).x - start.x - 400) < 1e-6);
  const [file] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name: 'Save', exact: true }).click()]);
  const [path, frames] = [join(OUT, 'path.json'), join(OUT, 'frames.json')];
  await file.saveAs(path);
  await terravision('path', world, '--path', path, '-o', frames);
  const poses = (JSON.parse(await readFile(frames, 'utf8')) as { frames: Pose[] }).frames;
  assert.equal(poses.length, 91);
  assert.ok(Math.abs(poses[90]!.x - start.x - 400) < 0.01);
  await page.getByRole('button', { name: 'Remove all keyframes' }).click();
  await page.getByRole('button', { name: 'Undo' }).click();
  await page.getByText('2 keyframes').waitFor();
  await page.getByRole('tab', { name: 'Fly' }).click();
});

test('an orbit circles what is in the middle, and Escape stops it', async () => {
  await atStart();
  await page.getByRole('button', { name: 'Orbit' }).click();
  await page.getByRole('button', { name: 'Play' }).click();
  await page.waitForTimeout(1200);
  await page.keyboard.press('Escape');
  const stopped = await pose();
  assert.ok(Math.abs(((stopped.heading - start.heading + 540) % 360) - 180) > 3);
  await page.waitForTimeout(300);
  const rested = await pose();
  for (const key of ['x', 'y', 'z', 'heading', 'pitch'] as const) assert.ok(Math.abs(rested[key] - stopped[key]) < 1e-6, key);
  await page.getByRole('button', { name: 'Free' }).click();
});

test('a line is measured, its profile drawn and saved; the map takes one there', async () => {
  await atStart();
  await page.getByRole('tab', { name: 'Measure' }).click();
  await page.getByRole('button', { name: 'Line' }).click();
  await page.mouse.click(380, 330);
  await page.waitForTimeout(700);
  await page.mouse.click(560, 320);
  await page.getByRole('slider', { name: 'Place along the line' }).waitFor();
  const [file] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name: 'CSV' }).click()]);
  const rows = (await readFile(await file.path(), 'utf8')).trim().split('\n').slice(1).map((row) => row.split(',').map(Number));
  assert.ok(rows.length > 300);
  const asked = await page.evaluate(
    async (places) => (await (await fetch('/api/heights', { method: 'POST', body: JSON.stringify(places) })).json()) as number[],
    rows.map((row) => [row[1]!, row[2]!]),
  );
  for (let i = 0; i < rows.length; i++) assert.ok(Math.abs(rows[i]![3]! - asked[i]!) < 0.3);
  const [geo] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name: 'GeoJSON' }).click()]);
  const feature = JSON.parse(await readFile(await geo.path(), 'utf8')).features[0];
  assert.equal(feature.geometry.coordinates.length, 2);
  assert.ok(feature.properties.length_over_ground_m >= feature.properties.length_m);
  await page.getByRole('tab', { name: 'Fly' }).click();
  const map = (await page.locator('.map-canvas').boundingBox())!;
  await page.mouse.click(map.x + map.width * 0.5, map.y + map.height * 0.5);
  const middle = await page.evaluate(async () => {
    const { world } = (await (await fetch('/api/info')).json()) as { world: { bounds: number[][] } };
    return [0, 1].map((i) => (world.bounds[0]![i]! + world.bounds[1]![i]!) / 2);
  });
  await page.waitForTimeout(3200);
  await caughtUp();
  const view = (await page.locator('.view').boundingBox())!;
  const seen = await under(Math.round(view.width / 2), Math.round(view.height / 2));
  assert.ok(Math.hypot(seen[0] - middle[0]!, seen[1] - middle[1]!) < 400, `${seen} is in the middle of the picture, ${middle} of the world`);
});

test('a link reproduces a view, and the copied command draws it', async () => {
  await page.context().grantPermissions(['clipboard-read', 'clipboard-write']);
  await jump({ ...start, heading: 123.25, pitch: -30, z: start.z + 111 });
  await page.getByRole('button', { name: 'Link' }).click();
  await until('it was copied', async () => (await page.evaluate(() => navigator.clipboard.readText())).includes('#x='));
  const link = await page.evaluate(() => navigator.clipboard.readText());
  await page.getByRole('button', { name: 'Command' }).click();
  await until('it was copied', async () => (await page.evaluate(() => navigator.clipboard.readText())).startsWith('terravision still'));
  const command = await page.evaluate(() => navigator.clipboard.readText());
  await page.evaluate(() => window.terravision.settled());
  const shown = await shownPixels();
  // The page knows the world's name only; here it lies in OUT.
  const words = command.replace(/^terravision /, '').replace(/ -o view.png$/, '').split(' ');
  words[1] = world;
  const file = join(OUT, 'view.png');
  await terravision(...words, '-o', file);
  assert.equal(compare(readPng(await readFile(file)), shown.pixels).largest, 0);
  await page.goto('about:blank');
  await page.goto(link);
  await until('the view is that of the link', async () => {
    const now = await page.evaluate(() => window.terravision?.pose() ?? null);
    return now !== null && Math.abs(now.heading - 123.25) < 1e-3 && Math.abs(now.z - start.z - 111) < 1e-2;
  });
  await caughtUp();
});

test('two browsers: one flies, the other watches, then takes over', async () => {
  const other = await open(browser, serve.address, { viewport: { width: 700, height: 560 } });
  await other.page.getByRole('button', { name: 'Take over' }).waitFor({ timeout: 30_000 });
  await jump({ ...start, heading: 200 });
  await until('the other one follows', async () => Math.abs(((await other.page.evaluate(() => window.terravision.pose()))?.heading ?? 0) - 200) < 1e-6);
  await other.page.getByRole('button', { name: 'Take over' }).click();
  await until('this one watches', async () => /flies/.test(await page.locator('.people').innerText()));
  await other.page.evaluate(() => window.terravision.goTo({ heading: 300 }, { seconds: 0 }));
  await until('this one follows', async () => Math.abs((await pose()).heading - 300) < 1e-6);
  await page.getByRole('button', { name: 'Take over' }).click();
  await until('this one flies', async () => /You fly/.test(await page.locator('.people').innerText()));
  await caughtUp();
  await other.page.context().close();
  assert.deepEqual(other.complaints, []);
});

test('renderer and viewer are killed: the page says so and goes on by itself', async () => {
  await page.evaluate(() => {
    const said: string[] = [];
    Object.assign(window, { said });
    const status = document.querySelector('.status')!;
    new MutationObserver(() => said.push(status.textContent!)).observe(status, { childList: true, subtree: true, characterData: true });
  });
  for (const program of ['terravision-renderer', 'terravision-viewer']) {
    // A flight of another size may just have been started.
    await until(`${program} runs`, async () => (await serve.pids(program)).length === 1);
    await caughtUp();
    const [pid] = await serve.pids(program);
    assert.ok(pid);
    const n = await page.evaluate(() => window.terravision.frame()!.n);
    process.kill(pid, 'SIGKILL');
    await until(`${program} runs again`, async () => (await serve.pids(program)).some((other) => other !== pid), 30);
    await until('the page is connected', async () => /Live|At rest|Exact/.test(await page.locator('.status [role=status]').innerText()), 40);
    const heading = (await pose()).heading + 11;
    await jump({ heading });
    assert.ok(program === 'terravision-viewer' || (await page.evaluate(() => window.terravision.frame()!.n)) > n);
  }
  const said = await page.evaluate(() => (window as unknown as { said: string[] }).said);
  assert.ok(said.some((text) => /Link lost/.test(text)), `it said ${[...new Set(said)].join(' · ')}`);
});

test('the whole server is killed, and comes back on its port', async () => {
  const { host } = new URL(serve.address);
  await serve.kill();
  await until('it says so', async () => /Link lost/.test(await page.locator('.status [role=status]').innerText()));
  const before = await pose();
  serve = await Serve.start(world, 'serve-again', '--addr', host);
  await until('the page is connected', async () => /Live|At rest|Exact/.test(await page.locator('.status [role=status]').innerText()), 60);
  await caughtUp();
  assert.ok(Math.abs((await pose()).heading - before.heading) < 1e-6);
});

test('latency is measured', async (t) => {
  await atStart();
  await page.keyboard.down('KeyD');
  await page.waitForTimeout(3000);
  await page.keyboard.up('KeyD');
  const latency = (await page.evaluate(() => window.terravision.latency()))!;
  t.diagnostic(`input to changed picture: ${JSON.stringify(latency)}`);
  assert.ok(latency.samples > 5);
  await writeFile(join(OUT, 'latency.json'), JSON.stringify(latency));
});

test('the page complained of nothing, and asked no other host', () => {
  assert.deepEqual(watched.complaints, []);
});

// Hands on the camera, the map, and measuring, with a real server and a real flight.
import assert from 'node:assert/strict';
import { readFile } from 'node:fs/promises';
import { test } from 'node:test';
import type { Pose } from '../../src/math/pose';
import { until } from './browser';
import { between, flight, turned } from './flown';

const { flown, page, start } = await flight('serve-hands');

/** Waits until the camera rests, and its picture is shown. */
const still = () =>
  until('the camera rests', async () => {
    const before = await flown.pose();
    await page.waitForTimeout(300);
    const now = await flown.pose();
    await flown.caughtUp();
    return between(before, now) < 1e-6 && before.heading === now.heading;
  });

test('keys move, turn, tilt and zoom', async () => {
  // Arrows are for the tabs while those have the focus.
  await page.locator('main').focus();
  const h = (start.heading * Math.PI) / 180;
  const ahead = (to: Pose) => (to.x - start.x) * Math.sin(h) + (to.y - start.y) * Math.cos(h);
  const right = (to: Pose) => (to.x - start.x) * Math.cos(h) - (to.y - start.y) * Math.sin(h);
  /** Holds a key until it has done what it is for, on a machine however busy; afterwards the camera rests. */
  const hold = async (key: string, does: (to: Pose) => boolean, shift = false) => {
    await flown.atStart();
    if (shift) await page.keyboard.down('Shift');
    await page.keyboard.down(key);
    await until(`${shift ? 'Shift and ' : ''}${key} has moved the camera`, async () => does(await flown.pose()), 10);
    await page.keyboard.up(key);
    if (shift) await page.keyboard.up('Shift');
    await still();
    assert.ok(does(await flown.pose()), `${key} has gone back`);
  };
  await hold('ArrowUp', (to) => ahead(to) > 10);
  await hold('ArrowLeft', (to) => right(to) < -10);
  await hold('KeyS', (to) => ahead(to) < -10);
  await hold('KeyD', (to) => right(to) > 10);
  await hold('PageUp', (to) => to.z > start.z + 10);
  await hold('KeyQ', (to) => to.z < start.z - 10);
  await hold('ArrowRight', (to) => turned(start.heading, to.heading) > 3, true);
  await hold('ArrowDown', (to) => to.pitch < start.pitch - 3, true);
  await hold('+', (to) => between(to, start) > 10 && to.z < start.z);
  await page.keyboard.press('n');
  await until('north is up', async () => Math.abs(((await flown.pose()).heading + 180) % 360 - 180) < 1e-6);
  await page.keyboard.press('r');
  await until('it is back at the start', async () => Math.abs((await flown.pose()).x - start.x) < 1e-6);
});

test('the ground is never entered', async () => {
  await flown.atStart();
  await page.keyboard.down('Shift');
  await page.keyboard.down('KeyQ');
  let z = start.z;
  await until('it sinks no further', async () => {
    await page.waitForTimeout(300);
    const before = z;
    ({ z } = await flown.pose());
    return z < start.z && z === before;
  });
  await page.keyboard.up('KeyQ');
  await page.keyboard.up('Shift');
  await flown.caughtUp();
  const { x, y } = await flown.pose();
  const [ground] = await flown.heights([[x, y]]);
  assert.ok(z > ground! + 1.9, `the eye is at ${z}, the ground at ${ground}`);
});

test('a drag holds the ground under the cursor', async () => {
  await flown.atStart();
  const [u, v] = [450, 300];
  const taken = await flown.under(u, v);
  await flown.told(() => page.mouse.down());
  for (let i = 1; i <= 12; i++) await page.mouse.move(u + 8 * i, v - 4 * i, { steps: 2 });
  await page.mouse.up();
  await flown.caughtUp();
  await until('the camera has moved', async () => between(await flown.pose(), start) > 10);
  await flown.caughtUp();
  const held = await flown.under(u + 96, v - 48);
  const far = Math.hypot(taken[0] - start.x, taken[1] - start.y);
  // A few pixels of a slope seen from the side.
  assert.ok(Math.hypot(held[0] - taken[0], held[1] - taken[1]) < far / 40, `${taken} was taken, ${held} is under the cursor`);
});

test('a right drag turns about the place under the cursor', async () => {
  await flown.atStart();
  const [u, v] = [450, 300];
  const before = await flown.under(u, v);
  const distance = (to: Pose) => Math.hypot(to.x - before[0], to.y - before[1], to.z - before[2]);
  await flown.told(() => page.mouse.down({ button: 'right' }));
  await page.mouse.move(u + 100, v + 20, { steps: 10 });
  await page.mouse.up({ button: 'right' });
  await until('it has turned by the way of the hand', async () => Math.abs(turned(start.heading, (await flown.pose()).heading) - 30) < 1.5);
  const seen = await flown.pose();
  assert.ok(seen.pitch < start.pitch - 3);
  assert.ok(Math.abs(distance(seen) / distance(start) - 1) < 0.02);
});

test('the wheel zooms to the cursor, a double click flies there', async () => {
  await flown.atStart();
  const [u, v] = [600, 320];
  const before = await flown.under(u, v);
  const distance = (to: Pose) => Math.hypot(to.x - before[0], to.y - before[1], to.z - before[2]);
  for (let i = 0; i < 4; i++) await page.mouse.wheel(0, -120);
  await until('it is nearer', async () => distance(await flown.pose()) < distance(start) * 0.5);
  await still();
  const zoomed = await flown.under(u, v);
  assert.ok(Math.hypot(zoomed[0] - before[0], zoomed[1] - before[1]) < distance(start) / 40, `${before} was under the cursor, ${zoomed} is`);
  await flown.atStart();
  await page.mouse.dblclick(u, v);
  await until('it has flown there', async () => distance(await flown.pose()) < distance(start) * 0.45, 10);
});

test('fingers pan, zoom, turn and tilt', async () => {
  const touch = await page.context().newCDPSession(page);
  const send = (type: 'touchStart' | 'touchMove' | 'touchEnd', points: [number, number][]) =>
    touch.send('Input.dispatchTouchEvent', { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
  const gesture = async (from: [number, number][], to: [number, number][]) => {
    await flown.atStart();
    await flown.told(() => send('touchStart', from));
    for (let i = 1; i <= 10; i++) {
      await send('touchMove', from.map(([x, y], k) => [x + ((to[k]![0] - x) * i) / 10, y + ((to[k]![1] - y) * i) / 10]));
      await page.waitForTimeout(20);
    }
    await send('touchEnd', []);
    await still();
    return flown.pose();
  };
  const panned = await gesture([[450, 300]], [[450, 360]]);
  assert.ok(between(panned, start) > 5);
  assert.equal(panned.heading, start.heading);
  const pinched = await gesture([[400, 300], [500, 300]], [[350, 300], [550, 300]]);
  assert.ok(between(pinched, start) > 20);
  const twisted = await gesture([[380, 300], [520, 300]], [[400, 240], [500, 360]]);
  assert.ok(Math.abs(turned(start.heading, twisted.heading)) > 15);
  const tilted = await gesture([[400, 260], [500, 260]], [[400, 340], [500, 340]]);
  assert.ok(tilted.pitch < start.pitch - 5);
  assert.ok(Math.abs(turned(start.heading, tilted.heading)) < 1);
});

test('a gamepad flies and looks', async () => {
  await flown.atStart();
  await page.evaluate(() => {
    const pad = { connected: true, axes: [0, -1, 0.8, 0], buttons: Array.from({ length: 16 }, () => ({ value: 0, pressed: false })) };
    Object.assign(window, { pad });
    navigator.getGamepads = () => [pad as unknown as Gamepad];
    window.dispatchEvent(new Event('gamepadconnected'));
  });
  await until('it has flown and turned', async () => {
    const flying = await flown.pose();
    return between(flying, start) > 5 && turned(start.heading, flying.heading) > 3;
  });
  await page.evaluate(() => (window as unknown as { pad: { axes: number[] } }).pad.axes.fill(0));
  await still();
  await page.evaluate(() => ((window as unknown as { pad: { connected: boolean } }).pad.connected = false));
});

test('a note lets clicks through to the ground, and is dismissed by its button', async () => {
  await page.evaluate(() => window.dispatchEvent(new Event('gamepadconnected')));
  const note = page.locator('.note', { hasText: 'Gamepad' }).last();
  const { x, y, width, height } = (await note.boundingBox())!;
  const hits = (u: number, v: number) => page.evaluate(([u, v]) => document.elementFromPoint(u!, v!)?.closest('main, .note')?.className ?? '', [u, v]);
  assert.match(await hits(x + width / 2, y + height / 2), /^view/);
  const before = await page.locator('.note').count();
  await note.getByRole('button', { name: 'Dismiss' }).click();
  await until('it is gone', async () => (await page.locator('.note').count()) < before);
});

test('an orbit circles what is in the middle, and Escape stops it', async () => {
  await flown.atStart();
  await page.getByRole('button', { name: 'Orbit' }).click();
  await page.getByRole('button', { name: 'Play' }).click();
  await until('it circles', async () => Math.abs(turned(start.heading, (await flown.pose()).heading)) > 3);
  await page.keyboard.press('Escape');
  await still();
  await page.getByRole('button', { name: 'Free' }).click();
});

test('a line is measured, its profile drawn and saved; the map takes one there', async () => {
  await flown.atStart();
  await page.getByRole('tab', { name: 'Measure' }).click();
  await page.getByRole('button', { name: 'Line' }).click();
  await page.mouse.click(380, 330);
  await page.locator('.overlay circle').first().waitFor({ state: 'attached' });
  await page.mouse.click(560, 320);
  await page.getByRole('slider', { name: 'Place along the line' }).waitFor();
  const [file] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name: 'CSV' }).click()]);
  const rows = (await readFile(await file.path(), 'utf8')).trim().split('\n').slice(1).map((row) => row.split(',').map(Number));
  assert.ok(rows.length > 300);
  const asked = await flown.heights(rows.map((row) => [row[1]!, row[2]!] as const));
  for (let i = 0; i < rows.length; i++) assert.ok(Math.abs(rows[i]![3]! - asked[i]!) < 0.3);
  const [geo] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name: 'GeoJSON' }).click()]);
  const feature = JSON.parse(await readFile(await geo.path(), 'utf8')).features[0];
  assert.equal(feature.geometry.coordinates.length, 2);
  assert.ok(feature.properties.length_over_ground_m >= feature.properties.length_m);
  await page.getByRole('tab', { name: 'Fly' }).click();
  const map = (await page.locator('.map-canvas').boundingBox())!;
  await page.mouse.click(map.x + map.width * 0.5, map.y + map.height * 0.5);
  const [low, high] = await flown.bounds();
  const view = (await page.locator('.view').boundingBox())!;
  await until('the middle of the world is in the middle of the picture', async () => {
    await still();
    const seen = await flown.under(Math.round(view.width / 2), Math.round(view.height / 2));
    return Math.hypot(seen[0] - (low[0] + high[0]) / 2, seen[1] - (low[1] + high[1]) / 2) < 400;
  });
});

test('the page complained of nothing, and asked no other host', () => {
  assert.deepEqual(flown.complaints, []);
});

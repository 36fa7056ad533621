// Paths and films, with a real server: recorded, edited, played, saved, loaded, rendered.
import assert from 'node:assert/strict';
import { readFile } from 'node:fs/promises';
import { join } from 'node:path';
import { test } from 'node:test';
import type { Pose } from '../../src/math/pose';
import { Spline } from '../../src/math/spline';
import { turn } from '../../src/math/vector';
import { fromServer } from '../../src/paths/file';
import { OUT, until } from './browser';
import { between, flight } from './flown';
import { terravision } from './serve';

const { flown, page, start } = await flight('serve-paths');

test('a path is recorded from keyframes, played, saved, and flown by `terravision`', async () => {
  await flown.atStart();
  await page.keyboard.press('k');
  await flown.jump({ x: start.x + 400, heading: start.heading + 20 });
  await page.keyboard.press('k');
  await page.getByRole('tab', { name: 'Path' }).click();
  await page.getByLabel('Duration').fill('3');
  await page.getByLabel('Duration').press('Enter');
  await page.getByRole('button', { name: 'Play', exact: true }).click();
  await until('it flies', async () => {
    const { x } = await flown.pose();
    return x > start.x + 5 && x < start.x + 395;
  });
  await until('it has arrived', async () => Math.abs((await flown.pose()).x - start.x - 400) < 1e-6);
  const [file] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name: 'Save', exact: true }).click()]);
  const [path, frames] = [join(OUT, 'path.json'), join(OUT, 'frames.json')];
  await file.saveAs(path);
  await terravision('path', flown.world, '--path', path, '-o', frames);
  const poses = (JSON.parse(await readFile(frames, 'utf8')) as { frames: Pose[] }).frames;
  assert.equal(poses.length, 91);
  assert.ok(Math.abs(poses[90]!.x - start.x - 400) < 0.01);
  // What the page plays is what is flown.
  const { keyframes } = fromServer(await readFile(path, 'utf8'), 60);
  const spline = new Spline(keyframes);
  poses.forEach((flown, i) => {
    const played = spline.pose(i / 30);
    for (const key of ['x', 'y', 'z'] as const) assert.ok(Math.abs(played[key] - flown[key]) < 1e-6, `frame ${i}: ${key} ${played[key]} and ${flown[key]}`);
    assert.ok(Math.abs(turn(played.heading, flown.heading)) + Math.abs(played.pitch - flown.pitch) < 1e-9, `frame ${i}`);
  });
  await page.getByRole('button', { name: 'Remove all keyframes' }).click();
  await page.getByRole('button', { name: 'Undo' }).click();
  await page.getByText('2 keyframes').waitFor();
});

test('keyframes are pulled in the side view and on the map, rest, and look at a target; all is undone', async () => {
  await page.getByRole('button', { name: 'Side view' }).click();
  const handle = page.getByRole('slider', { name: 'Height of keyframe 2' });
  // The ground comes later, and changes the scale.
  await page.locator('.profile.side .ground').waitFor({ state: 'attached' });
  await handle.scrollIntoViewIfNeeded();
  const before = await handle.boundingBox();
  const height = async () => Number(await handle.getAttribute('aria-valuenow'));
  const z = await height();
  await page.mouse.move(before!.x + before!.width / 2, before!.y + before!.height / 2);
  await page.mouse.down();
  await page.mouse.move(before!.x + before!.width / 2, before!.y - 12, { steps: 4 });
  await page.mouse.up();
  await until('it is higher by the way of the hand', async () => (await height()) > z + 10);
  await handle.press('ArrowDown');
  await page.getByRole('button', { name: 'Undo' }).click();
  await page.getByRole('button', { name: 'Undo' }).click();
  await until('both are undone', async () => (await height()) === z);
  await page.getByLabel('Ease in and out').check();
  await page.getByRole('button', { name: 'Look at the middle' }).click();
  await page.getByText(/Looks at E/).waitFor();
  // On the map, by its middle: the second keyframe is where the aircraft is.
  await flown.jump({ x: start.x + 400 });
  const map = (await page.locator('.map-canvas').boundingBox())!;
  const saved = async () => {
    const [file] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name: 'Save', exact: true }).click()]);
    await file.saveAs(join(OUT, 'edited.json'));
    return JSON.parse(await readFile(join(OUT, 'edited.json'), 'utf8')) as { target: number[]; keyframes: (Pose & { rest?: boolean })[] };
  };
  const first = await saved();
  assert.deepEqual([first.keyframes[0]!.rest, first.keyframes[1]!.rest, first.target.length], [true, true, 3]);
  const bounds = await flown.bounds();
  const side = 1.04 * Math.max(((bounds[1][0] - bounds[0][0]) * Math.min(map.width, map.height)) / map.width, ((bounds[1][1] - bounds[0][1]) * Math.min(map.width, map.height)) / map.height);
  const scale = Math.min(map.width, map.height) / side;
  const at = (x: number, y: number) => [map.x + map.width / 2 + (x - (bounds[0][0] + bounds[1][0]) / 2) * scale, map.y + map.height / 2 - (y - (bounds[0][1] + bounds[1][1]) / 2) * scale] as const;
  const [u, v] = at(first.keyframes[0]!.x, first.keyframes[0]!.y);
  await page.mouse.move(u, v);
  await page.mouse.down();
  await page.mouse.move(u, v - 30, { steps: 5 });
  await page.mouse.up();
  await until('a keyframe is where it was pulled to, at its height', async () => {
    const { keyframes } = await saved();
    const moved = keyframes.findIndex((key, i) => Math.abs(key.y - first.keyframes[i]!.y - 30 / scale) < 3 / scale);
    return moved >= 0 && keyframes[moved]!.z === first.keyframes[moved]!.z;
  });
  await page.getByRole('button', { name: 'Undo' }).click();
  await page.getByRole('button', { name: 'No target' }).click();
});

test('a tour of Google Earth is loaded and saved', async () => {
  const load = (name: string, text: string) => page.getByLabel('Path file').setInputFiles({ name, mimeType: 'application/octet-stream', buffer: Buffer.from(text) });
  await load('tour.kml', '<kml>\n<a></kml>');
  await page.getByRole('alert').getByText(/tour\.kml is not valid XML: line 2/).waitFor();
  await load('bad.json', '{"keyframes": [{"t": 0, "x": 1, "y": 2, "z": 3, "heading": 0, "pitch": "down"}]}');
  await page.getByRole('alert').getByText(/bad\.json: keyframe 0: "pitch": expected degrees/).waitFor();
  const [file] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name: 'KML' }).click()]);
  const kml = await readFile((await file.path())!, 'utf8');
  assert.equal(kml.match(/<gx:FlyTo>/g)!.length, 2);
  await load('saved.kml', kml);
  await until('it was loaded', async () => (await page.getByRole('alert').count()) === 0);
  await page.getByText('2 keyframes').waitFor();
  await until('the camera is at its start', async () => {
    const now = await flown.pose();
    return between(now, start) < 0.5 && Math.abs(turn(now.heading, start.heading)) < 0.02;
  });
});

test('a film is rendered, and downloaded', async () => {
  await page.getByLabel('Duration').fill('1');
  await page.getByLabel('Duration').press('Enter');
  await page.getByRole('button', { name: 'Window' }).click();
  await page.getByLabel(/^Rate/).fill('10');
  await page.getByLabel(/^Rate/).press('Enter');
  await page.getByRole('button', { name: 'Render film' }).click();
  const link = page.getByRole('list', { name: 'Films' }).getByRole('link');
  await link.waitFor({ timeout: 90_000 });
  const [file] = await Promise.all([page.waitForEvent('download'), link.click()]);
  const film = await readFile((await file.path())!);
  assert.equal(film.subarray(4, 8).toString('latin1'), 'ftyp');
  assert.match(file.suggestedFilename(), /^[\w.-]+\.mp4$/);
  await page.getByRole('list', { name: 'Films' }).getByRole('button', { name: /^Remove/ }).click();
  await until('it is gone', async () => (await page.getByRole('list', { name: 'Films' }).count()) === 0);
  await page.getByRole('tab', { name: 'Fly' }).click();
});

test('the page complained of nothing, and asked no other host', () => {
  assert.deepEqual(flown.complaints, []);
});

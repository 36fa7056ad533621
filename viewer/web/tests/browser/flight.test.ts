// The page with a real server and a real flight: its pictures, people, and what dies.
import assert from 'node:assert/strict';
import { readFile, writeFile } from 'node:fs/promises';
import { join } from 'node:path';
import { test } from 'node:test';
import { open, OUT, until } from './browser';
import { flight } from './flown';
import { compare, readPng } from './png';
import { Serve, terravision } from './serve';

const { flown, page, start } = await flight('serve-flight');

test('loads: the world, a picture, no request to another host', async () => {
  assert.match(await page.title(), /TerraVision/);
  await flown.connected(30);
  await page.getByRole('tab', { name: 'Figures' }).click();
  await until('figures have come', async () => /Drawn\s*[\d.]+ \/s/.test(await page.locator('.tab-content').innerText()));
  await page.getByRole('tab', { name: 'Fly' }).click();
});

test('at rest the picture is that of `terravision still`, byte for byte', async () => {
  await flown.jump({ heading: start.heading + 30, pitch: -21, roll: 4 });
  await page.evaluate(() => window.terravision.settled());
  const shown = await flown.shown();
  assert.ok(shown.isExact);
  const still = await flown.still(shown.pose, shown.pixels);
  assert.deepEqual(compare(shown.pixels, still), { largest: 0, mean: 0 });
});

test('while moving it is that of `terravision still` within what JPEG and larger facets change', async (t) => {
  await flown.atStart();
  const shown = await flown.shownWhile({ code: 'KeyD', key: 'd' });
  const { mean } = compare(shown.pixels, await flown.still(shown.pose, shown.pixels));
  // A picture of a moment before or after, turned by less than a degree, is another one by far.
  const turned = { ...shown.pose, heading: shown.pose.heading + 0.7 };
  const beside = compare(shown.pixels, await flown.still(turned, shown.pixels)).mean;
  t.diagnostic(`mean difference ${mean.toFixed(2)} of 255, and ${beside.toFixed(2)} to a picture that is turned by 0.7 degrees`);
  // How coarse facets are while moving depends on how much of the processor the flight gets.
  assert.ok(mean < 14 && mean < 0.8 * beside, `mean difference ${mean}, ${beside} to a turned picture`);
});

test('light is changed while flying; stills and the command have the same', async () => {
  await page.context().grantPermissions(['clipboard-read', 'clipboard-write']);
  await flown.jump({ ...start, heading: start.heading + 10 });
  await page.evaluate(() => window.terravision.settled());
  const plain = await flown.shown();
  await page.getByRole('tab', { name: 'Light' }).click();
  await page.getByRole('button', { name: 'Angles' }).click();
  await page.getByLabel('Altitude').fill('12');
  await page.getByLabel('Altitude').press('Enter');
  await page.getByLabel('Ground throws shadows').check();
  await page.getByRole('button', { name: 'Haze' }).click();
  await page.getByLabel('Visibility').fill('9');
  await page.getByLabel('Visibility').press('Enter');
  const flags = ['--sun', '315,12', '--shadows', '--haze', '9000'];
  const settings = () => page.evaluate(async () => ((await (await fetch('/api/info')).json()) as { settings: { sun: string; shadows: boolean; haze: number } }).settings);
  await until('the flight has them all', async () => {
    const { sun, shadows, haze } = await settings();
    return sun === '315,12' && shadows && haze === 9000;
  });
  const expected = await flown.still(plain.pose, plain.pixels, ...flags);
  let difference = NaN;
  await until('the exact picture has the light', async () => {
    await page.evaluate(() => window.terravision.settled());
    difference = compare((await flown.shown()).pixels, expected).largest;
    return difference === 0;
  }).catch(() => assert.fail(`the lit picture is ${difference} from that of terravision still`));
  assert.ok(compare(plain.pixels, expected).mean > 5);
  await page.screenshot({ path: join(OUT, 'page-light.png') });
  const { x, y, z, heading, pitch, roll, vfov } = plain.pose;
  const query = new URLSearchParams(Object.entries({ x, y, z, heading, pitch, roll, vfov, width: plain.pixels.width, height: plain.pixels.height }).map(([key, value]) => [key, String(value)]));
  const answer = await fetch(`${flown.serve.address}api/still.png?${query.toString()}`);
  assert.equal(compare(readPng(new Uint8Array(await answer.arrayBuffer())), expected).largest, 0);
  assert.match(answer.headers.get('x-terravision-command')!, / --sun 315,12 --haze 9000 --shadows /);
  await page.getByRole('tab', { name: 'Fly' }).click();
  await page.getByRole('button', { name: 'Command' }).click();
  await until('the command has it', async () => (await page.evaluate(() => navigator.clipboard.readText())).includes(` ${flags.join(' ')} `));
  await page.getByRole('tab', { name: 'Light' }).click();
  await page.getByRole('button', { name: 'Off' }).click();
  await page.getByRole('button', { name: 'Clear' }).click();
  await until('it is as it was', async () => {
    const { sun, haze } = await settings();
    return sun === 'off' && haze === 0;
  });
  await until('the exact picture is as it was', async () => {
    await page.evaluate(() => window.terravision.settled());
    return compare((await flown.shown()).pixels, plain.pixels).largest === 0;
  });
  await page.getByRole('tab', { name: 'Fly' }).click();
});

test('a link reproduces a view, and the copied command draws it', async () => {
  await page.context().grantPermissions(['clipboard-read', 'clipboard-write']);
  await flown.jump({ ...start, heading: 123.25, pitch: -30, z: start.z + 111 });
  await page.getByRole('button', { name: 'Link' }).click();
  await until('it was copied', async () => (await page.evaluate(() => navigator.clipboard.readText())).includes('#x='));
  const link = await page.evaluate(() => navigator.clipboard.readText());
  await page.getByRole('button', { name: 'Command' }).click();
  await until('it was copied', async () => (await page.evaluate(() => navigator.clipboard.readText())).startsWith('terravision still'));
  const command = await page.evaluate(() => navigator.clipboard.readText());
  await page.evaluate(() => window.terravision.settled());
  const shown = await flown.shown();
  // The page knows the world's name only; here it lies in OUT.
  const words = command.replace(/^terravision /, '').replace(/ -o view.png$/, '').split(' ');
  words[1] = flown.world;
  const file = join(OUT, 'view.png');
  await terravision(...words, '-o', file);
  assert.equal(compare(readPng(await readFile(file)), shown.pixels).largest, 0);
  await page.goto('about:blank');
  await page.goto(link);
  await until('the view is that of the link', async () => {
    const now = await page.evaluate(() => window.terravision?.pose() ?? null);
    return now !== null && Math.abs(now.heading - 123.25) < 1e-3 && Math.abs(now.z - start.z - 111) < 1e-2;
  });
  await flown.caughtUp();
});

test('two browsers: one flies, the other watches, then takes over', async () => {
  const other = await open(flown.browser, flown.serve.address, { viewport: { width: 700, height: 560 } });
  await other.page.getByRole('button', { name: 'Take over' }).waitFor({ timeout: 30_000 });
  await flown.jump({ ...start, heading: 200 });
  await until('the other one follows', async () => Math.abs(((await other.page.evaluate(() => window.terravision.pose()))?.heading ?? 0) - 200) < 1e-6);
  await other.page.getByRole('button', { name: 'Take over' }).click();
  await until('this one watches', async () => /flies/.test(await page.locator('.people').innerText()));
  await other.page.evaluate(() => window.terravision.goTo({ heading: 300 }, { seconds: 0 }));
  await until('this one follows', async () => Math.abs((await flown.pose()).heading - 300) < 1e-6);
  await page.getByRole('button', { name: 'Take over' }).click();
  await until('this one flies', async () => /You fly/.test(await page.locator('.people').innerText()));
  await flown.caughtUp();
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
    // Stills have renderers of their own: at rest there is the flight's alone.
    await flown.caughtUp();
    await page.evaluate(() => window.terravision.settled());
    let pid = 0;
    await until(`${program} runs`, async () => {
      const found = await flown.serve.pids(program);
      pid = found[0] ?? 0;
      return found.length === 1;
    });
    const n = await page.evaluate(() => window.terravision.frame()!.n);
    process.kill(pid, 'SIGKILL');
    await until(`${program} runs again`, async () => (await flown.serve.pids(program)).some((other) => other !== pid), 30);
    await flown.connected(40);
    const heading = (await flown.pose()).heading + 11;
    await flown.jump({ heading });
    assert.ok(program === 'terravision-viewer' || (await page.evaluate(() => window.terravision.frame()!.n)) > n);
  }
  const said = await page.evaluate(() => (window as unknown as { said: string[] }).said);
  assert.ok(said.some((text) => /Link lost/.test(text)), `it said ${[...new Set(said)].join(' · ')}`);
});

test('the whole server is killed, and comes back on its port', async () => {
  const { host } = new URL(flown.serve.address);
  await flown.serve.kill();
  await until('it says so', async () => /Link lost/.test(await page.locator('.status [role=status]').innerText()));
  const before = await flown.pose();
  flown.serve = await Serve.start(flown.world, 'serve-again', '--addr', host);
  await flown.connected(60);
  await flown.caughtUp();
  assert.ok(Math.abs((await flown.pose()).heading - before.heading) < 1e-6);
});

test('latency of pictures of 960x540 is measured', async (t) => {
  const before = page.viewportSize()!;
  await page.setViewportSize({ width: 960, height: before.height });
  const above = await page.evaluate(() => document.querySelector('main')!.clientHeight);
  await page.setViewportSize({ width: 960, height: before.height + 540 - above });
  // Anew, so that inputs of the tests before do not count.
  await page.reload();
  const isThisSize = () => page.evaluate(() => window.terravision?.frame()?.width === 960 && window.terravision.frame()!.height === 540);
  await until('pictures have this size', isThisSize, 60);
  await flown.atStart();
  await page.locator('main').focus();
  await page.keyboard.down('KeyD');
  await page.waitForTimeout(8000);
  await until('some inputs were answered', async () => ((await page.evaluate(() => window.terravision.latency()))?.samples ?? 0) > 5);
  await page.keyboard.up('KeyD');
  const latency = (await page.evaluate(() => window.terravision.latency()))!;
  const { width, height } = await page.evaluate(() => window.terravision.frame()!);
  t.diagnostic(`input to changed picture: ${JSON.stringify({ ...latency, width, height })}`);
  await writeFile(join(OUT, 'latency.json'), JSON.stringify(latency));
  await page.setViewportSize(before);
});

test('the page complained of nothing, and asked no other host', () => {
  assert.deepEqual(flown.complaints, []);
});

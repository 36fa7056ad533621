// How the page looks, at two sizes: screenshots, and what axe-core finds.
import assert from 'node:assert/strict';
import { createRequire } from 'node:module';
import { readFile } from 'node:fs/promises';
import { join } from 'node:path';
import { after, afterEach, before, test } from 'node:test';
import type { Browser, Page } from 'playwright-core';
import type {} from '../../src/programs';
import { launch, open, OUT, until, WEB, type WatchedPage } from './browser';
import { makeWorld, Serve } from './serve';

let browser: Browser;
let serve: Serve;

before(async () => {
  serve = await Serve.start(await makeWorld(), 'serve-looks');
  browser = await launch();
});
// The page of a test that failed would stay the pilot.
afterEach(async () => {
  for (const context of browser.contexts()) await context.close();
});
after(async () => {
  await browser?.close();
  await serve?.stop();
});

const TABS = ['Fly', 'Picture', 'Light', 'Measure', 'Path', 'Figures'];

async function load(width: number, height: number, more: object = {}): Promise<WatchedPage> {
  const watched = await open(browser, serve.address, { viewport: { width, height }, ...more });
  await until('the first picture', () => watched.page.evaluate(() => window.terravision.frame() !== null), 60);
  return watched;
}

async function settle(page: Page): Promise<void> {
  await page.evaluate(() => window.terravision.settled());
  // The map has its picture of the ground after the exact picture, at the latest.
  await page.waitForTimeout(2500);
}

/** What axe-core finds of the rules of WCAG 2.2 A and AA and of good practice. */
async function violations(page: Page): Promise<string[]> {
  const axe = await readFile(createRequire(join(WEB, 'package.json')).resolve('axe-core/axe.min.js'), 'utf8');
  await page.evaluate(axe);
  return page.evaluate(async () => {
    const { axe } = window as unknown as { axe: { run(): Promise<{ violations: { id: string; nodes: { target: string[]; failureSummary: string }[] }[] }> } };
    const found = await axe.run();
    return found.violations.flatMap(({ id, nodes }) => nodes.map(({ target, failureSummary }) => `${id}: ${target.join(' ')}: ${failureSummary}`));
  });
}

for (const [width, height, more] of [
  [1280, 800, {}],
  [390, 844, { hasTouch: true, isMobile: true }],
] as const) {
  test(`at ${width}x${height}: every part of the panel, without a violation of axe-core`, async () => {
    const { page, complaints } = await load(width, height, more);
    await page.keyboard.press('k');
    await page.evaluate(() => window.terravision.goTo({ heading: window.terravision.pose()!.heading + 25, y: window.terravision.pose()!.y + 900, z: window.terravision.pose()!.z + 150 }, { seconds: 0 }));
    await page.keyboard.press('k');
    await settle(page);
    for (const name of TABS) {
      await page.getByRole('tab', { name }).click();
      if (name === 'Light') {
        // All fields there are, of a flight that is started again for them.
        await page.getByRole('button', { name: 'Time' }).click();
        await page.getByLabel('Date and time').waitFor();
        await page.getByRole('button', { name: 'Haze' }).click();
        await page.getByLabel('Visibility').waitFor();
        await page.getByLabel('Ground throws shadows').check();
        await page.waitForTimeout(1500);
      }
      if (name === 'Measure') {
        await page.getByRole('button', { name: 'Line' }).click();
        const view = (await page.locator('.view').boundingBox())!;
        await page.mouse.click(view.width * 0.3, view.height * 0.62);
        await page.locator('.overlay circle').first().waitFor({ state: 'attached' });
        await page.mouse.click(view.width * 0.68, view.height * 0.55);
        await page.getByRole('slider', { name: 'Place along the line' }).waitFor();
      }
      await page.waitForTimeout(400);
      assert.deepEqual(await violations(page), [], name);
      // Nothing is wider than the window.
      assert.equal(await page.evaluate(() => document.documentElement.scrollWidth), width);
      await page.screenshot({ path: join(OUT, `page-${width}x${height}-${name.toLowerCase()}.png`) });
    }
    await page.getByRole('tab', { name: 'Path' }).click();
    await page.getByRole('button', { name: 'Side view' }).click();
    await page.getByRole('slider', { name: 'Height of keyframe 1' }).scrollIntoViewIfNeeded();
    await page.waitForTimeout(900);
    assert.deepEqual(await violations(page), [], 'side view');
    await page.screenshot({ path: join(OUT, `page-${width}x${height}-side.png`) });
    await page.getByRole('tab', { name: 'Fly' }).click();
    await page.getByRole('button', { name: 'Hands and keys (?)' }).click();
    assert.deepEqual(await violations(page), [], 'help');
    await page.screenshot({ path: join(OUT, `page-${width}x${height}-help.png`) });
    await page.keyboard.press('Escape');
    await page.locator('dialog').waitFor({ state: 'detached' });
    await page.getByRole('button', { name: 'Hide the panel' }).click();
    await page.getByRole('button', { name: 'Show the panel' }).click();
    assert.deepEqual(complaints, []);
  });
}

/** Each half moves with the camera before a new picture comes, and what is under the cursor is marked for both eyes. */
async function moveHalves(page: Page): Promise<void> {
  const [rested, moved] = await page.evaluate(async () => {
    const styles = () => [...document.querySelectorAll<HTMLElement>('.half canvas')].map((canvas) => canvas.style.transform);
    const rested = styles();
    await window.terravision.goTo({ heading: window.terravision.pose()!.heading + 2 }, { seconds: 0 });
    return [rested, styles()];
  });
  assert.ok(rested!.length === 2 && rested!.every((style) => style.startsWith('scale(')), `at rest ${rested!.join(' ')}`);
  assert.ok(moved!.every((style) => style.startsWith('matrix3d(')) && moved![0] !== moved![1], `moving ${moved!.join(' ')}`);
  const view = (await page.locator('.view').boundingBox())!;
  await page.mouse.move(view.width * 0.3, view.height * 0.7);
  // Where the middles of the marks are, both at one moment: they are drawn anew with every picture.
  const marks = () => page.evaluate(() => [...document.querySelectorAll('.overlay circle.here')].map((mark) => mark.getBoundingClientRect()).map(({ x, width }) => x + width / 2));
  await until('what is under the cursor is marked for both eyes', async () => {
    const [left, right] = await marks();
    if (left === undefined || right === undefined) return false;
    return Math.abs(left - view.width * 0.3) < 12 && Math.abs(right - left - view.width / 2) < view.width / 20;
  });
  await page.screenshot({ path: join(OUT, 'page-1280x800-pair-cursor.png') });
  await settle(page);
}

test('two eyes: side by side, and for red and cyan glasses', async () => {
  const { page, complaints } = await load(1280, 800);
  await page.getByRole('tab', { name: 'Picture' }).click();
  const differences = () =>
    page.evaluate(() => {
      const { width, height, pixels } = window.terravision.frame()!;
      let [halves, colors] = [0, 0];
      for (let row = height >> 1; row < height; row += 3) {
        for (let column = 0; column < width >> 1; column += 3) {
          const at = 4 * (row * width + column);
          halves += Math.abs(pixels[at + 1]! - pixels[at + 2 * width + 1]!);
          colors += Math.abs(pixels[at]! - pixels[at + 1]!);
        }
      }
      const count = (height / 6) * (width / 6);
      return { halves: halves / count, colors: colors / count };
    });
  const one = await differences();
  for (const [name, file] of [['Side by side', 'pair'], ['Red-cyan', 'anaglyph']] as const) {
    const flight = await page.evaluate(() => window.terravision.frame()!.n);
    await page.getByRole('button', { name }).click();
    await until('pictures of another flight', async () => (await page.evaluate(() => window.terravision.frame()!.n)) > flight + 1);
    await settle(page);
    await page.screenshot({ path: join(OUT, `page-1280x800-${file}.png`) });
    if (file === 'pair') await moveHalves(page);
    const two = await differences();
    if (file === 'pair') assert.ok(two.halves < 0.8 * one.halves && two.halves > 0.5, `halves differ by ${two.halves}, of one eye by ${one.halves}`);
    else assert.ok(Math.abs(two.colors - one.colors) > 2, `red and green differ by ${two.colors}, of one eye by ${one.colors}`);
  }
  assert.deepEqual(await violations(page), []);
  assert.deepEqual(complaints, []);
});

test('all controls are reached by the keyboard, in an order that ends', async () => {
  const { page } = await load(1280, 800);
  const reached: string[] = [];
  for (let i = 0; i < 60; i++) {
    await page.keyboard.press('Tab');
    const name = await page.evaluate(() => document.activeElement?.getAttribute('aria-label') ?? document.activeElement?.textContent ?? '');
    if (reached.includes(name) && name === reached[0]) break;
    reached.push(name);
  }
  for (const name of ['Hands and keys (?)', 'North up (N)', 'Turn left', 'Tilt up', 'Zoom in (+)', 'Fly', 'Free', 'Link', 'Zoom the map in']) {
    assert.ok(reached.includes(name), `${name} is not reached: ${reached.join(' · ')}`);
  }
});

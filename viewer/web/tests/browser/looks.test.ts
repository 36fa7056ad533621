// How the page looks, at two sizes: screenshots, and what axe-core finds.
import assert from 'node:assert/strict';
import { createRequire } from 'node:module';
import { readFile } from 'node:fs/promises';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
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
after(async () => {
  await browser?.close();
  await serve?.stop();
});

const TABS = ['Fly', 'Picture', 'Measure', 'Path', 'Figures'];

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
    await page.evaluate(() => window.terravision.goTo({ heading: window.terravision.pose()!.heading + 25 }, { seconds: 0 }));
    await page.keyboard.press('k');
    await settle(page);
    for (const name of TABS) {
      await page.getByRole('tab', { name }).click();
      if (name === 'Measure') {
        await page.getByRole('button', { name: 'Line' }).click();
        const view = (await page.locator('.view').boundingBox())!;
        await page.mouse.click(view.width * 0.3, view.height * 0.62);
        await page.waitForTimeout(700);
        await page.mouse.click(view.width * 0.68, view.height * 0.55);
        await page.getByRole('slider', { name: 'Place along the line' }).waitFor();
      }
      await page.waitForTimeout(400);
      assert.deepEqual(await violations(page), [], name);
      // Nothing is wider than the window.
      assert.equal(await page.evaluate(() => document.documentElement.scrollWidth), width);
      await page.screenshot({ path: join(OUT, `page-${width}x${height}-${name.toLowerCase()}.png`) });
    }
    await page.getByRole('tab', { name: 'Fly' }).click();
    await page.getByRole('button', { name: 'Hands and keys (?)' }).click();
    assert.deepEqual(await violations(page), [], 'help');
    await page.screenshot({ path: join(OUT, `page-${width}x${height}-help.png`) });
    await page.keyboard.press('Escape');
    assert.equal(await page.locator('dialog').count(), 0);
    await page.getByRole('button', { name: 'Hide the panel' }).click();
    await page.getByRole('button', { name: 'Show the panel' }).click();
    assert.deepEqual(complaints, []);
    await page.context().close();
  });
}

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
  await page.context().close();
});

import { chromium, type Browser, type BrowserContextOptions, type Page } from 'playwright-core';
import assert from 'node:assert/strict';
import { existsSync } from 'node:fs';
import { mkdir } from 'node:fs/promises';
import { join } from 'node:path';

/** The folder of the page's sources, and that of the project. */
export const WEB = process.env.TERRAVISION_WEB!;
export const ROOT = join(WEB, '..', '..');
/** Where screenshots, worlds and logs of the tests go. */
export const OUT = join(process.env.CARGO_TARGET_DIR ?? join(ROOT, 'target'), 'page-tests');

const CHROMIUM = process.env.TERRAVISION_CHROMIUM ?? ['/usr/bin/chromium', '/usr/bin/chromium-browser', '/usr/bin/google-chrome'].find((path) => existsSync(path));

/** Debian's Chromium, without a window. */
export async function launch(): Promise<Browser> {
  await mkdir(OUT, { recursive: true });
  assert.ok(CHROMIUM, 'no Chromium: scripts/setup.sh --tests installs it');
  return chromium.launch({ executablePath: CHROMIUM, args: ['--no-sandbox', '--disable-gpu', '--disable-dev-shm-usage', '--force-color-profile=srgb'] });
}

/** A page whose errors, warnings and requests to other hosts fail the test at its end. */
export interface WatchedPage {
  page: Page;
  /** What went wrong so far. */
  complaints: string[];
}

/** Opens a page; `prepare` is called before it is loaded. */
export async function open(browser: Browser, address: string, options: BrowserContextOptions = {}, prepare: (page: Page) => void = () => {}): Promise<WatchedPage> {
  const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, ...options });
  const page = await context.newPage();
  prepare(page);
  const complaints: string[] = [];
  page.on('pageerror', (error) => complaints.push(String(error)));
  page.on('console', (message) => {
    // A link that is cut on purpose is told by the browser, too.
    if (message.type() === 'error' && !/WebSocket|ERR_CONNECTION|Failed to load resource/.test(message.text())) complaints.push(message.text());
  });
  const { host } = new URL(address);
  page.on('request', (request) => {
    const url = new URL(request.url());
    if (url.protocol.startsWith('http') && url.host !== host) complaints.push(`a request to another host: ${request.url()}`);
  });
  await page.goto(address);
  return { page, complaints };
}

/** Waits until a condition holds; says what was expected when it does not in time. */
export async function until(what: string, condition: () => Promise<boolean> | boolean, seconds = 30): Promise<void> {
  const end = Date.now() + seconds * 1000;
  while (Date.now() < end) {
    if (await condition()) return;
    await new Promise((resolve) => setTimeout(resolve, 60));
  }
  assert.fail(`not within ${seconds} s: ${what}`);
}

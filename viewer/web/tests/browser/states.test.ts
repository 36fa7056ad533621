// What the page shows in states that a real server is in for a moment only, or never: with a server that says what it is told to.
import assert from 'node:assert/strict';
import { after, afterEach, before, beforeEach, test } from 'node:test';
import type { Browser, BrowserContext, Page } from 'playwright-core';
import { launch, until } from './browser';
import { Fake, START } from './fake';
import type {} from '../../src/programs';

let browser: Browser;
let fake: Fake;
let address: string;
let context: BrowserContext;
let page: Page;
let errors: string[];

before(async () => {
  browser = await launch();
});
after(() => browser.close());

beforeEach(async () => {
  fake = new Fake();
  address = await fake.start();
  context = await browser.newContext({ viewport: { width: 1000, height: 700 } });
  await fake.attach(context);
  page = await context.newPage();
  errors = [];
  page.on('pageerror', (error) => errors.push(String(error)));
  page.on('console', (message) => message.type() === 'error' && /Content Security|Uncaught/.test(message.text()) && errors.push(message.text()));
});
afterEach(async () => {
  assert.deepEqual(errors, []);
  await context.close();
  await fake.stop();
});

const status = () => page.locator('.status [role=status]').innerText();
const loaded = async () => {
  await page.goto(address);
  await until('the first picture', async () => (await status()) === 'Exact');
};

test('connects, and says so until the first picture has come', async () => {
  fake.isGone = true;
  await page.goto(address);
  await until('it says that the link is lost', async () => /Link lost/.test(await status()));
  fake.isGone = false;
  await until('it is connected by itself', async () => (await status()) === 'Exact');
  assert.equal(await page.title(), 'fake.tv · TerraVision');
});

test('a link that is cut comes back, at the same camera', async () => {
  await loaded();
  await page.evaluate(() => window.terravision.goTo({ x: 501_234, heading: 77 }, { seconds: 0 }));
  fake.isGone = true;
  await fake.cut();
  await until('it says so', async () => /Link lost/.test(await status()));
  assert.match(await page.locator('.problem-bar').innerText(), /goes on by itself/);
  const before = fake.received.length;
  fake.isGone = false;
  await until('it is back', async () => (await status()) === 'Exact');
  const sent = fake.received.slice(before).filter((message) => message.type === 'pose');
  assert.equal(sent[0]?.x, 501_234);
  assert.equal((await page.evaluate(() => window.terravision.pose()))?.heading, 77);
});

test('a stage that is started again, and a flight that failed, are told with the reason', async () => {
  await loaded();
  fake.state({ flight: 'restarting', reason: 'the renderer ended by signal 9' });
  await until('restarting', async () => /again/.test(await status()));
  assert.match(await page.locator('.problem-bar').innerText(), /signal 9/);
  fake.state({ flight: 'failed', reason: 'no tile could be read' });
  await until('failed', async () => /failed/.test(await status()));
  fake.state({ flight: 'flying' });
  await until('flying', async () => (await status()) === 'Exact');
  assert.equal(await page.locator('.problem-bar').count(), 0);
  fake.send({ type: 'notice', level: 'warning', text: 'the preparer was started again' });
  await page.getByText('the preparer was started again').waitFor();
});

test('beside the world it says that there are no data', async () => {
  await loaded();
  await page.evaluate(() => window.terravision.goTo({ x: 470_000 }, { seconds: 0 }));
  await until('it says so', async () => (await status()) === 'Beside the world');
  await page.keyboard.press('r');
  await until('it has flown back', async () => (await page.evaluate(() => window.terravision.pose()))?.x === START.x);
  await until('it says so', async () => (await status()) === 'Exact');
});

test('a token that is missing is asked for', async () => {
  let token: string | undefined;
  fake.answer = (message) => {
    if (message.type !== 'hello') return undefined;
    token = message.token;
    return token === 'abcdefgh' ? undefined : { type: 'bye', code: 'wrong-token', text: 'a token is needed' };
  };
  const said = fake.answer;
  fake.answer = (message) => {
    const answer = said(message);
    if (answer !== undefined) setTimeout(() => void fake.cut(), 50);
    return answer;
  };
  await page.goto(address);
  await page.getByText('This server asks for a token').waitFor();
  await page.getByLabel('Token').fill('abcdefgh');
  await page.getByRole('button', { name: 'Open' }).click();
  await until('it is connected', async () => (await status()) === 'Exact');
  assert.equal(token, 'abcdefgh');
});

test('a page of an older version reloads, once', async () => {
  await loaded();
  await page.evaluate(() => Object.assign(window, { isOld: true }));
  fake.welcome.version = '1.1.0';
  await fake.cut();
  await until('it is a new page', async () => !(await page.evaluate(() => 'isOld' in window).catch(() => true)));
  await until('it is connected', async () => (await status()) === 'Exact');
});

test('one who watches follows the pilot, is told so, and can take over', async () => {
  fake.welcome.pilot = 9;
  fake.welcome.people = [{ id: 9, name: 'Ada' }, { id: 1, name: null }];
  await loaded();
  assert.match(await page.locator('.people').innerText(), /Ada flies/);
  assert.equal(await page.getByRole('button', { name: 'Turn left' }).isDisabled(), true);
  const before = fake.received.filter(({ type }) => type === 'pose').length;
  await page.keyboard.press('ArrowUp', { delay: 120 });
  assert.equal(fake.received.filter(({ type }) => type === 'pose').length, before);
  fake.picture({ ...START, heading: 200 }, 0);
  await until('it follows', async () => (await page.evaluate(() => window.terravision.pose()))?.heading === 200);
  await page.getByRole('button', { name: 'Take over' }).click();
  await until('it asked for that', () => fake.received.some(({ type }) => type === 'take-over'));
  fake.state({ pilot: 1 });
  await until('it goes on where the other one was', () => fake.received.some((message) => message.type === 'pose' && message.heading === 200));
  assert.match(await page.locator('.people').innerText(), /You fly · 1 watching/);
});

test('numbers are typed, and what is not one is not taken', async () => {
  await loaded();
  const height = page.getByLabel('Z, height');
  await height.fill('2 500,5');
  await height.press('Enter');
  assert.equal((await page.evaluate(() => window.terravision.pose()))?.z, 2500.5);
  const pitch = page.getByLabel('Pitch');
  await pitch.fill('-95');
  assert.equal(await pitch.getAttribute('aria-invalid'), 'true');
  await pitch.press('Enter');
  assert.equal((await page.evaluate(() => window.terravision.pose()))?.pitch, START.pitch);
  await page.getByLabel('Heading').press('ArrowUp');
  assert.equal((await page.evaluate(() => window.terravision.pose()))?.heading, START.heading + 1);
});

test('settings go to the server', async () => {
  await loaded();
  await page.getByRole('tab', { name: 'Picture' }).click();
  await page.getByRole('button', { name: 'Rays' }).click();
  await page.getByLabel('r_z, facets').fill('5');
  await page.getByLabel('r_z, facets').press('Enter');
  await until('both were sent', () => fake.received.filter(({ type }) => type === 'settings').length === 2);
  const sent = fake.received.filter((message) => message.type === 'settings');
  assert.deepEqual(sent, [{ type: 'settings', technique: 'rays' }, { type: 'settings', facet_px: 5 }]);
});

test('a path file with errors is refused with line and reason, and a good one is played', async () => {
  await loaded();
  await page.getByRole('tab', { name: 'Path' }).click();
  const load = (name: string, text: string) => page.getByLabel('Path file').setInputFiles({ name, mimeType: 'application/json', buffer: Buffer.from(text) });
  await load('bad.json', '{"keyframes": [\n{"t": 0,,}]}');
  await page.getByText(/bad\.json: line 2: not JSON/).waitFor();
  const key = (t: number, x: number) => ({ t, x, y: START.y, z: START.z, heading: 10, pitch: -14 });
  await load('good.json', JSON.stringify({ keyframes: [key(0, 500_000), key(1, 500_500)] }));
  await page.getByText('2 keyframes').waitFor();
  await page.getByRole('button', { name: 'Play', exact: true }).click();
  await until('it has flown to the end', async () => (await page.evaluate(() => window.terravision.pose()))?.x === 500_500);
});

test('a page that embeds this one steers it by messages', async () => {
  await page.goto(`${address}embedding.html`);
  await until('a picture has come', () => fake.received.some(({ type }) => type === 'ack'));
  const ask = (call: string, args: unknown[] = []) =>
    page.evaluate(
      ([call, args]) =>
        new Promise<{ value?: unknown; error?: string }>((resolve) => {
          const id = Math.random();
          window.addEventListener('message', (event) => {
            if ((event.data as { id?: number }).id === id) resolve(event.data as { value?: unknown; error?: string });
          });
          (document.querySelector('iframe') as HTMLIFrameElement).contentWindow!.postMessage({ terravision: 1, id, call, args }, '*');
        }),
      [call, args] as const,
    );
  await ask('goTo', [{ heading: 123 }, { seconds: 0 }]);
  assert.equal(((await ask('pose')).value as { heading: number }).heading, 123);
  assert.match((await ask('goTo', [{ pitch: 'down' }])).error!, /expected finite numbers/);
  assert.match((await ask('eval')).error!, /expected one of pose, goTo/);
});

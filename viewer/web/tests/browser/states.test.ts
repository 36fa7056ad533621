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
  await page.locator('.problem-bar').getByText(/goes on by itself/).waitFor();
  const before = fake.received.length;
  fake.isGone = false;
  await until('it is back', async () => (await status()) === 'Exact');
  const sent = fake.received.slice(before).filter((message) => message.type === 'pose');
  assert.equal(sent[0]?.x, 501_234);
  await until('it looks where it did', async () => (await page.evaluate(() => window.terravision.pose()))?.heading === 77);
});

test('a stage that is started again, and a flight that failed, are told with the reason', async () => {
  await loaded();
  fake.state({ flight: 'restarting', reason: 'the renderer ended by signal 9' });
  await until('restarting', async () => /again/.test(await status()));
  await page.locator('.problem-bar').getByText(/signal 9/).waitFor();
  fake.state({ flight: 'failed', reason: 'no tile could be read' });
  await until('failed', async () => /failed/.test(await status()));
  fake.state({ flight: 'flying' });
  await until('flying', async () => (await status()) === 'Exact');
  await until('there is no problem left', async () => (await page.locator('.problem-bar').count()) === 0);
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

test('a camera does not fly so far from the world that the server would refuse it', async () => {
  await page.goto(`${address}#x=1e9&y=5198000&z=9000&heading=0&pitch=-20`);
  await until('the first picture', async () => (await status()) !== 'Connecting …' && (await page.evaluate(() => window.terravision.frame() !== null)));
  const [, [east]] = fake.welcome.world.bounds;
  const sent = () => fake.received.flatMap((message) => (message.type === 'pose' ? [message] : []));
  await until('the camera was sent', () => sent().length > 0);
  assert.ok(sent().every(({ x }) => x > east && x < east + 2 * 20480), JSON.stringify(sent()));
});

test('a browser without WebSocket is told so', async () => {
  // The fake server would give it one.
  const bare = await browser.newPage();
  await bare.addInitScript(() => Reflect.deleteProperty(window, 'WebSocket'));
  await bare.goto(address);
  await until('it is told', async () => (await bare.locator('.status [role=status]').innerText()) === 'No connection');
  assert.match(await bare.locator('.problem-bar').innerText(), /This browser has no WebSocket/);
  await bare.close();
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
  await page.locator('.people').getByText(/Ada flies/).waitFor();
  await until('what turns the camera is disabled', () => page.getByRole('button', { name: 'Turn left' }).isDisabled());
  const before = fake.received.filter(({ type }) => type === 'pose').length;
  await page.keyboard.press('ArrowUp', { delay: 120 });
  assert.equal(fake.received.filter(({ type }) => type === 'pose').length, before);
  fake.picture({ ...START, heading: 200 }, 0);
  await until('it follows', async () => (await page.evaluate(() => window.terravision.pose()))?.heading === 200);
  await page.getByRole('button', { name: 'Take over' }).click();
  await until('it asked for that', () => fake.received.some(({ type }) => type === 'take-over'));
  fake.state({ pilot: 1 });
  await until('it goes on where the other one was', () => fake.received.some((message) => message.type === 'pose' && message.heading === 200));
  await until('it says so', async () => /You fly · 1 watching/.test(await page.locator('.people').innerText()));
});

test('numbers are typed, and what is not one is not taken', async () => {
  await loaded();
  const height = page.getByLabel('Z, height');
  await height.fill('2 500,5');
  await height.press('Enter');
  const pose = () => page.evaluate(() => window.terravision.pose());
  await until('the height was taken', async () => (await pose())?.z === 2500.5);
  const pitch = page.getByLabel('Pitch');
  await pitch.fill('-95');
  await until('it is shown as wrong', async () => (await pitch.getAttribute('aria-invalid')) === 'true');
  await pitch.press('Enter');
  await until('what it was is shown again', async () => (await pitch.inputValue()) !== '-95');
  await page.getByLabel('Heading').press('ArrowUp');
  await until('the heading was taken', async () => (await pose())?.heading === START.heading + 1);
  assert.equal((await pose())?.pitch, START.pitch);
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

test('light is chosen, and shown as the server has it', async () => {
  await loaded();
  await page.getByRole('tab', { name: 'Light' }).click();
  fake.answer = (message) => {
    if (message.type !== 'settings') return undefined;
    const { type: _, ...change } = message;
    fake.welcome.settings = { ...fake.welcome.settings, ...change };
    fake.state({});
    return undefined;
  };
  const sent = () => fake.received.filter((message) => message.type === 'settings').map(({ type: _, ...change }) => change);
  await page.getByRole('button', { name: 'Angles' }).click();
  await page.getByLabel('Altitude').fill('8,5');
  await page.getByLabel('Altitude').press('Enter');
  await page.getByLabel('Ground throws shadows').check();
  await page.getByRole('button', { name: 'Haze' }).click();
  await page.getByLabel('Visibility').fill('12');
  await page.getByLabel('Visibility').press('Enter');
  await until('all of it was sent', () => sent().length === 5);
  assert.deepEqual(sent(), [{ sun: '315,45' }, { sun: '315,8.5' }, { shadows: true }, { haze: 30000 }, { haze: 12000 }]);
  await page.getByRole('button', { name: 'Time' }).click();
  // The middle of the world is at 9 degrees east.
  await page.getByText('UTC+01:00').waitFor();
  await page.getByLabel('Date and time').fill('2026-06-21T05:45');
  await page.getByLabel('Date and time').press('Enter');
  await until('the time was sent', () => sent().length === 7);
  assert.deepEqual(sent()[6], { sun: '2026-06-21T05:45+01:00' });
  await page.getByRole('tab', { name: 'Fly' }).click();
  await context.grantPermissions(['clipboard-read', 'clipboard-write']);
  await page.getByRole('button', { name: 'Command' }).click();
  await until('the command has the light', async () =>
    (await page.evaluate(() => navigator.clipboard.readText())).endsWith(' --sun 2026-06-21T05:45+01:00 --shadows --haze 12000 -o view.png'),
  );
});

test('a path file with errors is refused with line and reason, and a good one is played', async () => {
  await loaded();
  await page.getByRole('tab', { name: 'Path' }).click();
  const load = (name: string, text: string) => page.getByLabel('Path file').setInputFiles({ name, mimeType: 'application/json', buffer: Buffer.from(text) });
  await load('bad.json', '{"keyframes": [\n{"t": 0,,}]}');
  await page.getByRole('alert').getByText(/bad\.json is not valid JSON: .* line 2/).waitFor();
  const key = (t: number, x: number) => ({ t, x, y: START.y, z: START.z, heading: 10, pitch: -14 });
  await load('good.json', JSON.stringify({ keyframes: [key(0, 500_000), key(1, 500_500)] }));
  await page.getByText('2 keyframes').waitFor();
  await page.getByRole('button', { name: 'Play', exact: true }).click();
  await until('it has flown to the end', async () => (await page.evaluate(() => window.terravision.pose()))?.x === 500_500);
  await page.getByRole('alert').waitFor({ state: 'detached' });
});

test('films tell how far they are, why they failed, and where they are', async () => {
  await loaded();
  await page.getByRole('tab', { name: 'Path' }).click();
  const render = page.getByRole('button', { name: 'Render film' });
  assert.equal(await render.isDisabled(), true);
  await page.getByRole('button', { name: 'Keyframe', exact: true }).click();
  await render.click();
  await page.getByRole('alert').getByText(/take 4.0 GB: remove one first/).waitFor();
  const film = { size: [1280, 720] as [number, number], fps: 30, quality: 'default' as const };
  const films = [
    { ...film, id: 1, name: 'North', state: 'done' as const, bytes: 12_400_000, text: null },
    { ...film, id: 2, name: 'East', state: 'failed' as const, text: 'ffmpeg makes the film and is not installed' },
    { ...film, id: 3, name: 'South', state: 'drawing' as const, drawn: 30, frames: 120 },
  ];
  fake.send({ type: 'films', films, bytes: 12_400_000, most_bytes: 4e9 });
  await page.getByText('30 of 120').waitFor();
  assert.equal(await page.getByRole('progressbar', { name: 'Progress of South' }).getAttribute('value'), '0.25');
  await until('another one cannot be begun', () => render.isDisabled());
  await page.getByText('ffmpeg makes the film and is not installed').waitFor();
  assert.equal(await page.getByRole('link', { name: '12.4 MB' }).getAttribute('href'), '/api/films/1.mp4');
  await page.getByRole('button', { name: 'Cancel South' }).click();
  await page.getByRole('button', { name: 'Remove East' }).click();
  await until('both were asked for', () => fake.films.includes('DELETE /api/films/3') && fake.films.includes('DELETE /api/films/2'));
});

test('the map shows nodes and the ground that is seen, and can leave the nodes out', async () => {
  await loaded();
  await until('the map was asked for', () => fake.received.some((message) => message.type === 'map' && message.wanted));
  const map = page.locator('.map-canvas');
  let empty = await map.screenshot();
  await until('the ground of the map has come', async () => {
    const before = empty;
    await page.waitForTimeout(900);
    empty = await map.screenshot();
    return empty.equals(before);
  });
  fake.send({ type: 'map', tiles: { resident: [7, 0, 0, 6, 1, 1], wanted: [5, 0, 1], left_out: 0 }, footprint: [[495_000, 5_193_000], [505_000, 5_193_000], [500_000, 5_205_000]] });
  await until('it shows them', async () => !(await map.screenshot()).equals(empty));
  const full = await map.screenshot();
  await page.getByRole('button', { name: 'Tiles in memory' }).click();
  await until('it shows the ground that is seen alone', async () => {
    const now = await map.screenshot();
    return !now.equals(full) && !now.equals(empty);
  });
});

test('two eyes are chosen with the place where they meet', async () => {
  await loaded();
  await page.getByRole('tab', { name: 'Picture' }).click();
  await page.getByRole('button', { name: 'Side by side' }).click();
  await until('it was sent', () => fake.received.some((message) => message.type === 'settings'));
  const sent = fake.received.filter((message) => message.type === 'settings');
  assert.deepEqual(sent, [{ type: 'settings', stereo: 'side-by-side', convergence: 5400, eye_separation: null }]);
  fake.state({ settings: { ...fake.welcome.settings, stereo: 'side-by-side', convergence: 5400 } });
  await page.getByLabel('Eyes apart').fill('120');
  await page.getByLabel('Eyes apart').press('Enter');
  await until('it was sent', () => fake.received.some((message) => message.type === 'settings' && message.eye_separation === 120));
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
  assert.match((await ask('goTo', [{ heading: 1 }, { seconds: NaN }])).error!, /expected seconds from 0, found NaN/);
  assert.match((await ask('goTo', [{ x: 1e9 }])).error!, /expected a place near the world, found 1000000000/);
  assert.match((await ask('eval')).error!, /expected one of pose, goTo/);
});

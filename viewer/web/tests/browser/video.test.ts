// Pictures that come as H.264: decoded by the page, and sent by a server whose link to the page is slow.
import assert from 'node:assert/strict';
import { execFile } from 'node:child_process';
import { createServer, connect, type AddressInfo, type Server, type Socket } from 'node:net';
import { after, before, test } from 'node:test';
import { promisify } from 'node:util';
import type { Browser, Page } from 'playwright-core';
import type {} from '../../src/programs';
import { launch, open, until } from './browser';
import { Fake, START } from './fake';
import { compare } from './png';
import { makeWorld, Serve } from './serve';
import { shownOn } from './flown';

const run = promisify(execFile);
const PACKET_BYTES = 1400;
let browser: Browser;

before(async () => {
  browser = await launch();
});
after(() => browser?.close());

/** The configuration and the access units of a file that ffmpeg made, each with whether it is a key. */
function unitsOf(flv: Buffer): { config: Buffer; units: { isKey: boolean; bytes: Buffer }[] } {
  const units: { isKey: boolean; bytes: Buffer }[] = [];
  let config: Buffer = Buffer.alloc(0);
  for (let at = 13; at < flv.length; ) {
    const length = flv.readUIntBE(at + 1, 3);
    const data = flv.subarray(at + 11, at + 11 + length);
    if (flv[at] === 9 && data[1] === 0) config = data.subarray(5);
    if (flv[at] === 9 && data[1] === 1) units.push({ isKey: data[0]! >> 4 === 1, bytes: data.subarray(5) });
    at += 15 + length;
  }
  return { config, units };
}

test('each picture of a video is shown when it comes, in the colours that it had', async () => {
  const options = { encoding: 'buffer' as const, maxBuffer: 1 << 26 };
  const source = ['-v', 'error', '-f', 'lavfi', '-i', 'testsrc=size=320x180:rate=10', '-frames:v', '4'];
  const h264 = ['-vf', 'scale=out_color_matrix=bt709:out_range=tv,format=yuv420p', '-colorspace', 'bt709', '-color_range', 'tv', '-c:v', 'libx264', '-tune', 'zerolatency', '-profile:v', 'baseline', '-f', 'flv', '-'];
  const { config, units } = unitsOf((await run('ffmpeg', [...source, ...h264], options)).stdout);
  const raw = (await run('ffmpeg', [...source, '-f', 'rawvideo', '-pix_fmt', 'rgb24', '-'], options)).stdout;
  assert.equal(units.length, 4);
  const fake = new Fake();
  const address = await fake.start();
  const context = await browser.newContext({ viewport: { width: 1000, height: 700 } });
  await fake.attach(context);
  const page = await context.newPage();
  await page.goto(address);
  await until('the first picture', () => page.evaluate(() => window.terravision.frame() !== null));
  const hello = fake.received.find((message) => message.type === 'hello');
  assert.equal(hello?.type === 'hello' && hello.h264, true);
  for (const [i, { isKey, bytes }] of units.entries()) {
    const length = Buffer.alloc(4);
    const own = i === 0 ? config : Buffer.alloc(0);
    length.writeUInt32LE(own.length);
    const n = fake.video(START, Buffer.concat([length, own, bytes]), { isKey, width: 320, height: 180 });
    await until('it was shown', () => fake.received.some((message) => message.type === 'ack' && message.n === n));
    const ack = fake.received.find((message) => message.type === 'ack' && message.n === n);
    assert.ok(ack?.type === 'ack' && ack.failed !== true);
    const { kind, pixels } = await shownOn(page);
    const size = 320 * 180 * 3;
    const { mean } = compare(pixels, { width: 320, height: 180, rgb: raw.subarray(i * size, (i + 1) * size) });
    assert.ok(kind === 'h264' && mean < 6, `picture ${i} is ${kind}, ${mean} from what it was`);
  }
  // What cannot be decoded is told, so that the server goes back to JPEG.
  const n = fake.video(START, Buffer.from([4, 0, 0, 0, 1, 66, 192, 30, 1, 2, 3]), { isKey: true, width: 320, height: 180 });
  await until('it was told', () => fake.received.some((message) => message.type === 'ack' && message.n === n && message.failed === true));
  await context.close();
  await fake.stop();
});

/** Passes bytes on between a page and a server, which is heard as over a link of this rate. */
class SlowLink {
  private readonly server: Server;
  private readonly sockets = new Set<Socket>();

  constructor(
    private readonly port: number,
    private readonly bytesPerSecond: number,
  ) {
    this.server = createServer((near) => this.pass(near));
  }

  async start(): Promise<number> {
    await new Promise<void>((resolve) => this.server.listen(0, '127.0.0.1', resolve));
    return (this.server.address() as AddressInfo).port;
  }

  stop(): void {
    for (const socket of this.sockets) socket.destroy();
    this.server.close();
  }

  private pass(near: Socket): void {
    const far = connect(this.port, '127.0.0.1');
    let free = 0;
    for (const socket of [near, far]) {
      this.sockets.add(socket.setNoDelay(true));
      socket.on('error', () => undefined);
      socket.on('close', () => {
        near.destroy();
        far.destroy();
      });
    }
    near.on('data', (data) => far.write(data));
    far.on('data', (data) => {
      // In packets, as links do it: what comes first is there first.
      far.pause();
      for (let at = 0; at < data.length; at += PACKET_BYTES) {
        const packet = data.subarray(at, at + PACKET_BYTES);
        free = Math.max(free, performance.now()) + (packet.length / this.bytesPerSecond) * 1000;
        setTimeout(() => near.write(packet), free - performance.now());
      }
      setTimeout(() => far.resume(), free - performance.now());
    });
  }
}

test('over a slow link pictures come as video, more of them than JPEG would give, and the one at rest is exact', async (t) => {
  const serve = await Serve.start(await makeWorld(), 'serve-video', '--size', '640x360', '--fps', '20');
  const link = new SlowLink(Number(new URL(serve.address).port), 120_000);
  const port = await link.start();
  const { page, complaints } = await open(browser, `http://127.0.0.1:${port}/`, { viewport: { width: 900, height: 640 } });
  await until('the first picture', () => page.evaluate(() => window.terravision.frame() !== null), 90);
  await page.locator('main').focus();
  await page.keyboard.down('Shift');
  await page.keyboard.down('ArrowRight');
  await until('pictures are video', async () => (await kindOn(page)) === 'h264', 40);
  assert.equal((await serve.pids('ffmpeg')).length, 1);
  const before = await page.evaluate(() => window.terravision.frame()!.n);
  await page.waitForTimeout(3000);
  const rate = ((await page.evaluate(() => window.terravision.frame()!.n)) - before) / 3;
  t.diagnostic(`${rate.toFixed(1)} pictures a second over 120 kB/s`);
  await page.keyboard.up('ArrowRight');
  await page.keyboard.up('Shift');
  await page.evaluate(() => window.terravision.settled());
  assert.equal(await kindOn(page), 'png');
  await page.context().close();
  await until('the encoder has ended with its client', async () => (await serve.pids('ffmpeg')).length === 0);
  assert.deepEqual(complaints, []);
  link.stop();
  await serve.stop();
});

const kindOn = (page: Page): Promise<string> => page.evaluate(() => window.terravision.frame()!.kind);

import assert from 'node:assert/strict';
import { execFile, spawn, type ChildProcess } from 'node:child_process';
import { createWriteStream, existsSync } from 'node:fs';
import { mkdir, readdir, readFile, rename, rm } from 'node:fs/promises';
import { join } from 'node:path';
import { createInterface } from 'node:readline';
import { promisify } from 'node:util';
import { OUT, ROOT } from './browser';

const run = promisify(execFile);
const PROGRAM = process.env.TERRAVISION_PROGRAM ?? join(process.env.CARGO_TARGET_DIR ?? join(ROOT, 'target'), 'debug', 'terravision');

/** Runs `terravision` to its end; its standard output. */
export async function terravision(...args: string[]): Promise<string> {
  const { stdout } = await run(PROGRAM, args, { timeout: 180_000, maxBuffer: 1 << 26 });
  return stdout;
}

/** A synthetic mountain world, made once. */
export async function makeWorld(): Promise<string> {
  const world = join(OUT, 'mountains.tv');
  if (existsSync(join(world, 'manifest.json'))) return world;
  await mkdir(OUT, { recursive: true });
  const [source, made] = [join(OUT, `source-${process.pid}`), join(OUT, `made-${process.pid}.tv`)];
  await terravision('synth', '-o', source, '--size', '1024', '--overwrite');
  await terravision('ingest', '--elevation', join(source, 'dem.tif'), '--color', join(source, 'ortho.tif'), '-o', made, '--overwrite');
  await rename(made, world).catch((error: unknown) => {
    // Another test file was faster.
    if (!existsSync(join(world, 'manifest.json'))) throw error;
  });
  await rm(source, { recursive: true, force: true });
  return world;
}

/** A running `terravision serve`. */
export class Serve {
  private constructor(
    private readonly child: ChildProcess,
    readonly address: string,
  ) {}

  static async start(world: string, name: string, ...flags: string[]): Promise<Serve> {
    const child = spawn(PROGRAM, ['serve', world, ...(flags.includes('--addr') ? [] : ['--addr', '127.0.0.1:0']), ...flags], { stdio: ['ignore', 'pipe', 'pipe'] });
    const log = createWriteStream(join(OUT, `${name}.log`));
    child.stderr!.pipe(log);
    const first = await new Promise<string>((resolve, reject) => {
      createInterface({ input: child.stdout! }).once('line', resolve);
      child.once('error', reject);
      child.once('exit', (code) => reject(new Error(`serve ended with ${code}: see ${name}.log in ${OUT}`)));
      setTimeout(() => reject(new Error('serve printed no address within 60 s')), 60_000).unref();
    });
    assert.match(first, /^http:\/\//);
    return new Serve(child, first.trim());
  }

  /** Process ids of the programs below `serve` that have a name. */
  async pids(name: string): Promise<number[]> {
    const found: number[] = [];
    const parents = new Map<number, { parent: number; name: string }>();
    for (const entry of await readdir('/proc')) {
      if (!/^\d+$/.test(entry)) continue;
      const stat = await readFile(`/proc/${entry}/stat`, 'utf8').catch(() => '');
      const close = stat.lastIndexOf(')');
      if (close < 0) continue;
      const command = await readFile(`/proc/${entry}/cmdline`, 'utf8').catch(() => '');
      parents.set(Number(entry), { parent: Number(stat.slice(close + 2).split(' ')[1]), name: command.split('\0')[0]! });
    }
    for (const [pid, process] of parents) {
      if (!process.name.endsWith(name)) continue;
      let above: number | undefined = pid;
      while (above !== undefined && above !== this.child.pid && above > 1) above = parents.get(above)?.parent;
      if (above === this.child.pid) found.push(pid);
    }
    return found;
  }

  async stop(): Promise<void> {
    await this.end('SIGINT');
  }

  async kill(): Promise<void> {
    await this.end('SIGKILL');
  }

  private async end(signal: NodeJS.Signals): Promise<void> {
    if (this.child.exitCode !== null || this.child.signalCode !== null) return;
    const ended = new Promise((resolve) => this.child.once('exit', resolve));
    this.child.kill(signal);
    await ended;
  }
}

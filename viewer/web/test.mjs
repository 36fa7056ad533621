// Runs tests with node's own runner: `node test.mjs unit|browser [NAME …]`. They are TypeScript, so they are bundled first.
import { build } from 'esbuild';
import { spawn } from 'node:child_process';
import { readdir, rm } from 'node:fs/promises';
import { dirname, join } from 'node:path';
import { fileURLToPath } from 'node:url';

const here = dirname(fileURLToPath(import.meta.url));
const [kind, ...names] = process.argv.slice(2);
if (kind !== 'unit' && kind !== 'browser') {
  console.error('usage: node test.mjs unit|browser [NAME …]');
  process.exit(2);
}

const folder = join(here, 'tests', kind);
const files = (await readdir(folder)).filter((file) => file.endsWith('.test.ts'));
const chosen = names.length === 0 ? files : files.filter((file) => names.includes(file.replace('.test.ts', '')));
if (chosen.length === 0) {
  console.error(`no test of this name in ${folder}: there are ${files.map((file) => file.replace('.test.ts', '')).join(', ')}`);
  process.exit(2);
}

// Below node_modules, so that packages are found from there.
const built = join(here, 'node_modules', '.tests', kind);
await rm(built, { recursive: true, force: true });
await build({
  absWorkingDir: here,
  entryPoints: chosen.map((file) => join(folder, file)),
  outdir: built,
  outExtension: { '.js': '.mjs' },
  bundle: true,
  packages: 'external',
  platform: 'node',
  format: 'esm',
  target: 'node18',
  sourcemap: 'inline',
  logLevel: 'warning',
});
const outputs = chosen.map((file) => join(built, file.replace('.ts', '.mjs')));
// Browser tests one file after the other: each has a flight and a browser of its own.
const options = kind === 'browser' && process.versions.node.split('.')[0] >= 22 ? ['--test-concurrency=1'] : [];
const run = spawn(process.execPath, ['--enable-source-maps', '--test', ...options, ...outputs], { stdio: 'inherit', env: { ...process.env, TERRAVISION_WEB: here } });
run.on('exit', (code, signal) => process.exit(signal === null ? code : 1));

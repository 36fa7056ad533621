// Builds the page into a folder: `node build.mjs [FOLDER]`, dist if not given. The same sources give the same bytes.
import { build } from 'esbuild';
import { copyFile, mkdir, readFile } from 'node:fs/promises';
import { dirname, join } from 'node:path';
import { fileURLToPath } from 'node:url';

const here = dirname(fileURLToPath(import.meta.url));
const folder = process.argv[2] ?? join(here, 'dist');

await mkdir(folder, { recursive: true });
// The one library that is part of the page goes with its licence.
const licence = (await readFile(join(here, 'node_modules', 'preact', 'LICENSE'), 'utf8')).trim();
await build({
  absWorkingDir: here,
  entryPoints: { page: 'src/main.tsx' },
  outdir: folder,
  bundle: true,
  minify: true,
  format: 'iife',
  target: 'es2021',
  jsx: 'automatic',
  jsxImportSource: 'preact',
  legalComments: 'none',
  banner: { js: `/*! This page contains Preact (https://preactjs.com).\n${licence}\n*/` },
  charset: 'utf8',
  logLevel: 'warning',
});
await build({
  absWorkingDir: here,
  entryPoints: { page: 'src/page.css' },
  outdir: folder,
  bundle: true,
  minify: true,
  target: 'es2021',
  charset: 'utf8',
  logLevel: 'warning',
});
for (const file of ['index.html', 'icon.svg']) await copyFile(join(here, 'src', file), join(folder, file));

// Puts a .br and a .gz beside every file of dist that gets smaller by it, and fails where the first load is too large.
import { readdir, readFile, stat, writeFile } from "node:fs/promises";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { promisify } from "node:util";
import { brotliCompress, constants, gzip } from "node:zlib";

const LARGEST_FIRST_LOAD_BYTES = 1_000_000;
const dist = fileURLToPath(new URL("../dist", import.meta.url));
const packed = /\.(br|gz)$/;

const names = (await readdir(dist, { recursive: true })).filter((name) => !packed.test(name));
const files = [];
for (const name of names) {
  const path = join(dist, name);
  if (!(await stat(path)).isFile()) continue;
  const bytes = await readFile(path);
  const brotli = await promisify(brotliCompress)(bytes, { params: { [constants.BROTLI_PARAM_QUALITY]: 11 } });
  const zipped = await promisify(gzip)(bytes, { level: 9 });
  if (zipped.length < bytes.length && !name.endsWith(".png")) {
    await writeFile(`${path}.br`, brotli);
    await writeFile(`${path}.gz`, zipped);
  }
  files.push({ name, bytes: bytes.length, zipped: Math.min(zipped.length, bytes.length) });
}
// All that a visit of both pages loads, gzipped: the component for other sites is no part of it.
const first = files.filter((file) => !file.name.startsWith("embed/")).reduce((sum, file) => sum + file.zipped, 0);
for (const file of files) console.log(`${String(file.bytes).padStart(9)} ${String(file.zipped).padStart(8)} gzipped  ${file.name}`);
console.log(`first load: ${first} bytes gzipped`);
if (first > LARGEST_FIRST_LOAD_BYTES) {
  console.error(`the first load must not exceed ${LARGEST_FIRST_LOAD_BYTES} bytes`);
  process.exit(1);
}

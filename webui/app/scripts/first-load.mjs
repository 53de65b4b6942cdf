// What the first page costs over the network, compressed: the document, everything it loads before it can be
// used, and the characters of the alphabet. More than the limit fails the check.
import { readFileSync, statSync } from "node:fs";
import { join } from "node:path";
import { gzipSync } from "node:zlib";

const LIMIT_KB = 250;
const page = join(import.meta.dirname, "../../handover_web/page");
const manifest = JSON.parse(readFileSync(join(page, ".vite/manifest.json"), "utf8"));

const files = new Set(["index.html", "theme.js", "favicon.svg"]);
const follow = (name) => {
  const chunk = manifest[name];
  if (chunk === undefined || files.has(chunk.file)) return;
  files.add(chunk.file);
  for (const style of chunk.css ?? []) files.add(style);
  for (const asset of chunk.assets ?? []) {
    if (/inter-latin-wght-normal.*\.woff2$/.test(asset)) files.add(asset);
  }
  for (const imported of chunk.imports ?? []) follow(imported);
};
follow("index.html");

let total = 0;
for (const file of files) {
  const path = join(page, file);
  const bytes = file.endsWith(".woff2") ? statSync(path).size : gzipSync(readFileSync(path), { level: 9 }).length;
  total += bytes;
  console.log(`${(bytes / 1000).toFixed(1).padStart(8)} kB  ${file}`);
}
console.log(`${(total / 1000).toFixed(1).padStart(8)} kB  first load, at most ${LIMIT_KB} kB`);
if (total > LIMIT_KB * 1000) process.exit(1);

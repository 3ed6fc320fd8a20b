// Stores DICOM files with dicomweb-client (STOW-RS), all in one request, and prints as JSON what came back.
// usage: node store.mjs URL FILE...   (URL is the root of the DICOMweb service)
// `status` is that of the HTTP answer; `answer` is what the client resolved with, or, where it `rejected`, the error's response.
// Exit status 2 when the client is not installed (npm ci in this folder).
import { readFile } from "node:fs/promises";

let api;
try {
  // Made for browsers: it finds their XMLHttpRequest as a global.
  globalThis.XMLHttpRequest = (await import("xhr2")).default;
  ({ api } = (await import("dicomweb-client")).default);
} catch {
  console.error("dicomweb-client is not installed: run npm ci in tests/tools");
  process.exit(2);
}
const [url, ...files] = process.argv.slice(2);
const datasets = [];
for (const file of files) datasets.push(new Uint8Array(await readFile(file)).buffer);
let sent;
// The client takes hooks with two parameters only.
const keep = (request, _metadata) => (sent = request);
let rejected = false;
let answer;
try {
  answer = await new api.DICOMwebClient({ url, requestHooks: [keep] }).storeInstances({ datasets });
} catch (error) {
  if (error.status === undefined) throw error;
  rejected = true;
  answer = error.response;
}
console.log(JSON.stringify({ status: sent.status, rejected, answer: JSON.parse(answer) }));

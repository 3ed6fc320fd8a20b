// Validates the JSON files given after the first argument, a JSON Schema (2020-12), against it, and prints the findings as JSON, one line a file.
// The schema itself must be one, without keywords that the validator does not know.
// Exit status: 0 without errors, 1 with any, 2 when the validator is not installed (npm ci in this folder).
import { readFile } from "node:fs/promises";

let Ajv2020;
try {
  ({ Ajv2020 } = await import("ajv/dist/2020.js"));
} catch {
  console.error("ajv is not installed: run npm ci in tests/tools");
  process.exit(2);
}
const [schema, ...files] = process.argv.slice(2);
const read = async (file) => JSON.parse(await readFile(file, "utf8"));
const validate = new Ajv2020({ allErrors: true, strict: true, allowUnionTypes: true }).compile(await read(schema));
let sound = true;
for (const file of files) {
  const valid = validate(await read(file));
  sound &&= valid;
  const messages = (validate.errors ?? []).map(({ instancePath, message, params }) => ({ instancePath, message, params }));
  console.log(JSON.stringify({ file, valid, messages }));
}
process.exit(sound ? 0 : 1);

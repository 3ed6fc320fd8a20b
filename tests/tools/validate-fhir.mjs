// Validates FHIR resources in the JSON files given as arguments against the published R4 (4.0.1) definitions, members that these do not know
// included, and prints the findings as JSON, one line a file.
// Exit status: 0 without errors, 1 with any, 2 when the validator is not installed (npm ci in this folder).
import { readFile } from "node:fs/promises";

let Fhir;
try {
  ({ Fhir } = (await import("fhir")).default);
} catch {
  console.error("fhir is not installed: run npm ci in tests/tools");
  process.exit(2);
}
let sound = true;
for (const file of process.argv.slice(2)) {
  const { valid, messages } = new Fhir().validate(JSON.parse(await readFile(file, "utf8")), { errorOnUnexpected: true });
  sound &&= valid;
  console.log(JSON.stringify({ file, valid, messages }));
}
process.exit(sound ? 0 : 1);

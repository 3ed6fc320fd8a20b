// Runs the Khronos glTF validator on the files given as arguments and prints its findings as JSON, one line a file.
// Exit status: 0 without errors and warnings, 1 with any, 2 when the validator is not installed (npm ci in this folder).
import { readFile } from "node:fs/promises";

let validator;
try {
  validator = (await import("gltf-validator")).default;
} catch {
  console.error("gltf-validator is not installed: run npm ci in tests/tools");
  process.exit(2);
}
let sound = true;
for (const file of process.argv.slice(2)) {
  const bytes = new Uint8Array(await readFile(file));
  const { issues, info } = await validator.validateBytes(bytes, { format: "glb", maxIssues: 20 });
  sound &&= issues.numErrors === 0 && issues.numWarnings === 0;
  const { numErrors: errors, numWarnings: warnings, numInfos: infos, numHints: hints, messages } = issues;
  const { animationCount: animations, hasMorphTargets: morph_targets, totalVertexCount: vertices } = info;
  console.log(JSON.stringify({ file, errors, warnings, infos, hints, animations, morph_targets, vertices, messages }));
}
process.exit(sound ? 0 : 1);

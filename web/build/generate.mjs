// Writes the types of the client from the contract; with --check only says whether they are those.
import { readFile, writeFile } from "node:fs/promises";
import openapi, { astToString, COMMENT_HEADER } from "openapi-typescript";

const contract = new URL("../../openapi/openapi.json", import.meta.url);
const types = new URL("../client/src/schema.ts", import.meta.url);

const generated = COMMENT_HEADER + astToString(await openapi(JSON.parse(await readFile(contract, "utf8")), { defaultNonNullable: false }));
if (process.argv.includes("--check")) {
  if ((await readFile(types, "utf8")) !== generated) {
    console.error("web/client/src/schema.ts is not what openapi/openapi.json says: run `npm run generate:client` in web/");
    process.exit(1);
  }
} else {
  await writeFile(types, generated);
}

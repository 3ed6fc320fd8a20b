// Compares the bills of materials in a folder with what they should list, and gives them the time of SOURCE_DATE_EPOCH and a serial number made of
// their content: crates.txt (a name and a version a line) for the program, web/package-lock.json for the pages.
import { createHash } from "node:crypto";
import { existsSync, readFileSync, writeFileSync } from "node:fs";

const folder = process.argv[2];
const time = new Date(Number(process.env.SOURCE_DATE_EPOCH ?? 0) * 1000).toISOString();
let missing = 0;

function check(name, expected) {
  const path = `${folder}/${name}`;
  // References name the directory of the sources; the bill is the same wherever it is made.
  const bill = JSON.parse(readFileSync(path, "utf8").replaceAll(`path+file://${process.cwd()}`, "path+file:///ventricle"));
  if (bill.bomFormat !== "CycloneDX" || !bill.specVersion) throw new Error(`${name} is no CycloneDX document`);
  const listed = new Set(bill.components.map((component) => `${component.purl?.replace(/^pkg:\w+\//, "").replace(/[?#].*$/, "")}`));
  for (const entry of expected.filter((entry) => !listed.has(entry))) {
    console.log(`${name} does not list ${entry}`);
    missing += 1;
  }
  for (const component of bill.components.filter((component) => !component.purl || !component.version)) {
    console.log(`${name}: ${component.name} has no package URL or no version`);
    missing += 1;
  }
  bill.metadata.timestamp = time;
  delete bill.serialNumber;
  const digest = createHash("sha256").update(JSON.stringify(bill)).digest("hex");
  // A UUID of version 8: made of what one likes.
  const uuid = `${digest.slice(0, 8)}-${digest.slice(8, 12)}-8${digest.slice(13, 16)}-a${digest.slice(17, 20)}-${digest.slice(20, 32)}`;
  writeFileSync(path, JSON.stringify({ ...bill, serialNumber: `urn:uuid:${uuid}` }, null, 1) + "\n");
  console.log(`${path}: ${bill.components.length} components, ${expected.length} expected`);
}

const crates = readFileSync(`${folder}/crates.txt`, "utf8").trim().split("\n").map((line) => line.split(" "));
check("ventricle.cdx.json", crates.filter(([name]) => name !== "ventricle").map(([name, version]) => `${name}@${version}`));
if (existsSync(`${folder}/ventricle-web.cdx.json`)) {
  const lock = JSON.parse(readFileSync("web/package-lock.json", "utf8"));
  const packages = Object.entries(lock.packages).filter(([path, entry]) => path.startsWith("node_modules/") && !entry.dev && !entry.link && !entry.optional);
  check("ventricle-web.cdx.json", packages.map(([path, { version }]) => `${path.replace(/^.*node_modules\//, "").replace(/^@/, "%40")}@${version}`));
}
process.exit(missing ? 1 : 0);

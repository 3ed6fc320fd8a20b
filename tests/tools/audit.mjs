// Reads what `npm audit --json` said (standard input) and says what of it stands: every advisory that is not excepted by name, with a reason and a
// day until which it holds. Arguments: the file of exceptions, what was audited, and the day (today, if none is given).
// Status 0: nothing stands; 1: something does; 3: the registry gave no answer.
import { readFileSync } from "node:fs";

const [exceptionsFile, what, day = new Date().toISOString().slice(0, 10)] = process.argv.slice(2);
const exceptions = JSON.parse(readFileSync(exceptionsFile, "utf8"));
for (const { advisory, reason, until } of exceptions) {
  if (!/^GHSA-/.test(advisory ?? "") || !reason || !/^\d{4}-\d{2}-\d{2}$/.test(until ?? "")) {
    console.log(`${exceptionsFile}: each exception needs an advisory (GHSA-…), a reason and a day (until)`);
    process.exit(1);
  }
}

let said;
try {
  said = JSON.parse(readFileSync(0, "utf8"));
} catch {
  said = {};
}
if (!said.vulnerabilities) {
  console.log(`not checked: advisories of ${what}, as the registry does not answer (${said.message ?? "no JSON"})`);
  process.exit(3);
}

// An advisory stands under the package that has it; packages above it name that package only.
const advisories = new Map();
for (const { via } of Object.values(said.vulnerabilities)) {
  for (const cause of via.filter((cause) => typeof cause === "object")) {
    const id = cause.url?.match(/GHSA-[\w-]+/)?.[0] ?? `of ${cause.name}`;
    advisories.set(id, `${id} (${cause.severity}) ${cause.name} ${cause.range}: ${cause.title}`);
  }
}
const standing = [...advisories].filter(([id]) => !exceptions.some(({ advisory, until }) => advisory === id && day <= until));
for (const [id, line] of standing) {
  const expired = exceptions.find(({ advisory }) => advisory === id);
  console.log(line + (expired ? `; its exception ended on ${expired.until}` : ""));
}
if (standing.length) process.exit(1);
const excepted = advisories.size ? `, ${advisories.size} excepted` : "";
console.log(`advisories of ${what} ok${excepted}`);

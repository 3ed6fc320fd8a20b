import { de } from "./de.ts";
import { en } from "./en.ts";
import { es } from "./es.ts";

/** What can be said. */
export type Key = keyof typeof en;
/** A language says all of it: what is missing is a type error. */
export type Table = Readonly<Record<Key, string>>;
/** The languages. */
export type Language = keyof typeof TABLES;

const TABLES = { en, de, es } satisfies Record<string, Table>;
const KEPT_UNDER = "ventricle.language";

/** The languages by the names that their speakers give them. */
export const LANGUAGES: readonly (readonly [Language, string])[] = [
  ["en", "English"],
  ["de", "Deutsch"],
  ["es", "Español"],
];

let current: Language = "en";

/** The language in use. */
export function language(): Language {
  return current;
}

/** Takes the language that was chosen before, else the first of the browser's that there is. */
export function detectLanguage(): void {
  const wishes = [kept(), ...navigator.languages.map((tag) => tag.split("-")[0] ?? "")];
  use(wishes.find(isLanguage) ?? "en");
}

/** Uses a language from now on. */
export function chooseLanguage(chosen: Language): void {
  try {
    localStorage.setItem(KEPT_UNDER, chosen);
  } catch {
    // A browser that keeps nothing still shows it.
  }
  use(chosen);
}

/** A text in the language in use. */
export function t(key: Key, values: Readonly<Record<string, string | number>> = {}): string {
  return TABLES[current][key].replace(/\{(\w+)\}/g, (whole, name: string) => String(values[name] ?? whole));
}

/** A text for a code of the service that may be newer than this page; the code in words where there is none. */
export function told(prefix: string, code: string): string {
  const key = `${prefix}.${code}`;
  if (key in en) return t(key as Key);
  const words = code.replaceAll("_", " ");
  return words.charAt(0).toUpperCase() + words.slice(1);
}

/** A number in the language in use. */
export function number(value: number, decimals = 0): string {
  return new Intl.NumberFormat(current, { minimumFractionDigits: decimals, maximumFractionDigits: decimals }).format(value === 0 ? 0 : value);
}

/** A point in time in the language in use. */
export function moment(rfc3339: string): string {
  return new Intl.DateTimeFormat(current, { dateStyle: "medium", timeStyle: "short" }).format(new Date(rfc3339));
}

export function isLanguage(tag: string | null): tag is Language {
  return tag !== null && tag in TABLES;
}

function use(chosen: Language): void {
  current = chosen;
  document.documentElement.lang = chosen;
}

function kept(): string | null {
  try {
    return localStorage.getItem(KEPT_UNDER);
  } catch {
    return null;
  }
}

import { ProblemError } from "../../client/src/index.ts";
import { en } from "../languages/en.ts";
import { number, t, told } from "../languages/index.ts";
import { type Child, h } from "./dom.ts";

type ToldProblem = ProblemError["problem"];

/** Says what went wrong in words, and what can be done now. */
export function troubleOf(error: unknown, actions: Child[] = [], title?: string): HTMLElement {
  if (error instanceof ProblemError && !isUnreachable(error)) return problemBox(error.problem, actions, title, error.retryAfterSeconds);
  const [head, detail] = isUnreachable(error)
    ? [t("trouble.unreachable"), t("trouble.unreachable.detail")]
    : [t("trouble.failed"), error instanceof Error ? error.message : String(error)];
  return box(title ?? head, [title === undefined ? null : h("p", {}, head), h("p", {}, detail)], actions);
}

/** A problem document in words. */
export function problemBox(problem: ToldProblem, actions: Child[] = [], title?: string, retryAfterSeconds: number | null = null): HTMLElement {
  const known = `code.${problem.code}` in en;
  const head = known ? told("code", problem.code) : problem.title;
  const advice = `code.${problem.code}.do` in en ? told("code", `${problem.code}.do`) : null;
  return box(
    title ?? head,
    [
      title === undefined || !known ? null : h("p", {}, head),
      // The service's own sentences are English.
      h("p", { lang: "en" }, problem.detail),
      problem.errors !== undefined && problem.errors.length > 0
        ? h("ul", { lang: "en" }, ...problem.errors.map((complaint) => h("li", {}, Object.values(complaint).join(": "))))
        : null,
      advice === null ? null : h("p", {}, advice),
      retryAfterSeconds === null ? null : h("p", {}, t("trouble.retryAfter", { seconds: number(retryAfterSeconds) })),
      problem.request_id === undefined ? null : h("p", { class: "faint" }, t("trouble.request", { id: problem.request_id })),
    ],
    actions,
  );
}

/** Trouble that is told by a heading and sentences of this page. */
export function box(title: string, parts: Child[], actions: Child[]): HTMLElement {
  return h(
    "div",
    { class: "trouble", role: "alert" },
    h("h3", {}, title),
    ...parts,
    actions.length > 0 ? h("div", { class: "actions" }, ...actions) : null,
  );
}

/** Whether no answer came at all. */
export function isUnreachable(error: unknown): boolean {
  return error instanceof TypeError || (error instanceof ProblemError && [502, 504].includes(error.status) && error.code === "unknown");
}

/** Whether a request was given up by the page itself. */
export function isAborted(error: unknown): boolean {
  return error instanceof DOMException && error.name === "AbortError";
}

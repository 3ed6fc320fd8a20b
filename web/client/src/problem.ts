import type { Problem } from "./types.ts";

/** The service refused a request, or a reconstruction failed. Its message is the problem's sentence for people; branch on `code`. */
export class ProblemError extends Error {
  override readonly name = "ProblemError";
  /** Stable snake_case name of the reason. */
  readonly code: string;
  /** HTTP status. */
  readonly status: number;
  /** The whole document. */
  readonly problem: Problem;
  /** When trying again is worth it, in seconds, where the service says so. */
  readonly retryAfterSeconds: number | null;

  constructor(problem: Problem, retryAfterSeconds: number | null = null) {
    super(problem.detail);
    this.code = problem.code;
    this.status = problem.status;
    this.problem = problem;
    this.retryAfterSeconds = retryAfterSeconds;
  }
}

/** The error of an answer that is not 2xx, whatever it has for a body: a proxy's page becomes a problem too. */
export function problemOf(status: number, body: unknown, retryAfter: string | null = null): ProblemError {
  const seconds = retryAfter === null ? null : Number.parseInt(retryAfter, 10);
  const retryAfterSeconds = seconds === null || Number.isNaN(seconds) ? null : seconds;
  if (isProblem(body)) return new ProblemError(body, retryAfterSeconds);
  const detail = `The answer was ${status} and not from Ventricle itself: something between refused the request.`;
  return new ProblemError({ type: "about:blank", title: `Status ${status}`, status, code: "unknown", detail }, retryAfterSeconds);
}

function isProblem(body: unknown): body is Problem {
  return typeof body === "object" && body !== null && "code" in body && "detail" in body && "title" in body;
}

import createFetchClient, { type Client as FetchClient } from "openapi-fetch";
import { problemOf } from "./problem.ts";
import { reconstruct, type Reconstruction, type ReconstructOptions } from "./reconstruct.ts";
import type { paths } from "./schema.ts";

/** Every path of the contract, typed, and the whole way from a file to its report in one call. */
export interface Client {
  /** Where the service is, without a slash at the end; empty for the page's own origin. */
  readonly baseUrl: string;
  /** The contract's operations: `api.GET("/v1/reconstructions/{id}", …)`. An answer that is not 2xx throws a `ProblemError`. */
  readonly api: FetchClient<paths>;
  /** Posts a study and follows it to its report. */
  reconstruct(file: Blob | readonly Blob[], options?: ReconstructOptions): AsyncIterable<Reconstruction>;
}

/** How to reach a service. */
export interface ClientOptions {
  /** Headers of every request, as `Authorization` with a key or token. */
  headers?: Record<string, string>;
  /** Instead of the global `fetch`. */
  fetch?: (request: Request) => Promise<Response>;
}

/** A client of the service at this address. */
export function createClient(baseUrl = "", options: ClientOptions = {}): Client {
  const base = baseUrl.replace(/\/+$/, "");
  const api = createFetchClient<paths>({ baseUrl: base, ...options });
  api.use({
    async onResponse({ response }) {
      if (response.ok || response.status === 304) return undefined;
      const body: unknown = await response.json().catch(() => null);
      throw problemOf(response.status, body, response.headers.get("retry-after"));
    },
  });
  return { baseUrl: base, api, reconstruct: (file, more = {}) => reconstruct(api, file, more) };
}

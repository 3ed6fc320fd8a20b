import { createClient, type Job, type Parameters, problemOf, study } from "../../client/src/index.ts";

/** The service that serves this page. */
export const client = createClient(location.origin);

/** The JSON of an answer that is known to have one. */
export function body<T>(answer: { data?: T }): T {
  if (answer.data === undefined) throw new TypeError("The service answered without the JSON that its contract promises.");
  return answer.data;
}

/** The bytes at one of a job's links. */
export async function bytes(path: string, signal: AbortSignal): Promise<ArrayBuffer> {
  const answer = await fetch(path, { signal });
  if (!answer.ok) throw problemOf(answer.status, await answer.json().catch(() => null), answer.headers.get("retry-after"));
  return answer.arrayBuffer();
}

/** Posts a study and tells which part of it is sent; `fetch` does not tell. */
export function upload(files: readonly Blob[], parameters: Parameters, sent: (part: number) => void, signal: AbortSignal): Promise<Job> {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", "/v1/reconstructions");
    request.responseType = "json";
    request.upload.onprogress = (event) => sent(event.lengthComputable ? event.loaded / event.total : 0);
    request.onload = () => {
      if (request.status >= 200 && request.status < 300) resolve(request.response as Job);
      else reject(problemOf(request.status, request.response, request.getResponseHeader("retry-after")));
    };
    request.onerror = () => reject(new TypeError("no answer"));
    request.onabort = () => reject(new DOMException("aborted", "AbortError"));
    signal.addEventListener("abort", () => request.abort());
    request.send(study(files, parameters).body);
  });
}

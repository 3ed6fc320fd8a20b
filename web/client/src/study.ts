import type { Parameters } from "./types.ts";

/** What a study is posted as. */
export interface Study {
  body: Blob | FormData;
  /** Null where the browser has to set it, with the boundary. */
  contentType: string | null;
}

/** One file without parameters goes as it is and is told by its content; several instances, or parameters, make a form. */
export function study(file: Blob | readonly Blob[], parameters?: Parameters): Study {
  const files = file instanceof Blob ? [file] : file;
  const [only] = files;
  if (files.length === 1 && only !== undefined && parameters === undefined) {
    return { body: only, contentType: "application/octet-stream" };
  }
  const form = new FormData();
  for (const one of files) form.append("file", one);
  if (parameters !== undefined) form.append("parameters", new Blob([JSON.stringify(parameters)], { type: "application/json" }));
  return { body: form, contentType: null };
}

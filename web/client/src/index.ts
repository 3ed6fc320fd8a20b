export { createClient, type Client, type ClientOptions } from "./client.ts";
export { problemOf, ProblemError } from "./problem.ts";
export type { Reconstruction, ReconstructOptions } from "./reconstruct.ts";
export type { components, operations, paths } from "./schema.ts";
export { study, type Study } from "./study.ts";
export type { Job, Parameters, PolarMaps, Problem, Report, Slices } from "./types.ts";

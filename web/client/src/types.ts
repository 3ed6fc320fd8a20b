import type { components } from "./schema.ts";

type Schemas = components["schemas"];

/** A reconstruction and how far it is. */
export type Job = Schemas["Job"];
/** What a successful reconstruction says: volumes, function, wall, quality. */
export type Report = Schemas["Report"];
/** How to reconstruct; everything is optional. */
export type Parameters = Schemas["Parameters"];
/** Polar maps of the wall as numbers. */
export type PolarMaps = Schemas["PolarMaps"];
/** Where slices lie and what the surfaces cut out of them. */
export type Slices = Schemas["Slices"];
/** Why something was refused or failed (RFC 9457). */
export type Problem = Schemas["Problem"];

/**
 * Files that are one study: the DICOM instances of one series, by their Series Instance UID; every other file on its own. The headers are
 * read here because only the person's machine has them all at once.
 */
export async function bySeries(files: readonly File[]): Promise<File[][]> {
  const groups = new Map<string, File[]>();
  for (const [index, file] of files.entries()) {
    const header = new DataView(await file.slice(0, HEADER_BYTES).arrayBuffer());
    const key = seriesOf(header) ?? `file ${index}`;
    groups.set(key, [...(groups.get(key) ?? []), file]);
  }
  return [...groups.values()];
}

/** The series' UID stands in group 0020, before the pixels; what is before it is small. */
const HEADER_BYTES = 131_072;
const SERIES = 0x0020_000e;
const TRANSFER_SYNTAX = 0x0002_0010;
const IMPLICIT = "1.2.840.10008.1.2";
const BIG_ENDIAN = "1.2.840.10008.1.2.2";
const DEFLATED = "1.2.840.10008.1.2.1.99";
const UNDEFINED_LENGTH = 0xffff_ffff;
/** Items and sequences, whose contents are walked through, and what ends them. */
const ITEM = 0xfffe_e000;
const ENDS = [0xfffe_e00d, 0xfffe_e0dd];
/** Value representations with a length of four bytes (PS3.5 section 7.1.2). */
const LONG = ["OB", "OD", "OF", "OL", "OV", "OW", "SQ", "SV", "UC", "UN", "UR", "UT", "UV"];

/** The Series Instance UID of a DICOM file's beginning; null where it has none or is read otherwise. */
export function seriesOf(header: DataView): string | null {
  try {
    return text(header, 128, 4) === "DICM" ? walk(header) : null;
  } catch (error) {
    // The header ends within the bytes, or is damaged: the service says so.
    if (error instanceof RangeError) return null;
    throw error;
  }
}

function walk(header: DataView): string | null {
  let at = 132;
  let syntax = "";
  // Where the open sequences and items end; those of undefined length end at a mark.
  const open: number[] = [];
  while (at < header.byteLength) {
    while (open.length > 0 && at >= (open.at(-1) ?? Infinity)) open.pop();
    const tag = header.getUint16(at, true) * 65_536 + header.getUint16(at + 2, true);
    const isMeta = tag < 0x0003_0000;
    if (!isMeta && (syntax === BIG_ENDIAN || syntax === DEFLATED)) return null;
    if (tag === ITEM || ENDS.includes(tag)) {
      const length = header.getUint32(at + 4, true);
      at += 8;
      if (tag === ITEM) open.push(length === UNDEFINED_LENGTH ? Infinity : at + length);
      else open.pop();
      continue;
    }
    const explicit = isMeta || syntax !== IMPLICIT;
    const kind = explicit ? text(header, at + 4, 2) : "";
    const long = !explicit || LONG.includes(kind);
    const start = at + (explicit && long ? 12 : 8);
    const length = long ? header.getUint32(start - 4, true) : header.getUint16(at + 6, true);
    if (tag === SERIES && open.length === 0) return text(header, start, length);
    if (tag > SERIES && open.length === 0) return null;
    if (tag === TRANSFER_SYNTAX) syntax = text(header, start, length);
    if (length === UNDEFINED_LENGTH) open.push(Infinity);
    at = length === UNDEFINED_LENGTH ? start : start + length;
  }
  return null;
}

function text(header: DataView, at: number, length: number): string {
  let result = "";
  for (let index = 0; index < length; index += 1) result += String.fromCharCode(header.getUint8(at + index));
  return result.replace(/[\0 ]+$/, "");
}

/** All files of a drop, those in folders too. Files of a folder that are no data (`.DS_Store`, `DICOMDIR`) are left out. */
export async function droppedFiles(dropped: DataTransfer): Promise<File[]> {
  // The items are gone after the first wait.
  const entries = [...dropped.items].map((item) => item.webkitGetAsEntry()).filter((entry) => entry !== null);
  if (entries.length === 0) return [...dropped.files].filter(isData);
  const files = await Promise.all(entries.map(filesOf));
  return files.flat().filter(isData);
}

/** Whether a file may be a part of a study. */
export function isData(file: File): boolean {
  return file.size > 0 && !file.name.startsWith(".") && file.name.toUpperCase() !== "DICOMDIR";
}

async function filesOf(entry: FileSystemEntry): Promise<File[]> {
  if (entry.isFile) return [await new Promise<File>((resolve, reject) => (entry as FileSystemFileEntry).file(resolve, reject))];
  const reader = (entry as FileSystemDirectoryEntry).createReader();
  const found: File[] = [];
  // A reader gives some entries at a time, and none at the end.
  for (;;) {
    const some = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, reject));
    if (some.length === 0) return found;
    for (const inner of some) found.push(...(await filesOf(inner)));
  }
}

import { defineConfig } from "vite";

// The web component for other sites: one file of a fixed name with all that it needs.
export default defineConfig({
  publicDir: false,
  build: {
    target: "es2022",
    outDir: "dist/embed",
    emptyOutDir: true,
    lib: { entry: "src/embed/element.ts", formats: ["es"], fileName: () => "ventricle-viewer.js" },
    chunkSizeWarningLimit: 1000,
    license: { fileName: "licenses.md" },
  },
});

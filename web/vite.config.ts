import { defineConfig } from "vite";

// The pages. Everything but the index has its hash in its name, so that it can be kept for ever.
export default defineConfig({
  base: "/",
  publicDir: "public",
  build: {
    target: "es2022",
    outDir: "dist",
    emptyOutDir: true,
    // A data URL in a style sheet would need another source in the Content-Security-Policy.
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    chunkSizeWarningLimit: 1000,
    // What others wrote and is inside asks to be named.
    license: { fileName: "licenses.md" },
  },
  server: { proxy: { "/v1": process.env.VENTRICLE_URL ?? "http://127.0.0.1:8080" } },
});

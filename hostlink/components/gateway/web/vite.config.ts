import { defineConfig } from "vite";

// The files lie beside index.html under web/, the folder that the server serves; their names never change, because the
// server forbids to keep them.
export default defineConfig({
  base: "./",
  build: {
    outDir: "built",
    emptyOutDir: true,
    assetsDir: "web",
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    cssCodeSplit: false,
    rolldownOptions: {
      output: {
        codeSplitting: false,
        entryFileNames: "web/page.js",
        assetFileNames: "web/[name][extname]",
      },
    },
  },
});

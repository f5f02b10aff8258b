import { defineConfig } from "vite";

// Names without hashes: the server knows them from the start and tells browsers by tag what is new.
export default defineConfig({
  base: "./",
  build: {
    outDir: "../src/towtank/dashboard/static",
    emptyOutDir: true,
    target: "es2022",
    modulePreload: false,
    assetsInlineLimit: 0,
    rollupOptions: {
      output: { entryFileNames: "page.js", assetFileNames: "page[extname]", codeSplitting: false },
    },
  },
});

import react from "@vitejs/plugin-react";
import { fileURLToPath } from "node:url";
import { defineConfig } from "vitest/config";
import { compress } from "./scripts/compress.ts";

const served = `http://127.0.0.1:${process.env["HANDOVER_WEBUI_PORT"] ?? "54400"}`;

export default defineConfig({
  plugins: [react(), compress()],
  resolve: { alias: { "~": fileURLToPath(new URL("./src", import.meta.url)) } },
  // Beside `app`, where the wheel and the image carry it without the sources.
  build: { outDir: "../handover_web/page", emptyOutDir: true, manifest: true, target: "es2022", chunkSizeWarningLimit: 1200 },
  // `npm run dev` shows the page of a running `handover up` while it is being changed.
  server: { host: "127.0.0.1", proxy: { "/api": { target: served, ws: true } } },
  test: {
    restoreMocks: true,
    maxWorkers: "100%", // by default one core is left idle, which is half of a machine with two
    testTimeout: 60_000, // how long a test takes is no concern of it: others run beside it
    projects: [
      // A document is slow to make: only what is drawn is tested in one, and what says so itself.
      {
        extends: true,
        test: {
          name: "drawn",
          include: ["src/**/*.test.tsx"],
          benchmark: { include: ["src/**/*.bench.tsx"] },
          environment: "jsdom",
          setupFiles: ["src/testing/setup.ts"],
        },
      },
      // Tests without a document share their modules instead of loading them for each file.
      {
        extends: true,
        test: { name: "pure", include: ["src/**/*.test.ts"], benchmark: { include: ["src/**/*.bench.ts"] }, environment: "node", isolate: false },
      },
    ],
  },
});

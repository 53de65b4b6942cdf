import { cleanup } from "@testing-library/react";
import { afterEach } from "vitest";
import { queryClient } from "~/api/useServiceQuery";

afterEach(() => {
  cleanup();
  queryClient.clear();
});

// jsdom has no CSS object, and dialogs escape a selector when they open.
// eslint-disable-next-line @typescript-eslint/no-unnecessary-condition -- the types say that every browser has it
globalThis.CSS ??= { escape: (text: string) => text } as typeof CSS;

// jsdom has no media queries: a test sees the light theme.
// eslint-disable-next-line @typescript-eslint/no-unnecessary-condition -- the types say that every browser has it
globalThis.matchMedia ??= (media: string) => Object.assign(new EventTarget(), { matches: false, media }) as MediaQueryList;

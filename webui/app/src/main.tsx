/** The entry point: loads texts and theme, connects to the server and renders the pages. */
import { lazy, Suspense } from "react";
import { createRoot } from "react-dom/client";
import { eventsAfter } from "~/api/actions";
import { App } from "~/App";
import "~/design/base.css";
import { initI18n } from "~/i18n";
import { LiveConnection } from "~/live/connection";
import { Live } from "~/live/hooks";
import { LiveStore } from "~/live/store";
import { isSignedIn, loadSession } from "~/session/session";
import { initTheme } from "~/shell/theme";

const SignInPage = lazy(() => import("~/session/SignInPage"));

await loadSession();
const live = new LiveStore();
const scheme = location.protocol === "https:" ? "wss" : "ws";
const showsPage = isSignedIn();
if (showsPage) {
  new LiveConnection(live, {
    url: `${scheme}://${location.host}/api/live`,
    fetchEvents: eventsAfter,
    onClosed: () =>
      void loadSession().then(() => {
        if (!isSignedIn()) location.reload();
      }),
  });
}

initTheme();
await initI18n();

const root = document.getElementById("root");
if (root === null) throw new Error("index.html has no #root");
createRoot(root).render(
  <Live value={live}>
    {showsPage ? (
      <App />
    ) : (
      <Suspense fallback={null}>
        <SignInPage />
      </Suspense>
    )}
  </Live>,
);

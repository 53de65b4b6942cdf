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
import { UnknownAddress } from "~/route/choice";
import { isSignedIn, loadSession } from "~/session/session";
import { discardScans } from "~/shell/scans";
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

discardScans();
initTheme();
await initI18n();

const root = document.getElementById("root");
if (root === null) throw new Error("index.html has no #root");
// An address that names nothing is no fault of the page, which says so.
const onCaughtError = (error: unknown) => {
  if (!(error instanceof UnknownAddress)) reportError(error);
};
createRoot(root, { onCaughtError }).render(
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

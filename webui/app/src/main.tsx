/** The entry point: loads texts and theme, connects to the server and renders the pages. */
import { createRoot } from "react-dom/client";
import { eventsAfter } from "~/api/actions";
import { App } from "~/App";
import "~/design/base.css";
import { initI18n } from "~/i18n";
import { LiveConnection } from "~/live/connection";
import { Live } from "~/live/hooks";
import { LiveStore } from "~/live/store";
import { initTheme } from "~/shell/theme";

const live = new LiveStore();
const scheme = location.protocol === "https:" ? "wss" : "ws";
new LiveConnection(live, { url: `${scheme}://${location.host}/api/live`, fetchEvents: eventsAfter });

initTheme();
await initI18n();

const root = document.getElementById("root");
if (root === null) throw new Error("index.html has no #root");
createRoot(root).render(
  <Live value={live}>
    <App />
  </Live>,
);

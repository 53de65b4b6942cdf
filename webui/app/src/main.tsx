/** Where the page begins: words, theme, the link to the cell, then the pages. */
import { createRoot } from "react-dom/client";
import { eventsAfter } from "~/api/acts";
import { App } from "~/App";
import "~/design/base.css";
import { startWords } from "~/i18n";
import { Connection } from "~/live/connection";
import { Live } from "~/live/hooks";
import { LiveStore } from "~/live/store";
import { startTheme } from "~/shell/theme";

const live = new LiveStore();
const scheme = location.protocol === "https:" ? "wss" : "ws";
new Connection(live, { url: `${scheme}://${location.host}/api/live`, fetchEvents: eventsAfter });

startTheme();
await startWords();

const root = document.getElementById("root");
if (root === null) throw new Error("index.html has no #root");
createRoot(root).render(
  <Live value={live}>
    <App />
  </Live>,
);

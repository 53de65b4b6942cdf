/** People: gestures of the people at gloves, users and their rights, invitations, tokens, stations, sessions, the audit. */
import { useTranslation } from "react-i18next";
import { AccountsFrame } from "~/accounts/AccountsFrame";
import { AuditLogView } from "~/accounts/AuditView";
import { InvitationsView } from "~/accounts/InvitationsView";
import { OwnSessionsView } from "~/accounts/Sessions";
import { StationsView } from "~/accounts/StationsView";
import { TokensView } from "~/accounts/TokensView";
import { UsersView } from "~/accounts/UsersView";
import "~/accounts/accounts.css";
import { SegmentedControl } from "~/design/SegmentedControl";
import { useChoice } from "~/route/choice";
import { mayDo, useSession } from "~/session/session";
import { GesturesView } from "./GesturesView";
import "./PeoplePage.css";

const VIEWS = [
  { name: "gestures", permission: "read" },
  { name: "users", permission: "managePeople" },
  { name: "invitations", permission: "managePeople" },
  { name: "tokens", permission: "managePeople" },
  { name: "stations", permission: "configure" },
  { name: "audit", permission: "readAudit" },
  { name: "sessions", permission: null },
] as const;
type View = (typeof VIEWS)[number]["name"];
const VIEW_NAMES = VIEWS.map(({ name }) => name);

const contents: Record<View, () => React.JSX.Element> = {
  gestures: GesturesView,
  users: UsersView,
  invitations: InvitationsView,
  tokens: TokensView,
  stations: StationsView,
  audit: AuditLogView,
  sessions: OwnSessionsView,
};

export default function PeoplePage() {
  // Load `hand` with the page: a panel that loads it later would suspend the page and lose the focus.
  const { t } = useTranslation(["accounts", "people", "hand", "rights", "roles", "common"]);
  const [asked, setView] = useChoice<View>("view", VIEW_NAMES, "gestures");
  const { hasAccounts } = useSession();
  const view = VIEWS.find(({ name }) => name === asked) ?? VIEWS[0];
  const offered = VIEWS.filter(({ name, permission }) => name === view.name || (permission === null ? hasAccounts : mayDo(permission)));
  const Content = contents[view.name];
  return (
    <div className="people-page">
      <header className="people-page__head">
        <h1>{t("common:pages.people")}</h1>
        <SegmentedControl label={t("view.label")} value={view.name} options={offered.map(({ name }) => ({ value: name, name: t(`view.${name}`) }))} onChange={setView} />
      </header>
      {view.name === "gestures" ? (
        <Content />
      ) : (
        <AccountsFrame permission={view.permission} isLocalToo={view.name === "audit"}>
          <Content />
        </AccountsFrame>
      )}
    </div>
  );
}

/** Where Alerts are sent: channels with a test message, and routes with the question which Alert goes where. */
import { Mail, Route as RouteIcon, Send, Split } from "lucide-react";
import { useCallback, useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import type { AlertExample, RouteAnswer, Severity, TestResult } from "~/api/generated/alert-router";
import { errorText } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { Select } from "~/design/Select";
import { StatusBadge } from "~/design/StatusBadge";
import { mayDo } from "~/session/session";
import { deleteChannel, deleteRoute, ROUTER, routesOf, saveChannel, saveRoute, SEVERITIES, testChannel, type Channel, type ChannelView, type Route, type RouteView } from "./api";
import { draftOfChannel, draftOfRoute, enteredChannel, enteredRoute, fieldsOfChannel, fieldsOfRoute, typeOf } from "./route";
import { SettingForm } from "./SettingForm";
import { SettingsView } from "./SettingsView";

const SETTING = "HANDOVER_ALERT_ROUTES";

function useChannels() {
  return useServiceQuery<ChannelView[]>(ROUTER, mayDo("manageSettings") ? "channels" : null);
}

export function RoutesView() {
  const { t } = useTranslation("alerting");
  const routes = useServiceQuery<RouteView[]>(ROUTER, "routes");
  const { value: channels } = useChannels();
  const mayWrite = mayDo("manageSettings");
  const detailOf = useCallback(({ route }: RouteView) => t("routes.detail", { severity: t(`severity.${route.minimumSeverity ?? "informational"}`), channels: route.channels.join(", ") }), [t]);
  const stateOf = useCallback(
    ({ route }: RouteView) => {
      const word = route.enabled === false ? t("state.off") : t("state.on");
      return { word, badge: <StatusBadge tone={route.enabled === false ? "neutral" : "ok"}>{word}</StatusBadge> };
    },
    [t],
  );
  return (
    <>
      <SettingsView
        kind="routes"
        icon={<RouteIcon aria-hidden size={32} />}
        rows={mayWrite && channels === null ? null : routes.value}
        failure={routes.failure}
        mayAdd={mayWrite}
        detailOf={detailOf}
        stateOf={stateOf}
        show={(row, onDone) => (
          <RouteForm
            row={row}
            channels={(channels ?? []).map(({ name }) => name)}
            isFixed={row?.source === "file" ? t("form.inFile", { setting: SETTING }) : mayWrite ? null : t("form.mayNot")}
            onDone={(name) => {
              routes.reload();
              onDone(name);
            }}
          />
        )}
      />
      {routes.value !== null && routes.value.length > 0 && <WhichRoutes />}
    </>
  );
}

function RouteForm({ row, channels, isFixed, onDone }: { row: RouteView | null; channels: readonly string[]; isFixed: string | null; onDone: (name: string) => void }) {
  const { t } = useTranslation("alerting");
  const names = useMemo(() => [...new Set([...channels, ...(row?.route.channels ?? []), ...(row?.route.escalations ?? []).flatMap((one) => one.channels)])], [channels, row]);
  const fields = useMemo(() => fieldsOfRoute(t, names), [t, names]);
  const [draft, setDraft] = useState(() => draftOfRoute(fields, row?.route ?? null));
  return (
    <>
      {names.length === 0 && <p className="quiet">{t("routes.noChannels")}</p>}
      <SettingForm<Route>
        name={row?.name ?? null}
        isFixed={isFixed}
        fields={fields}
        draft={draft}
        onDraft={setDraft}
        read={() => {
          const { route, faults } = enteredRoute(fields, draft);
          return { value: route, faults };
        }}
        onSave={(name, route) => saveRoute(name, route).then(() => onDone(name))}
        onDelete={(name) => deleteRoute(name).then(() => onDone(""))}
        deleteMeans={t("routes.deleteMeans")}
      />
    </>
  );
}

/** Asks which routes an Alert would take now; nothing is sent. */
function WhichRoutes() {
  const { t } = useTranslation("alerting");
  const [severity, setSeverity] = useState<Severity>("high");
  const [category, setCategory] = useState("device");
  const [place, setPlace] = useState("");
  const [answer, setAnswer] = useState<RouteAnswer[] | null>(null);
  const [failure, setFailure] = useState<string | null>(null);
  const ask = async () => {
    setFailure(null);
    try {
      const example: AlertExample = { severity, category, place };
      setAnswer(await routesOf(example));
    } catch (error) {
      setFailure(errorText(error));
    }
  };
  return (
    <section className="alerting__which" aria-label={t("which.title")}>
      <h2>{t("which.title")}</h2>
      <div className="alerting__bar">
        <Select label={t("which.severity")} value={severity} options={SEVERITIES.map((value) => ({ value, name: t(`severity.${value}`) }))} onChange={(value) => setSeverity(value)} />
        <Field label={t("which.category")} value={category} onChange={setCategory} />
        <Field label={t("which.place")} value={place} onChange={setPlace} />
        <Button icon={<Split aria-hidden size={18} />} onPress={() => void ask()}>
          {t("which.act")}
        </Button>
      </div>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <div role="status">
        {answer?.length === 0 && <p>{t("which.none")}</p>}
        <ul className="alerting__answers">
          {answer?.map((one) => (
            <li key={one.route}>
              <strong>{one.route}</strong> <span className="quiet">{one.channels.join(", ")}</span>{" "}
              <StatusBadge tone={!one.open ? "neutral" : one.quiet ? "attention" : "ok"}>{!one.open ? t("which.closed") : one.quiet ? t("which.quiet") : t("which.now")}</StatusBadge>
            </li>
          ))}
        </ul>
      </div>
    </section>
  );
}

export function ChannelsView() {
  const { t } = useTranslation("alerting");
  const channels = useChannels();
  const detailOf = useCallback(
    ({ channel }: ChannelView) => ("to" in channel ? channel.to.join(", ") : channel.type === "webhook" ? channel.url : t("channel.types.apprise")),
    [t],
  );
  const stateOf = useCallback(
    ({ routes }: ChannelView) => {
      const word = t("channels.used", { count: routes.length });
      return { word, badge: <StatusBadge tone={routes.length === 0 ? "neutral" : "ok"}>{word}</StatusBadge> };
    },
    [t],
  );
  if (!mayDo("manageSettings")) return <p className="quiet alerting__note">{t("form.mayNot")}</p>;
  return (
    <SettingsView
      kind="channels"
      icon={<Mail aria-hidden size={32} />}
      rows={channels.value}
      failure={channels.failure}
      mayAdd
      detailOf={detailOf}
      stateOf={stateOf}
      show={(row, onDone) => (
        <ChannelForm
          row={row}
          isFixed={row?.source === "file" ? t("form.inFile", { setting: SETTING }) : null}
          onDone={(name) => {
            channels.reload();
            onDone(name);
          }}
        />
      )}
    />
  );
}

function ChannelForm({ row, isFixed, onDone }: { row: ChannelView | null; isFixed: string | null; onDone: (name: string) => void }) {
  const { t } = useTranslation("alerting");
  const first = row?.channel.type ?? "mail";
  const [draft, setDraft] = useState(() => draftOfChannel(fieldsOfChannel(t, first), row?.channel ?? null));
  const type = typeOf(draft, first);
  const fields = useMemo(() => fieldsOfChannel(t, type), [t, type]);
  return (
    <SettingForm<Channel>
      name={row?.name ?? null}
      isFixed={isFixed}
      fields={fields}
      draft={draft}
      onDraft={setDraft}
      read={() => {
        const { channel, faults } = enteredChannel(fields, draft);
        return { value: channel, faults };
      }}
      onSave={(name, channel) => saveChannel(name, channel).then(() => onDone(name))}
      onDelete={(name) => deleteChannel(name).then(() => onDone(""))}
      deleteMeans={t("channels.deleteMeans")}
    >
      {() => row !== null && <ChannelTester name={row.name} />}
    </SettingForm>
  );
}

function ChannelTester({ name }: { name: string }) {
  const { t } = useTranslation("alerting");
  const [result, setResult] = useState<TestResult | null>(null);
  const [failure, setFailure] = useState<string | null>(null);
  const [busy, setBusy] = useState(false);
  const send = async () => {
    setBusy(true);
    setResult(null);
    setFailure(null);
    try {
      setResult(await testChannel(name));
    } catch (error) {
      setFailure(errorText(error));
    } finally {
      setBusy(false);
    }
  };
  return (
    <section className="alerting__test" aria-label={t("channels.test")}>
      <div className="alerting__acts">
        <Button icon={<Send aria-hidden size={18} />} isDisabled={busy} onPress={() => void send()}>
          {t("channels.test")}
        </Button>
        <span role="status">
          {busy && <span className="quiet">{t("channels.sending")}</span>}
          {result?.sent === true && <StatusBadge tone="ok">{t("channels.accepted")}</StatusBadge>}
        </span>
      </div>
      {result?.sent === false && <ErrorMessage>{t("channels.refused", { reason: result.reason ?? "" })}</ErrorMessage>}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
    </section>
  );
}

/** Anomaly rules: what they find now, their form, and their test on the history of a value. */
import { Activity, FlaskConical } from "lucide-react";
import { useCallback, useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import type { DefinitionView } from "~/api/generated/task-orchestrator";
import { errorText } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Loading } from "~/design/Loading";
import { RelativeTime } from "~/design/RelativeTime";
import { Select } from "~/design/Select";
import { StatusBadge, type Tone } from "~/design/StatusBadge";
import { exactTime } from "~/design/times";
import { digits, isoOf, titleOf, valuesOf } from "~/devices/values";
import { useRegisteredDevices } from "~/live/hooks";
import { addresses } from "~/places/addresses";
import { mayDo } from "~/session/session";
import { deleteRule, GATEWAY, saveRule, testRule, type AnomalyView, type Rule, type RuleTestView, type RuleView } from "./api";
import { checkOf, draftOfRule, enteredRule, fieldsOfRule, fits, withCheck, type CheckType } from "./rule";
import { SettingForm } from "./SettingForm";
import { SettingsView } from "./SettingsView";

const REFRESH_MS = 5_000;
const SPANS = { day: 86_400, week: 7 * 86_400, month: 30 * 86_400 } as const;
type Span = keyof typeof SPANS;
const MAX_SHOWN = 50;

export function RulesView() {
  const { t } = useTranslation("alerting");
  const rules = useServiceQuery<RuleView[]>(GATEWAY, "rules", { intervalMs: REFRESH_MS });
  const states = useServiceQuery<AnomalyView[]>(GATEWAY, "anomalies?all=true", { intervalMs: REFRESH_MS });
  const mayWrite = mayDo("configure") && mayDo("runProcesses");
  const byRule = useMemo(() => Map.groupBy(states.value ?? [], ({ rule }) => rule), [states.value]);
  const detailOf = useCallback(({ rule }: RuleView) => t("rule.concerns", { check: t(`rule.types.${rule.check.type ?? "limits"}`), device: rule.device ?? "*", value: rule.value ?? "*" }), [t]);
  const stateOf = useCallback(
    ({ name, rule }: RuleView) => {
      const active = (byRule.get(name) ?? []).filter(({ active: isOn }) => isOn).length;
      const [tone, word]: [Tone, string] =
        rule.enabled === false ? ["neutral", t("state.off")]
        : active > 0 ? ["stop", t("state.abnormal", { count: active })]
        : !byRule.has(name) ? ["neutral", t("state.nothing")]
        : ["ok", t("state.normal")];
      return { word, badge: <StatusBadge tone={tone}>{word}</StatusBadge> };
    },
    [byRule, t],
  );
  return (
    <SettingsView
      kind="rules"
      icon={<Activity aria-hidden size={32} />}
      rows={rules.value}
      failure={rules.failure}
      mayAdd={mayWrite}
      detailOf={detailOf}
      stateOf={stateOf}
      show={(row, onDone) => (
        <RuleForm
          row={row}
          watches={row === null ? [] : (byRule.get(row.name) ?? [])}
          isFixed={row?.source === "file" ? t("form.inFile", { setting: "HANDOVER_DEVICE_RULES" }) : mayWrite ? null : t("form.mayNot")}
          onDone={(name) => {
            rules.reload();
            states.reload();
            onDone(name);
          }}
        />
      )}
    />
  );
}

interface RuleFormProps {
  row: RuleView | null;
  watches: readonly AnomalyView[];
  isFixed: string | null;
  onDone: (name: string) => void;
}

function RuleForm(props: RuleFormProps) {
  const { value: definitions, failure } = useServiceQuery<DefinitionView[]>("task-orchestrator", "definitions");
  const wanted = props.row?.rule.startProcess?.definition;
  // Without the orchestrator the name of the definition is typed.
  if (definitions === null && failure === null) return <Loading />;
  const known = (definitions ?? []).map(({ name }) => name);
  return <LoadedRuleForm {...props} definitions={known.length === 0 || wanted === undefined ? known : [...known, wanted]} />;
}

/** The fields stay those of the definitions at the beginning: a choice is kept as its number among them. */
function LoadedRuleForm({ row, watches, isFixed, onDone, definitions }: RuleFormProps & { definitions: readonly string[] }) {
  const { t } = useTranslation("alerting");
  const [names] = useState(() => [...new Set(definitions)]);
  const present = row?.rule ?? null;
  const [draft, setDraft] = useState(() => draftOfRule(fieldsOfRule(t, present?.check.type ?? "limits", names), present));
  const check: CheckType = checkOf(draft);
  const fields = useMemo(() => fieldsOfRule(t, check, names), [t, check, names]);
  return (
    <>
      {row !== null && <Watches watches={watches} />}
      <SettingForm<Rule>
        name={row?.name ?? null}
        isFixed={isFixed}
        fields={fields}
        draft={draft}
        onDraft={(next) => setDraft(checkOf(next) === check ? next : withCheck(t, next))}
        read={() => {
          const { rule, faults } = enteredRule(fields, draft, present);
          return { value: rule, faults };
        }}
        onSave={(name, rule) => saveRule(name, rule).then(() => onDone(name))}
        onDelete={(name) => deleteRule(name).then(() => onDone(""))}
        deleteMeans={t("rules.deleteMeans")}
      >
        {(valid) => <RuleTester valid={valid} device={textOf(draft["device"])} value={textOf(draft["value"])} />}
      </SettingForm>
    </>
  );
}

function textOf(entry: unknown): string {
  return typeof entry === "string" && entry !== "" ? entry : "*";
}

/** What the rule finds now, the abnormal values first. */
function Watches({ watches }: { watches: readonly AnomalyView[] }) {
  const { t, i18n } = useTranslation("alerting");
  const sorted = [...watches].sort((one, other) => Number(other.active) - Number(one.active) || (other.since ?? 0) - (one.since ?? 0));
  if (watches.length === 0) return <p className="quiet">{t("watches.none")}</p>;
  return (
    <section aria-label={t("watches.title")}>
      <h3>{t("watches.title")}</h3>
      <div className="alerting__table">
        <table>
          <thead>
            <tr>
              <th scope="col">{t("watches.value")}</th>
              <th scope="col">{t("watches.state")}</th>
              <th scope="col" data-number>{t("watches.measured")}</th>
              <th scope="col" data-number>{t("watches.limit")}</th>
              <th scope="col">{t("watches.since")}</th>
            </tr>
          </thead>
          <tbody>
            {sorted.slice(0, MAX_SHOWN).map((one) => (
              <tr key={`${one.device} ${one.value}`}>
                <th scope="row"><a href={addresses.device(one.device, { part: "history", values: one.value })}>{one.device} · {one.value}</a></th>
                <td><StatusBadge tone={one.active ? "stop" : "ok"}>{one.active ? t("watches.abnormal") : t("watches.normal")}</StatusBadge></td>
                <td data-number>{one.measured === null ? "–" : digits(one.measured, i18n.language)}</td>
                <td data-number>{one.limit === null ? "–" : digits(one.limit, i18n.language)}</td>
                <td>{one.since === null ? "–" : <RelativeTime at={isoOf(one.since)} isStop />}</td>
              </tr>
            ))}
          </tbody>
        </table>
      </div>
      {sorted.length > MAX_SHOWN && <p className="quiet small">{t("watches.more", { count: sorted.length - MAX_SHOWN })}</p>}
    </section>
  );
}

/** Applies the rule, as it is entered, to the history of one value. */
function RuleTester({ valid, device, value }: { valid: () => Rule | null; device: string; value: string }) {
  const { t, i18n } = useTranslation("alerting");
  const { devices } = useRegisteredDevices();
  const [chosen, setChosen] = useState("");
  const [span, setSpan] = useState<Span>("day");
  const [found, setFound] = useState<RuleTestView | null>(null);
  const [failure, setFailure] = useState<string | null>(null);
  const [busy, setBusy] = useState(false);
  const series = useMemo(
    () =>
      (devices ?? [])
        .filter(({ name }) => fits(device, name))
        .flatMap((one) => valuesOf(one).filter(({ name }) => fits(value, name)).map(({ name }) => ({ key: `${one.name} ${name}`, name: `${titleOf(one)} · ${name}` }))),
    [devices, device, value],
  );
  const key = series.some((one) => one.key === chosen) ? chosen : (series[0]?.key ?? "");
  const run = async () => {
    const rule = valid();
    if (rule === null) return;
    const [ofDevice = "", ofValue = ""] = key.split(" ");
    setBusy(true);
    setFailure(null);
    setFound(null);
    try {
      setFound(await testRule({ rule, device: ofDevice, value: ofValue, begin: Date.now() / 1000 - SPANS[span] }));
    } catch (error) {
      setFailure(errorText(error));
    } finally {
      setBusy(false);
    }
  };
  const time = (seconds: number) => exactTime(isoOf(seconds), i18n.language);
  return (
    <section className="alerting__test" aria-label={t("test.title")}>
      <h3>{t("test.title")}</h3>
      <p className="quiet">{t("test.means")}</p>
      {series.length === 0 ? (
        <p className="quiet">{t("test.noSeries")}</p>
      ) : (
        <div className="alerting__bar">
          <Select label={t("test.series")} value={key} options={series.map((one) => ({ value: one.key, name: one.name }))} onChange={setChosen} />
          <Select label={t("test.span")} value={span} options={(Object.keys(SPANS) as Span[]).map((one) => ({ value: one, name: t(`test.spans.${one}`) }))} onChange={(one) => setSpan(one)} />
          <Button icon={<FlaskConical aria-hidden size={18} />} isDisabled={busy} onPress={() => void run()}>
            {t("test.act")}
          </Button>
        </div>
      )}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <div role="status">
        {found !== null && <p>{found.values === 0 ? t("test.noValues") : t("test.found", { count: found.findings.length, values: found.values.toLocaleString(i18n.language) })}</p>}
      </div>
      {found !== null && found.findings.length > 0 && (
        <div className="alerting__table">
          <table>
            <thead>
              <tr>
                <th scope="col">{t("test.begin")}</th>
                <th scope="col">{t("test.end")}</th>
                <th scope="col" data-number>{t("watches.measured")}</th>
                <th scope="col" data-number>{t("watches.limit")}</th>
              </tr>
            </thead>
            <tbody>
              {found.findings.slice(-MAX_SHOWN).map((one) => (
                <tr key={one.begin}>
                  <td>{time(one.begin)}</td>
                  <td>{one.end === null ? t("test.lasts") : time(one.end)}</td>
                  <td data-number>{digits(one.measured, i18n.language)}</td>
                  <td data-number>{digits(one.limit, i18n.language)}</td>
                </tr>
              ))}
            </tbody>
          </table>
        </div>
      )}
    </section>
  );
}

/** The actions on the selected Alerts: one request for all; each failure is listed. */
import { BellOff, BellRing, UserCheck } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { acknowledge, shelve, unshelve, type Outcome } from "~/api/actions";
import { errorText } from "~/api/http";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { Button } from "~/design/Button";
import { SegmentedControl } from "~/design/SegmentedControl";
import { ErrorMessage } from "~/design/ErrorMessage";
import { localizedText } from "~/i18n/server";
import type { AlertView } from "~/live/messages";
import { shortName } from "~/live/urn";
import { useWithName, userName } from "~/shell/userName";

/** For how long an Alert may be shelved, in minutes. */
const PERIODS: readonly string[] = ["15", "60", "480", "1440"];
const MAX_FAILURES_SHOWN = 5;

interface AlertActsProps {
  chosen: readonly AlertView[];
  /** How many Alerts the table lists. */
  shown: number;
  onDone: () => void;
}

export function AlertActions({ chosen, shown, onDone }: AlertActsProps) {
  const { t } = useTranslation("system");
  const acts = useAlertActions(onDone);
  const isNone = chosen.length === 0;
  return (
    <div className="alert-actions">
      <p role="status" className="alert-actions__count">
        {isNone ? t("alert.shown", { count: shown }) : t("alert.selected", { count: chosen.length })}
      </p>
      <AlertButtons alerts={chosen} acts={acts} />
      {acts.messages}
    </div>
  );
}

export function AlertButtons({ alerts, acts }: { alerts: readonly AlertView[]; acts: ReturnType<typeof useAlertActions> }) {
  const { t } = useTranslation("system");
  const toAcknowledge = alerts.filter((alert) => alert.acknowledged === null);
  const toShelve = alerts.filter((alert) => alert.state === "new" || alert.state === "acknowledged");
  const shelved = alerts.filter((alert) => alert.state === "shelved");
  const count = (of: readonly AlertView[]) => ({ count: of.length });
  return (
    <>
      <Button permission="acknowledgeAlerts"
        kind={toAcknowledge.length > 0 ? "main" : "plain"}
        isDisabled={acts.isBusy || toAcknowledge.length === 0}
        icon={<UserCheck aria-hidden size={18} />}
        onPress={() => acts.acknowledge(toAcknowledge)}
      >
        {t("alert.acknowledge", count(toAcknowledge))}
      </Button>
      <Button permission="acknowledgeAlerts" isDisabled={acts.isBusy || toShelve.length === 0} icon={<BellOff aria-hidden size={18} />} onPress={() => acts.askShelving(toShelve)}>
        {t("alert.shelve", count(toShelve))}
      </Button>
      {shelved.length > 0 && (
        <Button permission="acknowledgeAlerts" isDisabled={acts.isBusy} icon={<BellRing aria-hidden size={18} />} onPress={() => acts.unshelve(shelved)}>
          {t("alert.unshelve", count(shelved))}
        </Button>
      )}
    </>
  );
}

/** The actions, their dialogs and their results. */
export function useAlertActions(onDone: () => void) {
  const { t } = useTranslation("system");
  const { withName, question } = useWithName();
  const [isBusy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const [outcome, setOutcome] = useState<Outcome | null>(null);
  const [shelving, setShelving] = useState<readonly AlertView[] | null>(null);
  const [minutes, setMinutes] = useState("60");

  const perform = async (act: (by: string) => Promise<Outcome>) => {
    setBusy(true);
    setFailure(null);
    setOutcome(null);
    try {
      await withName(async (by) => {
        const result = await act(by);
        setOutcome(result.failed.length > 0 ? result : null);
        onDone();
      });
    } catch (error) {
      setFailure(errorText(error));
    } finally {
      setBusy(false);
    }
  };
  const ids = (alerts: readonly AlertView[]) => alerts.map((alert) => alert.id);
  const messages = (
    <>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {outcome !== null && (
        <ErrorMessage>
          <p>{t("alert.partly", { done: outcome.done.length, count: outcome.failed.length })}</p>
          <ul>
            {outcome.failed.slice(0, MAX_FAILURES_SHOWN).map((failure) => (
              <li key={failure.alert}>
                {shortName(failure.alert)}: {localizedText(failure, "detail") ?? failure.detail}
              </li>
            ))}
          </ul>
        </ErrorMessage>
      )}
      {question}
      <ConfirmDialog
        isOpen={shelving !== null}
        onClose={() => setShelving(null)}
        title={t("alert.shelving.title", { count: shelving?.length ?? 0 })}
        act={t("alert.shelve", { count: shelving?.length ?? 0 })}
        onAct={() => {
          const alerts = ids(shelving ?? []);
          return userName() === ""
            ? perform((by) => shelve(alerts, by, Number(minutes)))
            : shelve(alerts, userName(), Number(minutes)).then((result) => {
                setOutcome(result.failed.length > 0 ? result : null);
                onDone();
              });
        }}
      >
        <p>{t("alert.shelving.means")}</p>
        <SegmentedControl
          label={t("alert.shelving.period")}
          value={minutes}
          options={PERIODS.map((value) => ({ value, name: t(`alert.shelving.for.${value}`) }))}
          onChange={setMinutes}
        />
      </ConfirmDialog>
    </>
  );
  return {
    isBusy,
    messages,
    acknowledge: (alerts: readonly AlertView[]) => void perform((by) => acknowledge(ids(alerts), by)),
    unshelve: (alerts: readonly AlertView[]) => void perform((by) => unshelve(ids(alerts), by)),
    askShelving: (alerts: readonly AlertView[]) => setShelving(alerts),
  };
}

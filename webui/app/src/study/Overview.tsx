/** The page of the study leader: sessions and results. */
import { useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { errorText } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { SegmentedControl } from "~/design/SegmentedControl";
import { EmptyState } from "~/design/EmptyState";
import { Field } from "~/design/Field";
import { Select } from "~/design/Select";
import { ErrorMessage } from "~/design/ErrorMessage";
import { StatusBadge } from "~/design/StatusBadge";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { useTopicSelector } from "~/live/hooks";
import { useGloveNames } from "~/live/names";
import { Results } from "./Results";
import { leaderCode } from "./participantMode";
import { beginSession, deleteSession, languages, type Analysis, type Language, type Session } from "./study";

export function Overview({ open }: { open: (session: string) => void }) {
  const { t } = useTranslation("study");
  const { value: sessions, failure, reload } = useServiceQuery<Session[]>("study", "sessions");
  const { value: analysis, failure: analysisFailure, reload: reloadAnalysis } = useServiceQuery<Analysis>("study", "analysis");
  return (
    <div className="study">
      <h1>{t("title")}</h1>
      <div className="study__columns">
        <div className="study__column">
          <Begin open={open} />
          {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
          <Sessions
            sessions={sessions ?? []}
            open={open}
            onDeleted={() => {
              reload();
              reloadAnalysis();
            }}
          />
        </div>
        {analysis !== null ? (
          <Results analysis={analysis} />
        ) : (
          <Card title={t("results.title")}>
            {analysisFailure !== null ? <ErrorMessage>{analysisFailure}</ErrorMessage> : <p className="quiet">{t("results.awaited")}</p>}
          </Card>
        )}
      </div>
    </div>
  );
}

function Begin({ open }: { open: (session: string) => void }) {
  const { t, i18n } = useTranslation("study");
  const gloves = useGloveNames();
  const [pseudonym, setPseudonym] = useState("");
  const [language, setLanguage] = useState<Language>(languages.find((each) => each === i18n.language) ?? "en");
  const [chosen, setGlove] = useState<string | null>(null);
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const glove = chosen ?? gloves[0] ?? "";
  const person = useTopicSelector(`glove/${glove}`, (view) => view?.person ?? null);
  const options = [...gloves.map((glove) => ({ value: glove, name: glove })), { value: "", name: t("begin.noGlove") }];
  const begin = async () => {
    setBusy(true);
    setFailure(null);
    const name = pseudonym.trim();
    try {
      const session = await beginSession({
        language,
        ...(name === "" ? {} : { pseudonym: name }),
        ...(glove === "" ? {} : { glove }),
        ...(person === null ? {} : { person }),
      });
      open(session.id);
    } catch (error) {
      setFailure(errorText(error));
      setBusy(false);
    }
  };
  return (
    <Card title={t("begin.title")}>
      <form
        className="study__begin"
        onSubmit={(event) => {
          event.preventDefault();
          void begin();
        }}
      >
        <Field label={t("begin.pseudonym")} hint={t("begin.pseudonymHint")} value={pseudonym} onChange={setPseudonym} maxLength={64} />
        <SegmentedControl<Language>
          label={t("begin.language")}
          value={language}
          options={languages.map((language) => ({ value: language, name: t(`language.${language}`) }))}
          onChange={setLanguage}
        />
        {language !== "en" && <p className="quiet">{t("begin.translated")}</p>}
        {gloves.length > 0 && <Select label={t("begin.glove")} value={glove} options={options} onChange={setGlove} />}
        {glove !== "" && <Wearer person={person} />}
        <p className="quiet">{t("begin.code", { code: leaderCode() })}</p>
        {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
        <Button permission="conductStudies" type="submit" kind="main" isDisabled={busy}>
          {t("begin.act")}
        </Button>
      </form>
    </Card>
  );
}

/** The person whose gestures are "personal": without own gestures, both conditions would be equal. */
function Wearer({ person }: { person: string | null }) {
  const { t } = useTranslation("study");
  const { value } = useServiceQuery<{ ownCommands: Record<string, unknown> }>("gesture-controller", person === null ? null : `people/${encodeURIComponent(person)}`);
  if (person === null) return <StatusBadge tone="attention">{t("begin.nobody")}</StatusBadge>;
  if (value !== null && Object.keys(value.ownCommands).length === 0) return <StatusBadge tone="attention">{t("begin.noOwn", { person })}</StatusBadge>;
  return <p className="quiet">{t("begin.gestures", { person })}</p>;
}

interface SessionsProps {
  sessions: readonly Session[];
  open: (session: string) => void;
  onDeleted: () => void;
}

function Sessions({ sessions, open, onDeleted }: SessionsProps) {
  const { t } = useTranslation("study");
  const [leaving, setLeaving] = useState<Session | null>(null);
  const [sorting, setSorting] = useSorting("-began", "sessionSort");
  const columns = useColumns(open, setLeaving);
  return (
    <Card title={t("sessions.title")}>
      {sessions.length === 0 && <EmptyState title={t("sessions.none.title")}>{t("sessions.none.means")}</EmptyState>}
      {sessions.length > 0 && (
        <DataTable
          label={t("sessions.title")}
          rows={sessions}
          columns={columns}
          keyOf={(session) => session.id}
          nameOf={(session) => session.pseudonym}
          rowHeight={56}
          sorting={sorting}
          onSort={setSorting}
        />
      )}
      <ConfirmDialog
        isOpen={leaving !== null}
        onClose={() => setLeaving(null)}
        title={t("sessions.ask", { who: leaving?.pseudonym ?? "" })}
        act={t("sessions.delete", { who: leaving?.pseudonym ?? "" })}
        kind="stop"
        onAct={async () => {
          if (leaving !== null) await deleteSession(leaving.id);
          onDeleted();
        }}
      >
        <p>{t("sessions.askMeans")}</p>
      </ConfirmDialog>
    </Card>
  );
}

function useColumns(open: (session: string) => void, onDelete: (session: Session) => void): readonly Column<Session>[] {
  const { t, i18n } = useTranslation("study");
  return useMemo(
    () => [
      {
        id: "who", name: t("sessions.column.who"), width: "minmax(140px, 1.4fr)", sortBy: (session) => session.pseudonym,
        cell: (session) => (
          <>
            <span className="cell__name">{session.pseudonym}</span>
            {session.first !== null && <p className="cell__detail">{t(`sessions.first.${session.first}`)}</p>}
          </>
        ),
      },
      {
        id: "began", name: t("sessions.column.began"), width: "minmax(130px, 1fr)", isDescendingFirst: true, sortBy: (session) => Date.parse(session.beganAt),
        cell: (session) => <span>{new Date(session.beganAt).toLocaleString(i18n.language, { dateStyle: "medium", timeStyle: "short" })}</span>,
      },
      {
        id: "state", name: t("sessions.column.state"), width: "minmax(120px, 1fr)", sortBy: (session) => (session.endedAt === null ? session.stepNumber : session.steps + 1),
        cell: (session) =>
          session.endedAt === null ? (
            <StatusBadge tone="accent">{t("sessions.at", { step: session.stepNumber, steps: session.steps })}</StatusBadge>
          ) : (
            <StatusBadge tone="ok">{t("sessions.finished")}</StatusBadge>
          ),
      },
      {
        id: "acts", name: t("sessions.column.acts"), width: "minmax(180px, 1.6fr)",
        cell: (session) => (
          <>
            {session.endedAt === null && <Button permission="conductStudies" onPress={() => open(session.id)}>{t("sessions.goOn", { who: session.pseudonym })}</Button>}
            <Button permission="conductStudies" kind="quiet" onPress={() => onDelete(session)}>
              {t("sessions.delete", { who: session.pseudonym })}
            </Button>
          </>
        ),
      },
    ],
    [t, i18n.language, open, onDelete],
  );
}

/** Accuracy tests: starting one, and the list of earlier ones with their reports. */
import { useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { errorText } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { SegmentedControl } from "~/design/SegmentedControl";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { StatusBadge } from "~/design/StatusBadge";
import { Checkbox } from "~/design/Checkbox";
import { useGestureName } from "~/hand/Hand";
import { useTopicSelector } from "~/live/hooks";
import { useChoice } from "~/route/choice";
import { UnknownName } from "~/route/UnknownName";
import { useQueryParameter } from "~/route/queryParameter";
import { TestReport } from "./TestReport";
import { Trial } from "./Trial";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { exactTime } from "~/design/times";
import { beginTest, deleteTest, isPlain, leadTest, phaseTone, type Gesture, type TestSummary } from "./tests";

const rounds = ["1", "3", "5", "10"] as const;

export function Accuracy({ glove }: { glove: string }) {
  const { t } = useTranslation("test");
  const onItsWay = useTopicSelector(`glove/${glove}`, (view) => view?.accuracyTest?.id ?? null);
  const [testParameter, setTest] = useQueryParameter("test");
  const { value: tests, failure, reload } = useServiceQuery<TestSummary[]>("gesture-controller", "tests", { revision: onItsWay ?? "" });
  if (onItsWay !== null) return <Trial glove={glove} />;
  const mine = (tests ?? []).filter((test) => test.glove === glove);
  const selected = testParameter === "" ? mine[0] : mine.find((test) => test.id === testParameter);
  return (
    <div className="test__columns">
      <div className="test__column">
        <Planning glove={glove} />
        {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
        {mine.length > 0 && <Earlier tests={mine} selected={selected?.id ?? ""} show={setTest} reload={reload} />}
      </div>
      {tests !== null && selected === undefined && testParameter !== "" && <UnknownName thing="test" name={testParameter} parameter="test" />}
      {tests !== null && selected === undefined && testParameter === "" && (
        <Card title={t("report.title")}>
          <EmptyState title={t("earlier.none.title")}>{t("earlier.none.means")}</EmptyState>
        </Card>
      )}
      {selected !== undefined && <TestReport key={`${selected.id} ${selected.phase}`} test={selected.id} />}
    </div>
  );
}

function Planning({ glove }: { glove: string }) {
  const { t } = useTranslation("test");
  const nameOf = useGestureName();
  const { value: gestures } = useServiceQuery<Gesture[]>("gesture-controller", "gestures");
  const [howOften, setHowOften] = useChoice("rounds", rounds, "10");
  const [left, setLeft] = useState<readonly string[]>([]);
  const [failure, setFailure] = useState<string | null>(null);
  const [busy, setBusy] = useState(false);
  const isConnected = useTopicSelector(`glove/${glove}`, (view) => view?.connected) === true;
  const plain = (gestures ?? []).filter(isPlain).map((gesture) => gesture.name);
  const chosen = plain.filter((name) => !left.includes(name));
  const often = Number(howOften);
  const begin = async () => {
    setBusy(true);
    setFailure(null);
    try {
      await beginTest({ glove, gestures: chosen, rounds: often, breaks: true });
    } catch (error) {
      setFailure(errorText(error));
    } finally {
      setBusy(false);
    }
  };
  return (
    <Card title={t("plan.title")}>
      <p className="quiet">{t("plan.means")}</p>
      <div className="test__plan">
        <SegmentedControl label={t("plan.rounds")} value={howOften} options={rounds.map((round) => ({ value: round, name: t("plan.times", { count: Number(round) }) }))} onChange={setHowOften} />
        <Button permission="configure" kind="main" isDisabled={busy || !isConnected || chosen.length === 0} onPress={() => void begin()}>
          {t("plan.begin", { count: chosen.length * often })}
        </Button>
      </div>
      {!isConnected && <p className="quiet">{t("plan.connect")}</p>}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <details className="test__which">
        <summary>{t("plan.which", { chosen: chosen.length, all: plain.length })}</summary>
        {plain.length < (gestures ?? []).length && <p className="quiet">{t("plan.composed")}</p>}
        <div className="test__gestures">
          {plain.map((name) => (
            <Checkbox
              key={name}
              isSelected={!left.includes(name)}
              onChange={(isSelected) => setLeft(isSelected ? left.filter((other) => other !== name) : [...left, name])}
            >
              {nameOf(name)}
            </Checkbox>
          ))}
        </div>
      </details>
    </Card>
  );
}

interface EarlierProps {
  tests: readonly TestSummary[];
  selected: string;
  show: (test: string) => void;
  reload: () => void;
}

function Earlier({ tests, selected, show, reload }: EarlierProps) {
  const { t, i18n } = useTranslation("test");
  const [sorting, setSorting] = useSorting("-began", "testSort");
  const [leaving, setLeaving] = useState<TestSummary | null>(null);
  const [failure, setFailure] = useState<string | null>(null);
  const columns: readonly Column<TestSummary>[] = useMemo(() => {
    const goOn = (test: TestSummary) => {
      setFailure(null);
      leadTest(test.id, "continue").catch((error: unknown) => setFailure(errorText(error)));
    };
    return [
      {
        id: "began", name: t("earlier.column.began"), width: "minmax(140px, 1fr)", isDescendingFirst: true, sortBy: (test) => Date.parse(test.beganAt),
        cell: (test) => <span className="cell__name">{new Date(test.beganAt).toLocaleString(i18n.language, { dateStyle: "medium", timeStyle: "short" })}</span>,
      },
      {
        id: "size", name: t("earlier.column.size"), width: "minmax(120px, 1fr)", sortBy: (test) => test.gestures.length * test.rounds,
        cell: (test) => <span>{t("earlier.size", { gestures: test.gestures.length, rounds: test.rounds })}</span>,
      },
      {
        id: "state", name: t("earlier.column.state"), width: "minmax(120px, 1fr)", sortBy: (test) => t(`phase.${test.phase}`),
        cell: (test) => <StatusBadge tone={phaseTone[test.phase] ?? "accent"}>{t(`phase.${test.phase}`)}</StatusBadge>,
      },
      {
        id: "acts", name: t("earlier.column.acts"), width: "minmax(160px, 1.4fr)",
        cell: (test) => (
          <>
            {test.phase === "interrupted" && <Button permission="configure" onPress={() => goOn(test)}>{t("earlier.continue")}</Button>}
            <Button permission="configure" kind="quiet" onPress={() => setLeaving(test)}>
              {t("earlier.delete")}
            </Button>
          </>
        ),
      },
    ];
  }, [t, i18n.language]);
  return (
    <Card title={t("earlier.title")}>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <DataTable
        label={t("earlier.title")}
        rows={tests}
        columns={columns}
        keyOf={(test) => test.id}
        nameOf={(test) => exactTime(test.beganAt, i18n.language)}
        rowHeight={52}
        sorting={sorting}
        onSort={setSorting}
        openKey={selected}
        onOpen={(test) => show(test.id)}
      />
      <ConfirmDialog
        isOpen={leaving !== null}
        onClose={() => setLeaving(null)}
        title={t("earlier.ask")}
        act={t("earlier.delete")}
        kind="stop"
        onAct={async () => {
          if (leaving !== null) await deleteTest(leaving.id);
          reload();
        }}
      >
        <p>{t("earlier.askMeans")}</p>
      </ConfirmDialog>
    </Card>
  );
}

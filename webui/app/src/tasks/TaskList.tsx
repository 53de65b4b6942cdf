/** The list of Tasks: views, search and order. It keeps its place while somebody is in it. */
import { ChevronsUp, Search, UserRound } from "lucide-react";
import { useMemo, useRef, type RefObject } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { Checkbox } from "~/design/Checkbox";
import { Field } from "~/design/Field";
import { SegmentedControl } from "~/design/SegmentedControl";
import { Select } from "~/design/Select";
import { useIsReading, useStableOrder } from "~/design/table/useStableOrder";
import { VirtualGrid } from "~/design/table/VirtualGrid";
import { useNow } from "~/live/clock";
import { shortName } from "~/live/urn";
import { useChoice } from "~/route/choice";
import { useQueryParameter } from "~/route/queryParameter";
import { DueMark } from "./DueMark";
import { DEFAULT_PRIORITY, isInView, isLater, matches, ORDERS, priorityOf, sorted, VIEWS, type Identity, type ListedTask } from "./list";
import { TaskState } from "./TaskState";

const MINUTE_MS = 60_000;
const ROW_HEIGHT = 92;

export interface TaskListProps {
  tasks: readonly ListedTask[];
  who: Identity;
  chosen: string;
  onChoose: (task: string) => void;
  onIdentify: () => void;
  searchRef: RefObject<HTMLDivElement | null>;
}

export function TaskList({ tasks, who, chosen, onChoose, onIdentify, searchRef }: TaskListProps) {
  const { t } = useTranslation(["tasks", "common"]);
  const [view, setView] = useChoice("show", VIEWS, "all");
  const [order, setOrder] = useChoice("sort", ORDERS, "due");
  const [find, setFind] = useQueryParameter("find");
  const [later, setLater] = useChoice("later", ["", "show"], "");
  const minute = Math.floor(useNow() / MINUTE_MS) * MINUTE_MS;
  const { isReading, handlers } = useIsReading();
  const frame = useRef<HTMLDivElement>(null);
  const found = useMemo(() => {
    const due = tasks.filter(({ task }) => later !== "" || !isLater(task, minute, who));
    const counts = Object.fromEntries(VIEWS.map((one) => [one, due.filter(({ task }) => isInView(task, one, who)).length])) as Record<(typeof VIEWS)[number], number>;
    const shown = sorted(due.filter((one) => isInView(one.task, view, who) && matches(one, find)), order);
    return { counts, shown, hidden: tasks.filter(({ task }) => isLater(task, minute, who)).length };
  }, [tasks, who, view, order, find, later, minute]);
  const byKey = useMemo(() => new Map(tasks.map((one) => [one.task.id, one])), [tasks]);
  const { rows, waiting, release } = useStableOrder(found.shown, keyOf, byKey, isReading, `${view} ${order} ${find} ${later} ${who.name}`);
  return (
    <section className="tasklist__list" aria-label={t("list")} {...handlers}>
      <header className="tasklist__head">
        <h1>{t("common:pages.tasks")}</h1>
        <Button kind="quiet" icon={<UserRound aria-hidden size={18} />} onPress={onIdentify}>
          {who.name === "" ? t("identity.unknown") : who.name}
        </Button>
      </header>
      <SegmentedControl label={t("show.label")} value={view} options={VIEWS.map((value) => ({ value, name: t(`show.${value}`, { count: found.counts[value] }) }))} onChange={setView} />
      <div className="tasklist__filter" ref={searchRef}>
        <Field label={t("find")} value={find} onChange={setFind} type="search" />
        <Select label={t("order.label")} value={order} options={ORDERS.map((value) => ({ value, name: t(`order.${value}`) }))} onChange={setOrder} />
      </div>
      {found.hidden > 0 && (
        <Checkbox isSelected={later !== ""} onChange={(isShown) => setLater(isShown ? "show" : "")}>
          {t("later", { count: found.hidden })}
        </Checkbox>
      )}
      {rows.length === 0 ? (
        <p className="quiet tasklist__none">
          <Search aria-hidden size={18} /> {t(tasks.length === 0 ? "none" : view === "groups" && who.groups.length === 0 ? "noGroups" : "noneHere")}
        </p>
      ) : (
        <VirtualGrid
          label={t("list")}
          lines={rows.map((row) => ({ kind: "row", key: row.task.id, row }))}
          columns={[{ id: "task", name: t("list"), width: "minmax(0, 1fr)", cell: (row) => <Row listed={row} /> }]}
          rowHeight={ROW_HEIGHT}
          nameOf={({ task, processName }) => [task.name, processName, task.claimedBy === null ? t("state.free") : t("state.claimed", { who: task.claimedBy })].filter((text) => text !== null).join(", ")}
          openKey={rows.find(({ task }) => shortName(task.id) === chosen)?.task.id ?? null}
          onOpen={({ task }) => onChoose(shortName(task.id))}
          frameRef={frame}
        />
      )}
      {waiting > 0 && (
        <div className="tasklist__new">
          <Button kind="main" onPress={release}>
            {t("common:table.new", { count: waiting })}
          </Button>
        </div>
      )}
    </section>
  );
}

function keyOf({ task }: ListedTask): string {
  return task.id;
}

function Row({ listed: { task, processName } }: { listed: ListedTask }) {
  const { t } = useTranslation("tasks");
  const offered = [...task.persons.map(shortName), ...task.groups];
  return (
    <div className="tasklist__row">
      <span className="tasklist__name">{task.name}</span>
      <span className="tasklist__marks">
        <TaskState claimedBy={task.claimedBy} isClaimable={task.isClaimable} />
        {task.dueDate !== null && <DueMark dueDate={task.dueDate} />}
        {priorityOf(task) > DEFAULT_PRIORITY && (
          <span className="tasklist__priority">
            <ChevronsUp aria-hidden size="1.15em" /> {t("priority.high")}
          </span>
        )}
      </span>
      <span className="quiet small">{[processName, ...offered].filter((text) => text !== null).join(" · ")}</span>
    </div>
  );
}

/** The Tasks of a process, as a timeline or as a table; filtered alike, exported as they are filtered. */
import { Download } from "lucide-react";
import { ToggleButton, ToggleButtonGroup } from "react-aria-components";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { Empty } from "~/design/Empty";
import { Field } from "~/design/Field";
import { useNow } from "~/live/clock";
import type { ProcessView, Status } from "~/live/messages";
import { useQuery } from "~/route/query";
import { download } from "../download";
import { Pick } from "../Pick";
import { filtered, performersOf, statuses, statusesOf } from "./filter";
import { csvOf, fileName, jsonOf } from "./sheet";
import { TaskTable } from "./TaskTable";
import { Timeline } from "./Timeline";
import "./TasksView.css";

export interface TasksViewProps {
  process: ProcessView;
  view: "timeline" | "table";
  picked: string;
  onPick: (task: string) => void;
}

export function TasksView({ process, view, picked, onPick }: TasksViewProps) {
  const { t } = useTranslation(["processes", "common"]);
  const [text, setText] = useQuery("filter");
  const [wanted, setWanted] = useQuery("status");
  const [performer, setPerformer] = useQuery("who");
  const now = useNow();
  const chosen = statusesOf(wanted);
  const tasks = filtered(process.tasks, { text, statuses: chosen, performer });
  const there = statuses.filter((status) => chosen.includes(status) || process.tasks.some((task) => task.status === status));
  return (
    <div className="tasks">
      <div className="tasks__bar">
        <Field label={t("filter.text")} type="search" value={text} onChange={setText} />
        <Pick
          label={t("filter.who")}
          value={performer}
          options={[{ value: "", name: t("filter.everybody") }, ...withWanted(performersOf(process.tasks), performer)]}
          onChange={setPerformer}
        />
        <ToggleButtonGroup
          className="choice"
          aria-label={t("filter.status")}
          selectionMode="multiple"
          selectedKeys={chosen}
          onSelectionChange={(keys) => setWanted([...keys].join(","))}
        >
          {there.map((status: Status) => (
            <ToggleButton key={status} id={status} className="choice__option">
              {t(`common:status.${status}`)}
            </ToggleButton>
          ))}
        </ToggleButtonGroup>
        <div className="tasks__exports">
          <Button
            icon={<Download aria-hidden size={18} />}
            label={t("export.csv", { count: tasks.length })}
            onPress={() => download(fileName(process, "csv"), "text/csv;charset=utf-8", csvOf(process, tasks, now))}
          >
            {"CSV"}
          </Button>
          <Button
            icon={<Download aria-hidden size={18} />}
            label={t("export.json", { count: tasks.length })}
            onPress={() => download(fileName(process, "json"), "application/json", jsonOf(process, tasks))}
          >
            {"JSON"}
          </Button>
        </div>
      </div>
      {tasks.length === 0 ? (
        <Empty
          title={t(process.tasks.length === 0 ? "tasks.none" : "tasks.noneFits")}
          act={
            process.tasks.length > 0 && (
              <Button
                onPress={() => {
                  setText("");
                  setWanted("");
                  setPerformer("");
                }}
              >
                {t("tasks.showAll")}
              </Button>
            )
          }
        />
      ) : view === "timeline" ? (
        <Timeline process={process} tasks={tasks} picked={picked} onPick={onPick} />
      ) : (
        <TaskTable tasks={tasks} picked={picked} onPick={onPick} />
      )}
    </div>
  );
}

function withWanted(names: readonly string[], wanted: string): { value: string; name: string }[] {
  const all = wanted === "" || names.includes(wanted) ? names : [...names, wanted];
  return all.map((name) => ({ value: name, name }));
}

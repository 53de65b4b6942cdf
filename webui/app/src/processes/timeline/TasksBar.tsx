/** Which Tasks one looks at, and a file of just those. */
import { Download } from "lucide-react";
import { useTranslation } from "react-i18next";
import { download } from "~/api/download";
import { Button } from "~/design/Button";
import { Field } from "~/design/Field";
import { Select } from "~/design/Select";
import type { ProcessView } from "~/api/generated/task-orchestrator";
import type { Status } from "~/live/messages";
import { useChosen } from "./chosen";
import { performersOf, statuses, statusesOf } from "./filter";
import { csvOf, fileName, jsonOf } from "./sheet";
import "./TasksBar.css";

export function TasksBar({ process }: { process: ProcessView }) {
  const { t } = useTranslation(["processes", "common"]);
  const { filter, tasks, setText, setStatuses, setPerformer } = useChosen(process);
  const said = (status: Status) => t(`common:status.${status}`);
  return (
    <div className="tasks-bar">
      <Field label={t("filter.text")} placeholder={t("filter.text")} type="search" value={filter.text} onChange={setText} />
      <Select
        label={t("filter.who")}
        value={filter.performer}
        options={[{ value: "", name: t("filter.everybody") }, ...withWanted(performersOf(process.tasks), filter.performer)]}
        onChange={setPerformer}
      />
      <Select
        label={t("filter.status")}
        value={filter.statuses.join(",")}
        options={[
          { value: "", name: t("filter.everyState") },
          ...statuses.map((status) => ({ value: status, name: said(status) })),
          // A URL may ask for several.
          ...(filter.statuses.length > 1 ? [{ value: filter.statuses.join(","), name: filter.statuses.map(said).join(", ") }] : []),
        ]}
        onChange={(wanted) => setStatuses(statusesOf(wanted))}
      />
      <div className="tasks-bar__exports">
        <Button
          icon={<Download aria-hidden size={16} />}
          label={t("export.csv", { count: tasks.length })}
          onPress={() => download(fileName(process, "csv"), "text/csv;charset=utf-8", csvOf(process, tasks, Date.now()))}
        >
          {"CSV"}
        </Button>
        <Button
          icon={<Download aria-hidden size={16} />}
          label={t("export.json", { count: tasks.length })}
          onPress={() => download(fileName(process, "json"), "application/json", jsonOf(process, tasks))}
        >
          {"JSON"}
        </Button>
      </div>
    </div>
  );
}

function withWanted(names: readonly string[], wanted: string): { value: string; name: string }[] {
  const all = wanted === "" || names.includes(wanted) ? names : [...names, wanted];
  return all.map((name) => ({ value: name, name }));
}

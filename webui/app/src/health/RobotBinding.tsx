/** Which robots the body of a person limits: bind one, or end that. */
import { Link2, Unlink } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import type { PersonView } from "~/api/generated/human-state";
import { errorText, requestService } from "~/api/http";
import { Button } from "~/design/Button";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Select } from "~/design/Select";
import { useRobotNames } from "~/live/names";
import { pathOf, SERVICE } from "./health";

const robotPath = (person: PersonView, robot: string) => `${pathOf(person.person)}/robots/${encodeURIComponent(robot)}`;

export function BindRobot({ person, bound, onChange }: { person: PersonView; bound: readonly string[]; onChange: () => void }) {
  const { t } = useTranslation("health");
  const others = useRobotNames().filter((name) => !bound.includes(name));
  const [chosen, setChosen] = useState("");
  const [failure, setFailure] = useState<string | null>(null);
  const robot = others.includes(chosen) ? chosen : others[0];
  if (robot === undefined) return <p className="quiet small">{t("limit.noMore")}</p>;
  const bind = async () => {
    setFailure(null);
    try {
      await requestService(SERVICE, robotPath(person, robot), { method: "PUT" });
      onChange();
    } catch (error) {
      setFailure(errorText(error));
    }
  };
  return (
    <div className="health__acts">
      <Select label={t("limit.robot")} value={robot} options={others.map((name) => ({ value: name, name }))} onChange={setChosen} />
      <Button icon={<Link2 aria-hidden size={18} />} onPress={() => void bind()}>
        {t("limit.bind")}
      </Button>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
    </div>
  );
}

export function UnbindRobot({ person, robot, onChange }: { person: PersonView; robot: string; onChange: () => void }) {
  const { t } = useTranslation("health");
  const [isAsked, setAsked] = useState(false);
  return (
    <>
      <Button icon={<Unlink aria-hidden size={18} />} onPress={() => setAsked(true)}>
        {t("limit.unbind", { robot })}
      </Button>
      {isAsked && (
        <ConfirmDialog
          isOpen
          onClose={() => setAsked(false)}
          title={t("limit.unbindAsk", { robot, person: person.person })}
          act={t("limit.unbind", { robot })}
          kind="stop"
          onAct={async () => {
            await requestService(SERVICE, robotPath(person, robot), { method: "DELETE" });
            onChange();
          }}
        >
          <p>{t("limit.unbindMeans")}</p>
        </ConfirmDialog>
      )}
    </>
  );
}

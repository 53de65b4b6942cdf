/** What is processed and kept of a person, always in view; withdrawing the consent, and deletion. */
import { Circle, CircleDot, EyeOff, ShieldCheck, Trash2 } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import type { PersonView } from "~/api/generated/human-state";
import { requestService } from "~/api/http";
import { Button } from "~/design/Button";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { clockTime } from "~/design/times";
import { shortName } from "~/live/urn";
import { mayDo, useSession } from "~/session/session";
import { pathOf, PURPOSES, SERVICE } from "./health";

const ACTS = {
  withdraw: { path: "/consent", icon: EyeOff },
  deleteData: { path: "/data", icon: Trash2 },
  deletePerson: { path: "", icon: Trash2 },
} as const;
type Act = keyof typeof ACTS;

interface RecordedCardProps {
  person: PersonView;
  onChange: () => void;
  onChangeConsent: () => void;
  onDeletePerson: () => void;
}

export function RecordedCard({ person, onChange, onChangeConsent, onDeletePerson }: RecordedCardProps) {
  const { t, i18n } = useTranslation("health");
  const [asked, setAsked] = useState<Act | null>(null);
  const isOn = person.purposes.length > 0;
  const own = useSession().user?.person;
  const mayDeletePerson = mayDo("managePeople") || (own != null && shortName(own) === person.person);
  const offered = (Object.keys(ACTS) as Act[]).filter((act) => (act !== "withdraw" || isOn) && (act !== "deletePerson" || mayDeletePerson));
  return (
    <section className="health__recorded" aria-label={t("recorded.title")} data-on={isOn || undefined}>
      <p className="health__recorded-who">
        <strong>{person.pseudonym}</strong>
        <span className="quiet small">{isOn && person.consent !== null ? t("recorded.until", { time: clockTime(person.consent.ends, i18n.language), by: person.consent.givenBy }) : t("recorded.nothing")}</span>
      </p>
      <ul className="health__recorded-list">
        {PURPOSES.map((purpose) => {
          const isAllowed = person.purposes.includes(purpose);
          const Icon = isAllowed ? CircleDot : Circle;
          return (
            <li key={purpose} data-on={isAllowed || undefined}>
              <Icon aria-hidden size={16} />
              <span>{t(`recorded.${purpose}`)}</span>
              <span className="health__recorded-state">{t(isAllowed ? (purpose === "recording" ? "recorded.allowed" : "recorded.on") : "recorded.off")}</span>
            </li>
          );
        })}
      </ul>
      <div className="health__acts">
        {isOn && (
          <Button icon={<ShieldCheck aria-hidden size={18} />} onPress={onChangeConsent}>
            {t("act.change")}
          </Button>
        )}
        {offered.map((act) => {
          const Icon = ACTS[act].icon;
          return (
            <Button key={act} icon={<Icon aria-hidden size={18} />} onPress={() => setAsked(act)}>
              {t(`act.${act}`)}
            </Button>
          );
        })}
      </div>
      {asked !== null && (
        <ConfirmDialog
          isOpen
          onClose={() => setAsked(null)}
          title={t(`act.ask.${asked}`, { person: person.person })}
          act={t(`act.${asked}`)}
          kind="stop"
          onAct={async () => {
            await requestService(SERVICE, `${pathOf(person.person)}${ACTS[asked].path}`, { method: "DELETE" });
            if (asked === "deletePerson") onDeletePerson();
            onChange();
          }}
        >
          <p>{t(`act.means.${asked}`)}</p>
        </ConfirmDialog>
      )}
    </section>
  );
}

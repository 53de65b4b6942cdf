/** The present values with age and quality. One that may not be trusted is named so, and is not shown as a value. */
import { Ruler, TimerOff, TriangleAlert } from "lucide-react";
import { useTranslation } from "react-i18next";
import type { StateView, ValueView } from "~/api/generated/human-state";
import { Card } from "~/design/Card";
import { percent } from "~/design/numbers";
import { StatusBadge } from "~/design/StatusBadge";
import { span } from "~/design/times";
import { spaced } from "~/devices/values";
import { numberText, symbolOf, trustOf, trustTone, vitalSigns } from "./health";

const ICONS = { stale: TimerOff, implausible: Ruler, weak: TriangleAlert };

export function VitalSigns({ state, silentS, isOld }: { state: StateView | null; silentS: number; isOld: boolean }) {
  const { t } = useTranslation("health");
  const values = state === null ? [] : vitalSigns(state);
  return (
    <Card title={t("vital.title")} className="health__vital" aside={isOld && <StatusBadge tone="attention">{t("vital.lost")}</StatusBadge>}>
      {values.length === 0 ? (
        <p className="quiet">{t("vital.none")}</p>
      ) : (
        <ul className="vital-signs">
          {values.map((value) => (
            <VitalSign key={value.name} value={value} silentS={silentS} />
          ))}
        </ul>
      )}
      {state?.isStrained === true && <StatusBadge tone="attention">{t("vital.strained")}</StatusBadge>}
    </Card>
  );
}

function VitalSign({ value, silentS }: { value: ValueView; silentS: number }) {
  const { t, i18n } = useTranslation("health");
  const trust = trustOf(value, silentS);
  const name = t(`feature.${value.name}`, { defaultValue: spaced(value.name) });
  const Icon = trust === "valid" ? null : ICONS[trust];
  const symbol = symbolOf(value.name, value.unit);
  return (
    <li className="vital-sign" data-trust={trust}>
      <span className="vital-sign__name">{name}</span>
      <span className="vital-sign__number" data-word={typeof value.value === "string" || undefined}>
        <output aria-label={name}>{typeof value.value === "number" ? numberText(value.name, value.value, i18n.language) : t(`text.${value.value}`, { defaultValue: value.value })}</output>
        {symbol !== "" && <span className="vital-sign__unit"> {symbol}</span>}
      </span>
      <span className="vital-sign__state small">
        <StatusBadge tone={trustTone[trust]} icon={Icon === null ? undefined : <Icon aria-hidden size="1.15em" />}>
          {t(`trust.${trust}`)}
        </StatusBadge>
        <span>{t("vital.age", { age: span(value.ageS + silentS, i18n.language) })}</span>
      </span>
      <span className="vital-sign__quality small">
        <meter min={0} max={1} low={0.5} optimum={1} value={value.quality} aria-label={t("vital.qualityOf", { name })} />
        {t("vital.quality", { percent: percent(value.quality, i18n.language) })}
      </span>
      {value.disagree && <span className="vital-sign__mark small">{t("vital.disagree")}</span>}
      {!value.isCalibrated && <span className="vital-sign__mark small">{t("vital.uncalibrated")}</span>}
      {value.sensors.length > 1 && (
        <ul className="vital-sign__sensors small quiet">
          {value.sensors.map((each) => (
            <li key={each.sensor}>
              {each.sensor}: {typeof each.value === "number" ? numberText(value.name, each.value, i18n.language) : each.value} · {t(`trust.${trustOf({ ...value, ...each }, silentS)}`)}
            </li>
          ))}
        </ul>
      )}
    </li>
  );
}

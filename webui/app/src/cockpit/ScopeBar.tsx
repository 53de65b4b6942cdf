/** The bar above the statistics: definition, version and period. */
import { useTranslation } from "react-i18next";
import { Field } from "~/design/Field";
import { Select } from "~/design/Select";
import { useFamily } from "~/live/hooks";
import { PERIODS, type useScope } from "./query";

export function ScopeBar({ state }: { state: ReturnType<typeof useScope> }) {
  const { t } = useTranslation("cockpit");
  const definitions = useFamily("definition");
  const { scope, name, from, to } = state;
  const latest = definitions.find((one) => one.name === scope.definition)?.version ?? 0;
  const versions = Array.from({ length: latest }, (_none, nth) => String(latest - nth));
  return (
    <div className="cockpit__bar" role="group" aria-label={t("bar.label")}>
      <Select
        label={t("bar.definition")}
        value={scope.definition}
        options={[{ value: "", name: t("bar.all") }, ...definitions.map((one) => ({ value: one.name, name: one.title }))]}
        onChange={(definition) => {
          state.setVersion("");
          state.setDefinition(definition);
        }}
      />
      {(latest > 1 || scope.version !== "") && (
        <Select
          label={t("bar.version")}
          value={scope.version}
          options={[{ value: "", name: t("bar.allVersions") }, ...versions.map((value) => ({ value, name: t("bar.oneVersion", { version: value }) }))]}
          onChange={state.setVersion}
        />
      )}
      <Select label={t("bar.period")} value={name} options={PERIODS.map((value) => ({ value, name: t(`period.${value}`) }))} onChange={state.setPeriod} />
      {name === "custom" && (
        <>
          <Field label={t("bar.from")} type="date" value={from} onChange={state.setFrom} />
          <Field label={t("bar.to")} type="date" value={to} onChange={state.setTo} />
        </>
      )}
    </div>
  );
}

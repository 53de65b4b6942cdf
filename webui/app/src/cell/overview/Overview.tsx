/** All objects of the cell, by kind, with what each does now and what needs attention; above them the cell in 3D. */
import { Factory } from "lucide-react";
import { useMemo } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { SegmentedControl } from "~/design/SegmentedControl";
import { Select } from "~/design/Select";
import { addresses } from "~/places/addresses";
import { useChoice } from "~/route/choice";
import { useQueryParameter } from "~/route/queryParameter";
import { mayDo } from "~/session/session";
import { matches, OBJECT_KINDS, type ObjectKind } from "../objects/cellObjects";
import { ObjectTable } from "../objects/ObjectTable";
import { GATEWAY, useCellObjects } from "../objects/useCellObjects";
import { CellMap } from "./CellMap";
import { Found } from "./Found";
import "./Overview.css";

export function Overview() {
  const { t } = useTranslation(["cell", "common", "devices", "system"]);
  const { objects, isLoaded, isGatewayCurrent } = useCellObjects();
  const [find, setFind] = useQueryParameter("find");
  const [kind, setKind] = useChoice<"" | ObjectKind>("kind", ["", ...OBJECT_KINDS], "");
  const [show, setShow] = useChoice("show", ["all", "attention"], "all");
  const matching = useMemo(() => {
    const ofKind = kind === "" ? objects : objects.filter((object) => object.kind === kind);
    return find.trim() === "" ? ofKind : ofKind.filter((object) => matches(object, find, `${t(`kinds.${object.kind}`)} ${object.kind === "service" ? t(`common:services.${object.name}`, { defaultValue: "" }) : ""}`));
  }, [objects, find, kind, t]);
  const attention = useMemo(() => matching.filter((object) => object.needsAttention), [matching]);
  const kinds = OBJECT_KINDS.filter((other) => other === kind || objects.some((object) => object.kind === other));
  const hasOnlyServices = objects.every((object) => object.kind === "service");
  return (
    <div className="overview">
      <Found objects={objects} hasGateway={objects.some((object) => object.kind === "service" && object.name === GATEWAY)} />
      <CellMap />
      <div className="overview__list">
        <div className="overview__bar">
          <Field label={t("find")} value={find} onChange={setFind} type="search" />
          <Select label={t("kind")} value={kind} options={[{ value: "", name: t("allKinds") }, ...kinds.map((value) => ({ value, name: t(`kinds.${value}`) }))]} onChange={setKind} />
          <SegmentedControl
            label={t("show")}
            value={show}
            options={[
              { value: "all", name: t("devices:sensors.all", { count: matching.length }) },
              { value: "attention", name: t("devices:sensors.attention", { count: attention.length }) },
            ]}
            onChange={setShow}
          />
        </div>
        {!isGatewayCurrent && <ErrorMessage act={<Link href={addresses.service(GATEWAY)}>{t("devices:toSystem")}</Link>}>{t("devices:gatewayAway")}</ErrorMessage>}
        {isLoaded && hasOnlyServices && kind === "" && (
          <EmptyState
            icon={<Factory aria-hidden size={32} />}
            title={t("none.title")}
            act={mayDo("configure") && <Link href={addresses.devices({ add: "yes" })}>{t("devices:add.act")}</Link>}
          >
            {t("none.means")}
          </EmptyState>
        )}
        {!isLoaded && objects.length === 0 ? (
          <p className="quiet">{t("common:loading")}</p>
        ) : show === "attention" && attention.length === 0 && find === "" ? (
          <EmptyState title={t("devices:sensors.allWell")} />
        ) : (
          <ObjectTable label={t("title")} objects={show === "attention" ? attention : matching} view={`${kind} ${show} ${find}`} isGrouped />
        )}
      </div>
    </div>
  );
}

/** The gains of the joints by chain: shares of those of the model, within the limits that the model declares. */
import { Check, RotateCcw } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import type { ChainGainsView, GainShares } from "~/api/generated/whole-body-control";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Slider } from "~/control/Slider";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { ErrorMessage } from "~/design/ErrorMessage";
import { number, percent } from "~/design/numbers";
import { mayDo } from "~/session/session";
import { SERVICE, type HumanoidModel, type JointModel, type LiveDocument } from "./humanoid";
import { useAct } from "./useAct";

const EVERY_MS = 2000;
const STEP = 0.01;
/** A smaller difference is rounding. */
const SAME = 0.002;
const KINDS = ["stiffness", "damping"] as const;
type Kind = (typeof KINDS)[number];
const UNITS: Readonly<Record<Kind, string>> = { stiffness: "N m/rad", damping: "N m s/rad" };

export function GainsCard({ document, model }: { document: LiveDocument; model: HumanoidModel }) {
  const { t, i18n } = useTranslation("humanoid");
  const { value: gains, failure: notRead, reload } = useServiceQuery<ChainGainsView[]>(SERVICE, "gains", { intervalMs: EVERY_MS });
  const [drafts, setDrafts] = useState<Readonly<Record<string, GainShares>>>({});
  const { failure, isBusy, act } = useAct(() => {
    setDrafts({});
    reload();
  });
  const mayChange = mayDo("configure");
  const joints = new Map(model.chains.flatMap((chain) => chain.joints.map((joint) => [joint.name, joint] as const)));
  const isChanged = Object.keys(drafts).length > 0;
  const isOfModel = gains?.every(({ stiffness, damping }) => stiffness === 1 && damping === 1) ?? true;
  const isMoving = gains?.some((chain) => KINDS.some((kind) => isOn(document, chain, kind))) ?? false;
  return (
    <Card title={t("gains.title")}>
      {notRead !== null && <ErrorMessage>{notRead}</ErrorMessage>}
      {gains !== null && gains.length === 0 ? (
        <p className="quiet">{t("gains.none")}</p>
      ) : (
        <p className="small quiet">{t("gains.means")}</p>
      )}
      <div className="humanoid-gains">
        {gains?.map((chain) => {
          const draft = drafts[chain.chain];
          const range = (kind: Kind) => (kind === "stiffness" ? chain.stiffnessLimits : chain.dampingLimits);
          return (
            <fieldset key={chain.chain} disabled={!mayChange || isBusy}>
              <legend>{chain.chain}</legend>
              {KINDS.map((kind) => {
                const share = draft?.[kind] ?? chain[kind];
                const [least, most] = range(kind);
                return (
                  <Slider
                    key={kind}
                    label={t(`model.column.${kind}`)}
                    value={share}
                    min={least}
                    max={most}
                    step={STEP}
                    text={`${percent(share, i18n.language)} · ${inUnits(chain, kind, share, joints, i18n.language)}`}
                    ends={[percent(least, i18n.language), percent(most, i18n.language)]}
                    onChange={(value) => setDrafts({ ...drafts, [chain.chain]: { stiffness: chain.stiffness, damping: chain.damping, ...draft, [kind]: value } })}
                  />
                );
              })}
            </fieldset>
          );
        })}
      </div>
      <p className="humanoid-gains__status" role="status">
        {isChanged ? t("gains.unsaved") : isMoving ? t("gains.moving") : t(isOfModel ? "gains.ofModel" : "gains.changed")}
      </p>
      {mayChange && gains !== null && gains.length > 0 && (
        <div className="humanoid__acts">
          <Button kind="main" icon={<Check aria-hidden size={18} />} isDisabled={!isChanged || isBusy} onPress={() => void act("gains", { chains: drafts }, "PUT")}>
            {t("gains.apply")}
          </Button>
          {isChanged && <Button onPress={() => setDrafts({})}>{t("gains.discard")}</Button>}
          <Button icon={<RotateCcw aria-hidden size={18} />} isDisabled={isBusy || isOfModel} onPress={() => void act("gains", undefined, "DELETE")}>
            {t("gains.reset")}
          </Button>
        </div>
      )}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
    </Card>
  );
}

/** Whether the joints still move to the gains that were chosen. */
function isOn({ gains }: LiveDocument, chain: ChainGainsView, kind: Kind): boolean {
  const now = gains?.[chain.chain]?.[kind];
  return now != null && Math.abs(now - chain[kind]) > SAME;
}

function inUnits({ joints }: ChainGainsView, kind: Kind, share: number, all: ReadonlyMap<string, JointModel>, language: string): string {
  const values = joints.flatMap((name) => {
    const joint = all.get(name);
    return joint === undefined ? [] : [share * (kind === "stiffness" ? joint.gain : joint.damping)];
  });
  const [least, most] = [Math.min(...values), Math.max(...values)];
  const figure = (value: number) => number(value, language, { maximumFractionDigits: 1 });
  return `${least === most ? figure(least) : `${figure(least)} … ${figure(most)}`} ${UNITS[kind]}`;
}

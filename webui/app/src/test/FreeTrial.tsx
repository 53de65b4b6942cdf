/** Test mode: the page shows whether the glove recognizes the chosen gesture. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { errorText } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import "~/design/Figures.css";
import { number } from "~/design/numbers";
import { ErrorMessage } from "~/design/ErrorMessage";
import { StatusBadge } from "~/design/StatusBadge";
import { fingers } from "~/hand/geometry";
import { GesturePicker } from "~/hand/GesturePicker";
import { Hand, useGestureName } from "~/hand/Hand";
import { useTopicSelector } from "~/live/hooks";
import type { Finger } from "~/live/messages";
import { UnknownName } from "~/route/UnknownName";
import { useQueryParameter } from "~/route/queryParameter";
import { isPlain, setTesting, type Gesture } from "./tests";

const words = ["straight", "between", "bent"] as const;

export function FreeTrial({ glove }: { glove: string }) {
  const { t } = useTranslation(["test", "hand"]);
  const nameOf = useGestureName();
  const [failure, setFailure] = useState<string | null>(null);
  const [gestureParameter, setGesture] = useQueryParameter("gesture", "Thumbs up");
  const { value: gestures } = useServiceQuery<Gesture[]>("gesture-controller", "gestures");
  const plain = (gestures ?? []).filter(isPlain);
  const target = plain.find((gesture) => gesture.name === gestureParameter);
  const isTesting = useTopicSelector(`glove/${glove}`, (view) => view?.testing) === true;
  const side = useTopicSelector(`glove/${glove}`, (view) => view?.hand) ?? "right";
  const states = useTopicSelector(`glove/${glove}`, (view) => view?.states ?? null);
  const recognized = useTopicSelector(`glove/${glove}`, (view) => view?.gesture ?? null);
  const isRight = recognized !== null && recognized === target?.name;
  const code = target?.code ?? "";
  const differs = states === null || isRight ? [] : fingers.filter((_, index) => code[index] !== undefined && states[index] !== code[index]);
  const change = (on: boolean) => {
    setFailure(null);
    setTesting(glove, on).catch((error: unknown) => setFailure(errorText(error)));
  };
  return (
    <Card
      title={t("try.title")}
      aside={
        isTesting ? (
          <Button permission="configure" onPress={() => change(false)}>{t("try.off")}</Button>
        ) : (
          <Button permission="configure" kind="main" onPress={() => change(true)}>
            {t("try.on")}
          </Button>
        )
      }
    >
      <p>{isTesting ? <StatusBadge tone="accent">{t("try.isOn")}</StatusBadge> : <StatusBadge tone="attention">{t("try.isOff")}</StatusBadge>}</p>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {gestures !== null && target === undefined && <UnknownName thing="gesture" name={gestureParameter} parameter="gesture" />}
      {target !== undefined && (
        <div className="test__two">
          <section className="test__side">
            <GesturePicker label={t("try.wanted")} value={target.name} options={plain.map((gesture) => ({ value: gesture.name, hands: [{ code: gesture.code, side }] }))} onChange={setGesture} />
            <Hand key={target.name} states={code} side={side} animateFrom="00000" size="min(44vh, 420px)" label={nameOf(target.name)} />
          </section>
          <section className={isRight ? "test__side test__side--right" : "test__side test__side--wrong"} aria-live="polite">
            <p className="test__seen">
              {states === null ? (
                <StatusBadge tone="neutral">{t("try.unseen")}</StatusBadge>
              ) : (
                <StatusBadge tone={isRight ? "ok" : "stop"}>{recognized === null ? t("try.noGesture") : nameOf(recognized)}</StatusBadge>
              )}
            </p>
            {states !== null && <Hand states={states} side={side} moveMs={140} size="min(44vh, 420px)" differs={differs} />}
          </section>
          <Values glove={glove} differs={differs} />
        </div>
      )}
    </Card>
  );
}

function Values({ glove, differs }: { glove: string; differs: readonly Finger[] }) {
  const { t, i18n } = useTranslation(["test", "hand"]);
  const bend = useTopicSelector(`glove/${glove}`, (view) => view?.bend?.map((value) => Math.round(value)).join(" ") ?? "");
  const states = useTopicSelector(`glove/${glove}`, (view) => view?.states ?? "");
  const values = bend === "" ? [] : bend.split(" ");
  return (
    <table className="figures test__values">
      <thead>
        <tr>
          <th scope="col">{t("try.finger")}</th>
          <th scope="col">{t("try.value")}</th>
          <th scope="col">{t("try.state")}</th>
        </tr>
      </thead>
      <tbody>
        {fingers.map((finger, index) => (
          <tr key={finger} data-differs={differs.includes(finger) || undefined}>
            <th scope="row">{t(`hand:finger.${finger}`)}</th>
            <td>{values[index] === undefined ? "–" : number(Number(values[index]), i18n.language)}</td>
            <td>{states[index] === undefined ? "–" : t(`try.fingerState.${words[Number(states[index])] ?? "between"}`)}</td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}

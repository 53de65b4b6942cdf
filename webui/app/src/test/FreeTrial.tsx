/** Testing mode: a gesture is chosen, and the page says in green and red whether the glove sees it. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { describe } from "~/api/http";
import { useLoaded } from "~/api/useLoaded";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import "~/design/Figures.css";
import { number } from "~/design/numbers";
import { Problem } from "~/design/Problem";
import { State } from "~/design/State";
import { fingers } from "~/hand/geometry";
import { GesturePicker } from "~/hand/GesturePicker";
import { Hand, useGestureName } from "~/hand/Hand";
import { usePick } from "~/live/hooks";
import type { Finger } from "~/live/messages";
import { useQuery } from "~/route/query";
import { setTesting, type Gesture } from "./tests";

const words = ["straight", "between", "bent"] as const;

export function FreeTrial({ glove }: { glove: string }) {
  const { t } = useTranslation(["test", "hand"]);
  const nameOf = useGestureName();
  const [failure, setFailure] = useState<string | null>(null);
  const [asked, setAsked] = useQuery("gesture", "Thumbs up");
  const { value: gestures } = useLoaded<Gesture[]>("gesture-controller", "gestures");
  const plain = (gestures ?? []).filter((one) => one.code !== undefined);
  const wanted = plain.find((one) => one.name === asked) ?? plain[0];
  const isTesting = usePick(`glove/${glove}`, (view) => view?.testing) === true;
  const side = usePick(`glove/${glove}`, (view) => view?.hand) ?? "right";
  const states = usePick(`glove/${glove}`, (view) => view?.states ?? null);
  const seen = usePick(`glove/${glove}`, (view) => view?.gesture ?? null);
  const isRight = seen !== null && seen === wanted?.name;
  const code = wanted?.code ?? "";
  const differs = states === null || isRight ? [] : fingers.filter((_, nth) => code[nth] !== undefined && states[nth] !== code[nth]);
  const change = (on: boolean) => {
    setFailure(null);
    setTesting(glove, on).catch((error: unknown) => setFailure(describe(error)));
  };
  return (
    <Card
      title={t("try.title")}
      aside={
        isTesting ? (
          <Button onPress={() => change(false)}>{t("try.off")}</Button>
        ) : (
          <Button kind="main" onPress={() => change(true)}>
            {t("try.on")}
          </Button>
        )
      }
    >
      <p>{isTesting ? <State tone="accent">{t("try.isOn")}</State> : <State tone="attention">{t("try.isOff")}</State>}</p>
      {failure !== null && <Problem>{failure}</Problem>}
      {wanted !== undefined && (
        <div className="test__two">
          <section className="test__side">
            <GesturePicker label={t("try.wanted")} value={wanted.name} options={plain.map((one) => ({ value: one.name, hands: [{ code: one.code ?? "", side }] }))} onChange={setAsked} />
            <Hand key={wanted.name} states={code} side={side} animateFrom="00000" size="min(44vh, 420px)" label={nameOf(wanted.name)} />
          </section>
          <section className={isRight ? "test__side test__side--right" : "test__side test__side--wrong"} aria-live="polite">
            <p className="test__seen">
              {states === null ? (
                <State tone="neutral">{t("try.unseen")}</State>
              ) : (
                <State tone={isRight ? "ok" : "stop"}>{seen === null ? t("try.noGesture") : nameOf(seen)}</State>
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
  const bend = usePick(`glove/${glove}`, (view) => view?.bend?.map((value) => Math.round(value)).join(" ") ?? "");
  const states = usePick(`glove/${glove}`, (view) => view?.states ?? "");
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
        {fingers.map((finger, nth) => (
          <tr key={finger} data-differs={differs.includes(finger) || undefined}>
            <th scope="row">{t(`hand:finger.${finger}`)}</th>
            <td>{values[nth] === undefined ? "–" : number(Number(values[nth]), i18n.language)}</td>
            <td>{states[nth] === undefined ? "–" : t(`try.is.${words[Number(states[nth])] ?? "between"}`)}</td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}

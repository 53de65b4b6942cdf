/** What the humanoid does: its behaviour, walking by a dead-man control, and throws to a chosen place. */
import { Hand, Target } from "lucide-react";
import { useEffect, useState } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { ErrorMessage } from "~/design/ErrorMessage";
import { number } from "~/design/numbers";
import { SegmentedControl } from "~/design/SegmentedControl";
import { Driver } from "~/control/driver";
import { HoldButton } from "~/control/HoldButton";
import { JogPanel } from "~/control/JogPanel";
import { localizedText } from "~/i18n/server";
import { keyName } from "~/control/keyName";
import { Slider } from "~/control/Slider";
import { useKeyboard, useRelease } from "~/control/useControl";
import "~/control/RobotControl.css";
import { InputLink } from "./inputLink";
import type { LiveDocument, Place, Side } from "./humanoid";
import { useAct } from "./useAct";
import { wishOf } from "./wish";

const SEND_EVERY_MS = 40;

export interface MotionCardProps {
  document: LiveDocument;
  behaviours: readonly string[];
  target: Place;
  onTarget: (target: Place) => void;
}

/** `target` is where a ball is to land: ahead of the feet, to the left, up. */
export function MotionCard({ document, behaviours, target, onTarget }: MotionCardProps) {
  const { t } = useTranslation("humanoid");
  const { failure, act } = useAct();
  const offered = behaviours.filter((one) => one === "walking" || one === "juggling");
  const behaviour = document.behaviour === "juggling" ? "juggling" : "walking";
  const isInSession = document.session !== null && document.session.state !== "ended";
  return (
    <Card title={t("motion.title")}>
      {isInSession ? (
        <p className="quiet">{t("motion.inSession")}</p>
      ) : (
        <div className="humanoid-motion">
          <SegmentedControl
            label={t("motion.behaviour")}
            value={behaviour}
            options={offered.map((one) => ({ value: one, name: t(`behaviour.${one}`) }))}
            onChange={(next) => void act("behaviour", { behaviour: next })}
          />
          {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
          {behaviour === "walking" ? <Walk /> : <Throw ball={document.ball} isPreparing={document.throw?.state === "preparing"} target={target} onTarget={onTarget} />}
        </div>
      )}
    </Card>
  );
}

class WalkLink {
  readonly driver = new Driver();
  #link: InputLink | null = null;
  #timer: ReturnType<typeof setInterval> | undefined;

  readonly send = (): void => {
    this.#link?.send(wishOf(this.driver.input()));
  };

  open(onError: (reason: string) => void): () => void {
    this.#link = new InputLink("therapist", (answer) => answer.kind === "error" && onError(localizedText(answer, "reason") ?? answer.reason));
    this.#timer = setInterval(this.send, SEND_EVERY_MS);
    return () => {
      clearInterval(this.#timer);
      this.driver.releaseAll();
      this.send();
      this.#link?.close();
      this.#link = null;
    };
  }
}

function Walk() {
  const { t } = useTranslation(["humanoid", "control"]);
  const [walk] = useState(() => new WalkLink());
  const [failure, setFailure] = useState<string | null>(null);
  useEffect(() => walk.open(setFailure), [walk]);
  useRelease(walk, walk.driver);
  useKeyboard(walk, walk.driver, true);
  const keys = walk.driver.keyboard.keys;
  return (
    <div className="humanoid-walk">
      <p className="small quiet">{t("walk.means", { hold: keys.hold === "Space" ? t("walk.space") : keyName(keys.hold), keys: [keys["x+"], keys["y+"], keys["x-"], keys["y-"], keys["rz+"], keys["rz-"]].map(keyName).join(" ") })}</p>
      <JogPanel driver={walk.driver} isOn isBase />
      <HoldButton
        className="humanoid-walk__hold"
        onHold={(isHeld) => {
          walk.driver.hold(isHeld);
          walk.send();
        }}
      >
        <Hand aria-hidden size={24} />
        <span>{t("walk.hold")}</span>
      </HoldButton>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
    </div>
  );
}

interface ThrowProps {
  ball: LiveDocument["ball"];
  isPreparing: boolean;
  target: Place;
  onTarget: (target: Place) => void;
}

function Throw({ ball, isPreparing, target, onTarget }: ThrowProps) {
  const { t, i18n } = useTranslation("humanoid");
  const [hand, setHand] = useState<Side>("right");
  const { failure, isBusy, act } = useAct();
  const metres = (value: number) => `${number(value, i18n.language)} m`;
  const [ahead, left, up] = target;
  const missed = ball?.landing == null || ball.target === null ? null : Math.hypot(ball.landing[0] - ball.target[0], ball.landing[1] - ball.target[1]);
  return (
    <div className="humanoid-throw">
      <p className="small quiet">{t("throw.means")}</p>
      <SegmentedControl label={t("throw.hand")} value={hand} options={(["left", "right"] as const).map((side) => ({ value: side, name: t(`side.${side}`) }))} onChange={setHand} />
      <Slider label={t("throw.ahead")} value={ahead} min={0.3} max={2} step={0.01} text={metres(ahead)} onChange={(x) => onTarget([x, left, up])} />
      <Slider label={t("throw.left")} value={left} min={-1} max={1} step={0.01} text={metres(left)} onChange={(y) => onTarget([ahead, y, up])} />
      <Slider label={t("throw.height")} value={up} min={0} max={1.5} step={0.01} text={metres(up)} onChange={(z) => onTarget([ahead, left, z])} />
      <Button kind="main" size="large" icon={<Target aria-hidden size={22} />} isDisabled={isBusy || isPreparing} onPress={() => void act("throws", { target, hand })}>
        {t("throw.act")}
      </Button>
      <p role="status">
        {isPreparing ? t("throw.preparing") : ball !== null && t(`ball.${ball.phase}`)}
        {!isPreparing && missed !== null && ` · ${t("throw.missed", { distance: `${number(100 * missed, i18n.language, { maximumFractionDigits: 1 })} cm` })}`}
      </p>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
    </div>
  );
}

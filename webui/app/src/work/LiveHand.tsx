/** The live hand in the glove; fingers that differ from the requested gesture are highlighted. */
import { memo } from "react";
import { useTranslation } from "react-i18next";
import { fingers } from "~/hand/geometry";
import { Hand } from "~/hand/Hand";
import { useFamily } from "~/live/hooks";
import type { Finger, GesturePart, GloveView } from "~/live/messages";

export function LiveHand({ glove }: { glove: GloveView }) {
  const { t } = useTranslation("work");
  if (glove.states === null && glove.message.key === "putOn") return null;
  if (glove.states === null) return <p className="work__live work__live-word">{t("noHand")}</p>;
  return (
    <div className="work__live">
      <Drawn states={glove.states} side={glove.hand} differs={showsAdvice(glove) ? glove.differs.join(" ") : ""} />
      <span className="work__live-word">{t("yourHand")}</span>
    </div>
  );
}

/** Both live hands for a gesture of two hands. */
export function LiveHands({ glove, parts }: { glove: GloveView; parts: readonly GesturePart[] }) {
  const { t } = useTranslation("work");
  const gloves = useFamily("glove");
  const other = gloves.find((each) => glove.person !== null && each.person === glove.person && each.hand !== glove.hand);
  if (other === undefined || parts.every(({ hand }) => hand === null)) return <LiveHand glove={glove} />;
  const worn = [glove, other].sort((a, b) => (a.hand < b.hand ? -1 : 1));
  return (
    <div className="work__live">
      <div className="work__pair">
      {worn.map(({ glove: name, states, hand }) =>
        states === null ? (
          <span key={name}>{t("silentHand", { glove: name })}</span>
        ) : (
          <Drawn key={name} states={states} side={hand} differs={showsAdvice(glove) ? differing(states, hand, parts) : ""} />
        ),
      )}
      </div>
      <span className="work__live-word">{t("yourHands")}</span>
    </div>
  );
}

/** Fingers are highlighted only if the controller's message names them: an open hand differs in all. */
function showsAdvice({ message }: GloveView): boolean {
  return message.key === "almost" || message.key === "wrong";
}

function differing(states: string, side: GloveView["hand"], parts: readonly GesturePart[]): string {
  const code = parts.find(({ hand }) => hand === side)?.code ?? states;
  return fingers.filter((_, index) => states[index] !== code[index]).join(" ");
}

const Drawn = memo(function Drawn({ states, side, differs }: { states: string; side: "left" | "right"; differs: string }) {
  const named = differs === "" ? [] : (differs.split(" ") as Finger[]);
  return <Hand states={states} side={side} moveMs={140} size="var(--small-hand)" differs={named} />;
});

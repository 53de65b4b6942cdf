/** The live hand in the glove: it lies over the requested one, as large; fingers that differ are highlighted. */
import { memo } from "react";
import { useTranslation } from "react-i18next";
import { fingers } from "~/hand/geometry";
import { Hand } from "~/hand/Hand";
import { useFamily } from "~/live/hooks";
import type { Finger, GesturePart, GloveView } from "~/live/messages";

/** Every hand fits into the frame of the open one. */
const OPEN_HAND = "00000";

/** The states whose frame both hands share: while fingers differ, one of them may be longer than the gesture. */
export function frameFor(glove: GloveView | undefined, code: string): string {
  return glove !== undefined && showsAdvice(glove) ? OPEN_HAND : code;
}

/** The live hand over the requested gesture `code`, in the same frame. */
export function LiveHand({ glove, code }: { glove: GloveView; code: string }) {
  const { connected, states, hand } = glove;
  if (!connected || states === null || glove.testing) return null;
  const isAdvised = showsAdvice(glove);
  return (
    <div className="figure__live" data-advised={isAdvised || undefined}>
      <Drawn states={states} side={hand} frameBy={frameFor(glove, code)} differs={isAdvised ? differing(glove, states, code) : ""} />
    </div>
  );
}

/** The glove of each hand of the person: that of the page, and the one on the other hand. */
export function useWornGloves(glove: GloveView): readonly GloveView[] {
  const gloves = useFamily("glove");
  const other = gloves.find((each) => glove.person !== null && each.person === glove.person && each.hand !== glove.hand);
  return other === undefined ? [glove] : [glove, { ...other, message: glove.message, differs: [] }];
}

/** What the two hands of the figure are, and gloves without a hand in them. */
export function LiveLegend({ glove, parts }: { glove: GloveView; parts: readonly GesturePart[] }) {
  const { t } = useTranslation("work");
  const worn = useWornGloves(glove);
  const shown = parts.some(({ hand }) => hand !== null) ? worn : worn.slice(0, 1);
  if (glove.testing || glove.message.key === "putOn") return null;
  if (glove.states === null) return <p className="work__live-word">{t("noHand")}</p>;
  return (
    <p className="work__live-word">
      {shown.map(({ glove: name, states }) => states === null && <span key={name}>{t("silentHand", { glove: name })} </span>)}
      {showsAdvice(glove) && t("liveAdvised")}
    </p>
  );
}

/** Fingers are highlighted once the controller names them: a hand on its way differs in many. */
function showsAdvice({ message }: GloveView): boolean {
  return ["almost", "differs", "wrong"].includes(message.key);
}

function differing(glove: GloveView, states: string, code: string): string {
  const named = fingers.filter((_, index) => states[index] !== code[index]);
  return (named.length > 0 ? named : glove.differs).join(" ");
}

const Drawn = memo(function Drawn({ states, side, frameBy, differs }: { states: string; side: "left" | "right"; frameBy: string; differs: string }) {
  const { t } = useTranslation("work");
  const named = differs === "" ? [] : (differs.split(" ") as Finger[]);
  return <Hand states={states} side={side} moveMs={140} closeUp frameBy={frameBy} differs={named} label={t("yourHand")} />;
});

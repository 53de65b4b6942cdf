/** The hand in the glove as the controller reads it, small, with the fingers that differ pointed out. */
import { memo } from "react";
import { useTranslation } from "react-i18next";
import { Hand } from "~/hand/Hand";
import type { Finger, GloveView } from "~/live/messages";

export function LiveHand({ glove }: { glove: GloveView }) {
  const { t } = useTranslation("work");
  // An open hand differs in everything; fingers are pointed out when the controller speaks of them.
  const isTold = glove.message.key === "almost" || glove.message.key === "wrong";
  if (glove.states === null) return <p className="work__live quiet">{t("noHand")}</p>;
  return (
    <div className="work__live">
      <span className="work__live-word">{t("yourHand")}</span>
      <Drawn states={glove.states} side={glove.hand} differs={isTold ? glove.differs.join(" ") : ""} />
    </div>
  );
}

const Drawn = memo(function Drawn({ states, side, differs }: { states: string; side: "left" | "right"; differs: string }) {
  const fingers = differs === "" ? [] : (differs.split(" ") as Finger[]);
  return <Hand states={states} side={side} moveMs={140} size="clamp(128px, 19vh, 210px)" differs={fingers} />;
});

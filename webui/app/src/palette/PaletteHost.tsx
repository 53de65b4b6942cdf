/** Shows the palette, and then what was chosen: a page, or the question of an act. */
import { Suspense, useEffect, useRef, useState } from "react";
import { useTranslation } from "react-i18next";
import { useLocation } from "wouter";
import { useLive, useProcessTexts } from "~/live/hooks";
import type { Place } from "~/places/places";
import { isObjectAct, type Act, type ActContext } from "./acts";
import type { Entry } from "./entries";
import { indexOf } from "./objects";
import { Palette } from "./Palette";
import { remember } from "./recents";
import type { Row } from "./search";

/** How long it says what was done. */
const DONE_MS = 8000;

interface PaletteHostProps {
  isOpen: boolean;
  onClose: () => void;
  places: readonly Place[];
  around: ActContext;
}

interface Asked {
  act: Act;
  subject: Entry | undefined;
  text: string;
}

export default function PaletteHost({ isOpen, onClose, places, around }: PaletteHostProps) {
  const { t } = useTranslation("palette");
  const [, go] = useLocation();
  const [asked, setAsked] = useState<Asked | null>(null);
  const [done, setDone] = useState("");
  const origin = useRef<Element | null>(null);

  const live = useLive();
  const texts = useProcessTexts();
  useEffect(() => indexOf(live).refresh(texts), [live, texts]); // before the first use
  useEffect(() => {
    if (done === "") return;
    const timer = setTimeout(() => setDone(""), DONE_MS);
    return () => clearTimeout(timer);
  }, [done]);
  const open = (address: string) => {
    go(address);
    afterFocusReturned(() => document.getElementById("content")?.focus());
  };
  const ask = (question: Asked) =>
    afterFocusReturned(() => {
      origin.current = document.activeElement;
      setAsked(question);
    });
  const closeQuestion = () => {
    setAsked(null);
    // The button that confirms is disabled while it acts, so that the dialog has no focus left to return.
    afterFocusReturned(() => {
      if (document.activeElement === document.body && origin.current instanceof HTMLElement) origin.current.focus();
    });
  };
  const choose = ({ id, kind, name, address, act, subject }: Row) => {
    setDone("");
    onClose();
    const lasting = act === undefined || !isObjectAct(act) ? { id, kind, name, address: address ?? "" } : subject;
    if (lasting !== undefined) remember(lasting);
    if (act?.question !== undefined) ask({ act, subject, text: name });
    else if (address !== undefined) open(address);
    else if (act !== undefined && !isObjectAct(act)) afterFocusReturned(() => void act.run?.(around));
  };
  const Question = asked?.act.question;
  return (
    <>
      {isOpen && <Palette places={places} around={around} onClose={onClose} onChoose={choose} />}
      {asked !== null && Question !== undefined && (
        <Suspense fallback={null}>
          <Question
            subject={asked.subject}
            onClose={closeQuestion}
            onDone={(address) => {
              setDone(t("done", { act: asked.text.replace(/ …$/, "") }));
              if (address !== undefined) open(address);
            }}
          />
        </Suspense>
      )}
      <p className={done === "" ? "visually-hidden" : "palette__done"} role="status">
        {done}
      </p>
    </>
  );
}

/** A dialog returns the focus in the frame after it has closed; the next one remembers where it was. */
function afterFocusReturned(act: () => void): void {
  requestAnimationFrame(() => requestAnimationFrame(act));
}

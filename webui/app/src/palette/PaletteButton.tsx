/** The button in the header that opens the palette, and its keys. The palette itself is loaded while the browser is idle, or at the first use. */
import { Search } from "lucide-react";
import { lazy, Suspense, useEffect, useState } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import type { Place } from "~/places/places";
import { isInputTaken } from "~/shell/keys";
import type { ActContext } from "./acts";
import { isPaletteKey, SHORTCUT } from "./shortcut";
import "./PaletteButton.css";

const load = () => import("./PaletteHost");
const PaletteHost = lazy(load);
/** Not before the page itself has what it needs. */
const PREFETCH_MS = 5000;

export function PaletteButton({ places, around }: { places: readonly Place[]; around: ActContext }) {
  const { t } = useTranslation("common");
  const [isOpen, setOpen] = useState(false);
  const [isWanted, setWanted] = useState(false);
  const open = () => {
    setWanted(true);
    setOpen(true);
  };
  useEffect(() => {
    const listen = (event: KeyboardEvent) => {
      if (!isPaletteKey(event) || event.defaultPrevented) return;
      event.preventDefault(); // a browser opens its own search
      if (!isInputTaken()) open();
    };
    document.addEventListener("keydown", listen);
    return () => document.removeEventListener("keydown", listen);
  }, []);
  useEffect(() => {
    const prepare = () => void load().then(() => setWanted(true), () => undefined); // the first use tries again
    const timer = setTimeout(() => ("requestIdleCallback" in window ? requestIdleCallback(prepare) : prepare()), PREFETCH_MS);
    return () => clearTimeout(timer);
  }, []);
  return (
    <>
      <div className="palette-button">
        <Button label={`${t("palette")} ${SHORTCUT}`} icon={<Search aria-hidden size={18} />} onPress={open}>
          <span className="palette-button__text">{t("palette")}</span> <kbd aria-hidden>{SHORTCUT}</kbd>
        </Button>
      </div>
      {isWanted && (
        <Suspense fallback={null}>
          <PaletteHost isOpen={isOpen} onClose={() => setOpen(false)} places={places} around={around} />
        </Suspense>
      )}
    </>
  );
}

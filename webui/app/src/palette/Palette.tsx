/**
 * The command palette: a dialog with a field and the list of what matches. The focus stays in the field; the arrow keys move the
 * cursor in the list (combobox with a listbox). Rows never change their place under the cursor: what arrives later follows.
 */
import { Search } from "lucide-react";
import { useEffect, useId, useMemo, useRef, useState, useSyncExternalStore, type KeyboardEvent } from "react";
import { Dialog, Modal, ModalOverlay } from "react-aria-components";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { useLive, useProcessTexts } from "~/live/hooks";
import type { LiveStore } from "~/live/store";
import type { Place } from "~/places/places";
import { isPaletteKey } from "./shortcut";
import type { ActContext } from "./acts";
import { FAMILY_NAMES, indexOf, type ObjectIndex } from "./objects";
import { pageEntries } from "./pages";
import { recents } from "./recents";
import { useRemote } from "./remote";
import { asRow, initialRows, kept, MAX_ROWS, rowsFor, type Row } from "./search";
import "./Palette.css";

/** Changes of the live store are taken over this often at most. */
const REFRESH_MS = 500;
const PAGE_ROWS = 8;

export interface PaletteProps {
  places: readonly Place[];
  around: ActContext;
  onClose: () => void;
  onChoose: (row: Row) => void;
}

interface Section {
  name: "recent" | "acts" | "pages" | null;
  rows: readonly Row[];
}

export function Palette({ places, around, onClose, onChoose }: PaletteProps) {
  const { t } = useTranslation(["palette", "common", "cases"]);
  const [query, setQuery] = useState("");
  const [cursor, setCursor] = useState<string | null>(null);
  const list = useRef<HTMLDivElement>(null);
  const id = useId();
  const { sections, isLoading, isIncomplete } = useSections(query, places, around);
  const rows = sections.flatMap((section) => section.rows);
  const at = Math.max(0, rows.findIndex((row) => row.id === cursor));
  const current = rows[at];
  const optionId = (row: Row) => `${id}-${row.id}`;

  useEffect(() => {
    list.current?.querySelector("[aria-selected=true]")?.scrollIntoView({ block: "nearest" });
  }, [current?.id]);

  const move = (to: number) => setCursor(rows[(to + rows.length) % Math.max(1, rows.length)]?.id ?? null);
  const onKeyDown = (event: KeyboardEvent) => {
    if (event.nativeEvent.isComposing) return;
    if (isPaletteKey(event.nativeEvent)) onClose();
    else if (event.key === "ArrowDown") move(at + 1);
    else if (event.key === "ArrowUp") move(at - 1);
    else if (event.key === "PageDown") move(Math.min(rows.length - 1, at + PAGE_ROWS));
    else if (event.key === "PageUp") move(Math.max(0, at - PAGE_ROWS));
    else if (event.key === "Enter" && !event.repeat && current !== undefined) onChoose(current);
    else return;
    event.preventDefault();
  };

  return (
    <ModalOverlay className="palette__overlay" isOpen onOpenChange={(isOpen) => !isOpen && onClose()} isDismissable>
      <Modal className="palette">
        <Dialog className="palette__dialog" aria-label={t("title")}>
          <div className="palette__field">
            <Search aria-hidden size={20} />
            <input
              role="combobox"
              aria-label={t("title")}
              aria-expanded={rows.length > 0}
              aria-controls={`${id}-list`}
              aria-autocomplete="list"
              aria-activedescendant={current === undefined ? undefined : optionId(current)}
              placeholder={t("placeholder")}
              value={query}
              onChange={(event) => {
                setQuery(event.target.value);
                setCursor(null);
              }}
              onKeyDown={onKeyDown}
              maxLength={200}
              autoComplete="off"
              autoCorrect="off"
              autoCapitalize="off"
              spellCheck={false}
              enterKeyHint="go"
              autoFocus
            />
            <Button kind="quiet" onPress={onClose}>
              {t("common:close")}
            </Button>
          </div>
          <div
            className="palette__list"
            role="listbox"
            id={`${id}-list`}
            aria-label={t("results")}
            ref={list}
            onMouseDown={(event) => event.preventDefault()} // the field keeps the focus
          >
            {sections.map(({ name, rows: of }) => (
              <div key={name} role={name === null ? "presentation" : "group"} aria-labelledby={name === null ? undefined : `${id}-${name}`}>
                {name !== null && (
                  <p className="palette__section" id={`${id}-${name}`} role="presentation">
                    {t(`section.${name}`)}
                  </p>
                )}
                {of.map((row) => (
                  <Option key={row.id} id={optionId(row)} row={row} isCurrent={row === current} onChoose={() => onChoose(row)} />
                ))}
              </div>
            ))}
          </div>
          {rows.length === 0 && !isLoading && <p className="palette__none">{t("none", { query: query.trim() })}</p>}
          <p className="palette__status" role="status">
            {query.trim() !== "" && (isLoading ? t("searching") : t(rows.length >= MAX_ROWS ? "many" : "count", { count: rows.length }))}
            {isIncomplete && ` ${t("incomplete")}`}
          </p>
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}

function Option({ id, row, isCurrent, onChoose }: { id: string; row: Row; isCurrent: boolean; onChoose: () => void }) {
  const { t } = useTranslation("palette");
  return (
    <div className="palette__option" role="option" id={id} aria-selected={isCurrent} onClick={onChoose}>
      <row.icon aria-hidden size={20} />
      <span className="palette__words">
        <span className="palette__name">{row.name}</span>
        {row.detail !== "" && <span className="palette__detail">{row.detail}</span>}
      </span>
      <span className="palette__kind">{t(`kind.${row.kind}`)}</span>
    </div>
  );
}

interface Shown {
  query: string;
  rows: readonly Row[];
}

/** The sections for a query; while the query is the same, rows keep their place. */
function useSections(query: string, places: readonly Place[], around: ActContext): { sections: readonly Section[]; isLoading: boolean; isIncomplete: boolean } {
  const { i18n } = useTranslation("palette");
  const texts = useProcessTexts();
  const index = useIndex();
  const [recent] = useState(recents);
  const remote = useRemote(query, around.services, texts);
  const pages = useMemo(() => pageEntries(places), [places, i18n.language]); // eslint-disable-line react-hooks/exhaustive-deps -- its texts are of this language
  const searched = { pages, entry: (of: string) => index.entry(of), recent, around };
  const [initial] = useState(() => initialRows({ ...searched, objects: [] }));
  const [shown, setShown] = useState<Shown>({ query: "", rows: [] });

  const key = JSON.stringify([query, remote.entries.length, remote.found.length]);
  const now = useMemo(() => {
    if (query.trim() === "") return [];
    const others = remote.entries.filter((entry) => index.entry(entry.id) === undefined);
    const rows = rowsFor(query, { ...searched, objects: [...index.entries, ...others] });
    const listed = new Set(rows.map(({ id }) => id));
    return [...rows, ...remote.found.filter(({ id }) => !listed.has(id)).map((entry) => asRow(index.entry(entry.id) ?? entry))];
  }, [key, index.entries]); // eslint-disable-line react-hooks/exhaustive-deps -- the other values follow from these

  const rows = useMemo(() => (shown.query === query ? kept(shown.rows, now) : now), [shown, query, now]);
  if (shown.query !== query || rows.length !== shown.rows.length) setShown({ query, rows });

  const sections: Section[] =
    query.trim() === ""
      ? (["recent", "pages", "acts"] as const).map((name) => ({ name, rows: initial[name] })).filter((section) => section.rows.length > 0)
      : [{ name: null, rows }];
  return { sections, isLoading: remote.isLoading, isIncomplete: remote.isIncomplete };
}

/** The index of the live store, which is refreshed now and then while the palette is open. */
function useIndex(): ObjectIndex {
  const live = useLive();
  const texts = useProcessTexts();
  const index = useMemo(() => indexOf(live), [live]);
  useState(() => index.refresh(texts)); // what has changed while nobody watched
  useEffect(() => live.subscribe("registeredDevices"), [live]);
  useSyncExternalStore(
    useMemo(() => watchSlowly(live, index, texts), [live, index, texts]),
    () => index.entries,
  );
  return index;
}

function watchSlowly(live: LiveStore, index: ObjectIndex, texts: ObjectIndex["texts"]): (listener: () => void) => () => void {
  return (listener) => {
    let timer: ReturnType<typeof setTimeout> | null = null;
    const later = () => {
      timer ??= setTimeout(() => {
        timer = null;
        index.refresh(texts);
        listener();
      }, REFRESH_MS);
    };
    later();
    const stops = [...FAMILY_NAMES.map((family) => live.watchFamily(family, later)), live.watch("services", later)];
    return () => {
      if (timer !== null) clearTimeout(timer);
      for (const stop of stops) stop();
    };
  };
}

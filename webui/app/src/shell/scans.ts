/**
 * Bar-code scanners type what they read: characters less than 35 ms apart (with a margin, `SCAN_GAP_MS`), then Enter. A scan goes into the text
 * field that has the input, or is discarded. Its Enter never presses a button and never submits a form.
 *
 * The filter listens before everything else on the page. The first character of a scan cannot be recognized when it arrives,
 * so that no single character may act: Space on a button and a character on a list take effect only when `SCAN_GAP_MS` have
 * passed without another key, and a key that moves a robot counts once it has been held for that long (`useKeyboard`).
 * Times are those of the events (`timeStamp`), so that a busy page does not make a scan look slow.
 */

export const SCAN_GAP_MS = 50;
/** From this number of characters on, an Enter that comes a little later also belongs to the scan. */
const MIN_SCAN_CHARACTERS = 3;
const LATE_ENTER_MS = 150;
/** Typed on a list within this time, characters are one word. */
const WORD_MS = 1000;

const MODIFIERS: ReadonlySet<string> = new Set(["Shift", "Control", "Alt", "AltGraph", "Meta", "CapsLock", "NumLock", "Fn"]);
/** What keyboards of scanners and phones send instead of a character. */
const CHARACTER_NAMES: ReadonlySet<string> = new Set(["Unidentified", "Process", "Dead"]);
const TEXT_FIELD =
  "input:not([type=button], [type=checkbox], [type=color], [type=file], [type=image], [type=radio], [type=range], [type=reset], [type=submit]), textarea, [contenteditable]:not([contenteditable=false])";
const MULTI_LINE = "textarea, [contenteditable]:not([contenteditable=false])";
const PRESSED_BY_SPACE = "button, [role=button], [role=switch], summary, input[type=button], input[type=checkbox], input[type=radio], input[type=submit]";
/** A control that assigns keys receives them all. */
const RECEIVES_KEYS = "[data-takes-keys]";
/** A field that is made for a scan, such as that of a badge: its form may be submitted by the scan. */
const RECEIVES_SCANS = "[data-takes-scans]";

/** Receives keys before the page, such as the control of a robot; returns whether it has used the key. */
export type KeyReceiver = (event: KeyboardEvent) => boolean;

const receivers = new Set<KeyReceiver>();
let presses = 0;

export function addKeyReceiver(receiver: KeyReceiver): () => void {
  receivers.add(receiver);
  return () => receivers.delete(receiver);
}

/** How many keys have been pressed, also those that were discarded. */
export function keyPresses(): number {
  return presses;
}

/** A run of characters that were typed faster than by a person. */
class Run {
  #at = -Infinity;
  #characters = 0;

  /** Add a key; returns whether it continues a scan. */
  add({ key, timeStamp, ctrlKey, metaKey }: KeyboardEvent): boolean {
    const gap = timeStamp - this.#at;
    const isFast = gap < SCAN_GAP_MS;
    const isScanned = this.#characters > 0 && (isFast || (key === "Enter" && this.#characters >= MIN_SCAN_CHARACTERS && gap < LATE_ENTER_MS));
    const isCharacter = (key.length === 1 || CHARACTER_NAMES.has(key)) && !ctrlKey && !metaKey;
    this.#at = timeStamp;
    this.#characters = (isFast ? this.#characters : 0) + (isCharacter ? 1 : 0);
    return isScanned;
  }
}

/** Discard scans on this page from now on; returns how to stop. */
export function discardScans(): () => void {
  const run = new Run();
  const word = new Word();
  const onKeyDown = (event: KeyboardEvent) => {
    if (MODIFIERS.has(event.key)) return;
    const target = targetOf(event);
    const hasModifier = event.ctrlKey || event.metaKey;
    const isScanned = !event.repeat && run.add(event) && !hasModifier;
    if (!event.repeat) presses += 1;
    if (target.closest(RECEIVES_KEYS) !== null) return;
    const isText = target.closest(TEXT_FIELD) !== null;
    const pressed = event.key === "Enter" || event.key === " " ? target.closest<HTMLElement>(PRESSED_BY_SPACE) : null;
    if (!isText && [...receivers].some((receive) => receive(event))) event.stopImmediatePropagation();
    else if (event.repeat) {
      if (pressed !== null) discard(event); // a key that is held down presses a button once
    } else if (event.key === "Enter") {
      if (isScanned && target.closest(RECEIVES_SCANS) === null) discard(event, target.closest(MULTI_LINE) !== null);
    } else if (isText || event.key.length !== 1 || hasModifier) {
      return;
    } else if (isScanned) discard(event);
    else if (pressed !== null) {
      discard(event);
      unlessFollowed(() => pressed.click());
    } else if (target instanceof HTMLSelectElement && event.key !== " " && !event.altKey) {
      discard(event);
      unlessFollowed(() => word.add(event, target));
    }
  };
  // The release of Space would press what its press has not.
  const onKeyUp = (event: KeyboardEvent) => {
    const target = targetOf(event);
    if (event.key === " " && target.closest(PRESSED_BY_SPACE) !== null && target.closest(RECEIVES_KEYS) === null) event.preventDefault();
  };
  addEventListener("keydown", onKeyDown, true);
  addEventListener("keyup", onKeyUp, true);
  return () => {
    removeEventListener("keydown", onKeyDown, true);
    removeEventListener("keyup", onKeyUp, true);
  };
}

function targetOf({ target }: KeyboardEvent): Element {
  return target instanceof Element ? target : document.body;
}

function discard(event: KeyboardEvent, keepsDefault = false): void {
  event.stopImmediatePropagation();
  if (!keepsDefault) event.preventDefault();
}

/** Act after the gap of a scan, unless another key has been pressed by then. */
function unlessFollowed(act: () => void): void {
  const before = presses;
  setTimeout(() => {
    if (presses === before) act();
  }, SCAN_GAP_MS);
}

/** Selects the option of a closed list that begins with what is typed, as the browser would. */
class Word {
  #text = "";
  #at = -Infinity;

  add({ key, timeStamp }: KeyboardEvent, list: HTMLSelectElement): void {
    this.#text = (timeStamp - this.#at < WORD_MS ? this.#text : "") + key.toLowerCase();
    this.#at = timeStamp;
    const isOneLetter = this.#text === key.toLowerCase().repeat(this.#text.length);
    const text = isOneLetter ? key.toLowerCase() : this.#text;
    const from = list.selectedIndex + (isOneLetter ? 1 : 0);
    const options = [...list.options].map((_, index, all) => all[(from + index) % all.length]);
    const match = options.find((option) => option?.disabled === false && option.text.trim().toLowerCase().startsWith(text));
    if (match === undefined || match.selected) return;
    match.selected = true;
    list.dispatchEvent(new Event("change", { bubbles: true }));
  }
}

/**
 * The words of a text as they are compared: lower case, without diacritics, split at everything but letters and digits.
 *
 * "Prüfung bin-picking" has the words prufung, pruefung, bin, picking and binpicking, so that it is found however somebody types it.
 */

const MARKS = /\p{M}+/gu;
const SEPARATORS = /[^\p{L}\p{N}]+/u;
const LETTERS: Readonly<Record<string, string>> = { ß: "ss", æ: "ae", œ: "oe", ø: "o", ł: "l", đ: "d", ð: "d", þ: "th", ı: "i", ς: "σ" };
const OTHER_LETTERS = /[ßæœøłđðþıς]/gu;
/** Umlauts as they are typed without their keys. */
const UMLAUTS: Readonly<Record<string, string>> = { ä: "ae", ö: "oe", ü: "ue" };
const ANY_UMLAUT = /[äöü]/gu;
const IS_ASCII = /^[\x00-\x7f]*$/u; // eslint-disable-line no-control-regex -- most names are, and need no more

/** A text as it is compared; `folded(a) === folded(b)` for texts that differ in case or diacritics only. */
export function folded(text: string): string {
  const lower = text.toLowerCase();
  if (IS_ASCII.test(lower)) return lower;
  return lower.normalize("NFKD").replace(MARKS, "").toLowerCase().replace(OTHER_LETTERS, (letter) => LETTERS[letter] ?? letter);
}

/** The words by which a text is found. */
export function wordsOf(text: string): readonly string[] {
  const words = new Set<string>();
  const add = (chunk: string) => {
    const parts = partsOf(chunk);
    for (const part of parts) words.add(part);
    if (parts.length > 1) words.add(parts.join(""));
  };
  for (const chunk of text.split(/\s+/u)) {
    add(chunk);
    const spelled = IS_ASCII.test(chunk) ? chunk : chunk.toLowerCase().normalize("NFC").replace(ANY_UMLAUT, (letter) => UMLAUTS[letter] ?? letter);
    if (spelled !== chunk) add(spelled);
  }
  return [...words];
}

/** The words that somebody has typed. */
export function typedWords(query: string): readonly string[] {
  return [...new Set(partsOf(query))];
}

function partsOf(text: string): string[] {
  return folded(text).split(SEPARATORS).filter((part) => part !== "");
}

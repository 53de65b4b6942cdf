/** Everything is found by each word of its name, however it is written; what was used lately comes first. */
import { describe, expect, it } from "vitest";
import { ranked, wordNumbers, type Candidate } from "./ranking";
import { folded, typedWords } from "./words";

/** A generator of numbers below `limit` that is the same in each run (mulberry32). */
function numbers(seed: number): (limit: number) => number {
  let state = seed;
  return (limit) => {
    state = (state + 0x6d2b79f5) | 0;
    let mixed = Math.imul(state ^ (state >>> 15), 1 | state);
    mixed = (mixed + Math.imul(mixed ^ (mixed >>> 7), 61 | mixed)) ^ mixed;
    return ((mixed ^ (mixed >>> 14)) >>> 0) % limit;
  };
}

const LETTERS = Array.from("abcdefghijklmnopqrstuvwxyzäöüßéèåøñçžșıабвгдeλσς0123456789");
const SEPARATORS = [" ", "  ", "-", "_", " · ", ", ", "/", " (", "."];

function names(seed: number, count: number): string[] {
  const below = numbers(seed);
  const word = () => {
    const text = Array.from({ length: 1 + below(9) }, () => LETTERS[below(LETTERS.length)] ?? "a").join("");
    return below(3) === 0 ? text.charAt(0).toUpperCase() + text.slice(1) : text;
  };
  return Array.from({ length: count }, () => Array.from({ length: 1 + below(4) }, word).reduce((name, next) => `${name}${SEPARATORS[below(SEPARATORS.length)] ?? " "}${next}`));
}

function candidate(name: string, id = name, more = ""): Candidate {
  return { id, name, words: wordNumbers(name), moreWords: wordNumbers(more), weight: 0 };
}

const all = names(7, 150).map((name, index) => candidate(name, `${index}`));
const idsOf = (query: string, recent: string[] = []) => ranked(all, query, recent).map(({ id }) => id);

describe("each object", () => {
  it("is found by each word of its name, by its whole name, and by each beginning of a word", () => {
    for (const { id, name } of all) {
      expect(idsOf(name), name).toContain(id);
      for (const word of name.split(/[^\p{L}\p{N}]+/u).filter((part) => part !== "")) {
        expect(idsOf(word), `${name} by ${word}`).toContain(id);
        expect(idsOf(word.slice(0, 2)), `${name} by the beginning of ${word}`).toContain(id);
      }
    }
  });

  it("is found in any case, without diacritics, and composed or decomposed", () => {
    for (const { id, name } of all) {
      for (const written of [name.toUpperCase(), name.toLowerCase(), name.normalize("NFD"), name.normalize("NFD").replace(/\p{M}/gu, "")]) {
        expect(idsOf(written), `${name} as ${written}`).toContain(id);
      }
    }
  });

  it("is found by its words in any order, and with the hyphens left out", () => {
    for (const { id, name } of all) {
      const words = [...typedWords(name)].reverse();
      expect(idsOf(words.join(" ")), name).toContain(id);
      for (const chunk of name.split(/\s+/u)) expect(idsOf(chunk.replace(/[-_/().,·]/gu, "")).length > 0 || typedWords(chunk).length === 0, chunk).toBe(true);
    }
  });
});

it.each([
  ["Prüfung", "prufung"],
  ["Prüfung", "PRUEFUNG"],
  ["Prüfung", "prüf"],
  ["Löten", "loeten"],
  ["Straße 7", "STRASSE"],
  ["Päivä", "paiva"],
  ["bin-picking", "binpicking"],
  ["bin-picking", "bin-pick"],
  ["ur10-1", "ur10 1"],
  ["ur10-1", "ur101"],
  ["Temperature", "temprature"], // typos: ignore
  ["Temperature", "tempreature"], // typos: ignore
  ["Temperature", "temperatrue"], // typos: ignore
  ["Temperature", "temperazur"], // typos: ignore
])("finds %s by %s", (name, query) => {
  expect(ranked([candidate(name), candidate("Something else")], query).map((match) => match.name)).toEqual([name]);
});

it("finds nothing for what nothing has, and for nothing", () => {
  expect(idsOf("qqqqqqqqqq")).toEqual([]);
  expect(idsOf("")).toEqual([]);
  expect(idsOf(" -· ")).toEqual([]);
});

it("puts what was used lately first, in that order, among what matches as well", () => {
  const robots = ["ur10-1", "ur10-2", "ur10-3", "ur10-4"].map((name) => candidate(name));
  const found = (recent: string[]) => ranked(robots, "ur", recent).map(({ id }) => id);
  expect(found([])).toEqual(["ur10-1", "ur10-2", "ur10-3", "ur10-4"]);
  expect(found(["ur10-3", "ur10-4"])).toEqual(["ur10-3", "ur10-4", "ur10-1", "ur10-2"]);
  for (const { id, name } of all.slice(0, 100)) {
    const query = typedWords(name)[0] ?? "";
    const first = idsOf(query)[0];
    const isAsGood = all.find((other) => other.id === first)?.name.split(/[^\p{L}\p{N}]+/u).some((word) => folded(word).startsWith(query)) === true;
    if (isAsGood) expect(idsOf(query, [id])[0]).toBe(id);
  }
});

it("puts whole words before beginnings, these before parts, and names before ids", () => {
  const objects = [candidate("Scan the bin"), candidate("Binder"), candidate("Cabin"), candidate("Empty", "x", "bin-picking-7")];
  expect(ranked(objects, "bin").map(({ name }) => name)).toEqual(["Scan the bin", "Binder", "Empty", "Cabin"]);
});

it("has the same order with a limit as without one", () => {
  for (const { name } of all.slice(0, 100)) {
    const query = name.slice(0, 1);
    for (const limit of [1, 7, 50]) expect(ranked(all, query, ["3", "5"], limit)).toEqual(ranked(all, query, ["3", "5"]).slice(0, limit));
  }
});

it("folds a text that is folded to itself", () => {
  for (const { name } of all) expect(folded(folded(name))).toBe(folded(name));
});

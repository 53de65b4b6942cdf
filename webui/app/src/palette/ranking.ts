/**
 * Ranks candidates by what is typed. Each word is stored once, with a number; a typed word is compared with all stored words, and
 * what a candidate scores is then looked up by the numbers of its words, which are far fewer than the words of ten thousand names. A candidate matches if each typed word matches one of its words: as the whole word, as its
 * beginning, or within it. Only where this finds little, words with one wrong, missing, added or exchanged letter count too.
 *
 * What was used lately comes before what matches as well. The order depends on nothing else than the candidates and the query.
 */
import { typedWords, wordsOf } from "./words";

export interface Candidate {
  readonly id: string;
  readonly name: string;
  /** Numbers of the words of the name. */
  readonly words: readonly number[];
  /** Numbers of other words by which it is found: ids, keys, the name of what it is in. */
  readonly moreWords: readonly number[];
  /** Among equal matches the higher comes first; 0 to 9. */
  readonly weight: number;
}

/** All words that a name has had since the page was opened, by their number. */
const vocabulary: string[] = [];
const numbers = new Map<string, number>();
const MAX_TEXTS = 20_000;
const texts = new Map<string, readonly number[]>();

/** The numbers of the words of a text. */
export function wordNumbers(text: string): readonly number[] {
  let words = texts.get(text);
  if (words === undefined) {
    words = wordsOf(text).map(numberOf);
    if (texts.size >= MAX_TEXTS) texts.clear();
    texts.set(text, words);
  }
  return words;
}

function numberOf(word: string): number {
  let number = numbers.get(word);
  if (number === undefined) {
    number = vocabulary.push(word) - 1;
    numbers.set(word, number);
  }
  return number;
}

/** From this number of results on, words with a wrong letter are not searched. */
const ENOUGH = 8;
const MIN_INSIDE = 2;
const MIN_INEXACT = 4;

/** How well a typed word matches a word; a higher one is better. */
const NONE = 0;
const INEXACT = 1;
const WITHIN = 2;
const BEGINNING = 3;
const WHOLE = 4;
/** A beginning is as good as a whole word: nobody types more than necessary. */
const QUALITY = [0, 1, 2, 3, 3] as const;
const IN_NAME = [0, 3, 5, 9, 12] as const;
const IN_MORE = [0, 1, 3, 5, 7] as const;

interface Ranked<C> {
  candidate: C;
  score: number;
}

/** The candidates that match, the best first. `recent` has ids, the last used first. */
export function ranked<C extends Candidate>(candidates: readonly C[], query: string, recent: readonly string[] = [], limit = Infinity): C[] {
  const typed = typedWords(query);
  if (typed.length === 0) return [];
  const recency = new Map(recent.map((id, place) => [id, recent.length - place]));
  const exact = best(candidates, typed.map((word) => matchesOf(word, false)), recency, limit);
  const matches = exact.length < ENOUGH ? best(candidates, typed.map((word) => matchesOf(word, true)), recency, limit) : exact;
  return matches.map(({ candidate }) => candidate);
}

/** How well a typed word matches each word of the vocabulary. */
function matchesOf(typed: string, isInexact: boolean): Uint8Array {
  const matches = new Uint8Array(vocabulary.length);
  vocabulary.forEach((word, number) => {
    matches[number] = matchOf(word, typed, isInexact);
  });
  return matches;
}

function matchOf(word: string, typed: string, isInexact: boolean): number {
  if (word.startsWith(typed)) return word.length === typed.length ? WHOLE : BEGINNING;
  if (typed.length >= MIN_INSIDE && word.includes(typed)) return WITHIN;
  return isInexact && beginsAlmost(word, typed) ? INEXACT : NONE;
}

function best<C extends Candidate>(candidates: readonly C[], typed: readonly Uint8Array[], recency: ReadonlyMap<string, number>, limit: number): Ranked<C>[] {
  const matches: Ranked<C>[] = [];
  for (const candidate of candidates) {
    const score = scoreOf(candidate, typed);
    if (score === 0) continue;
    const match = { candidate, score: score + Math.min(recency.get(candidate.id) ?? 0, 50) * 100 };
    if (limit === Infinity) matches.push(match);
    else insert(matches, match, limit);
  }
  return limit === Infinity ? matches.sort(compare) : matches;
}

/** Insert into the sorted `limit` best matches: most candidates cost one comparison, with the last of these. */
function insert<C extends Candidate>(matches: Ranked<C>[], match: Ranked<C>, limit: number): void {
  const last = matches[limit - 1];
  if (last !== undefined && compare(last, match) < 0) return;
  let place = matches.length;
  for (let before = matches[place - 1]; before !== undefined && compare(match, before) < 0; before = matches[place - 1]) place -= 1;
  matches.splice(place, 0, match);
  matches.length = Math.min(matches.length, limit);
}

function compare(a: Ranked<Candidate>, b: Ranked<Candidate>): number {
  return b.score - a.score || compareText(a.candidate.name, b.candidate.name) || compareText(a.candidate.id, b.candidate.id);
}

function compareText(a: string, b: string): number {
  return a < b ? -1 : a > b ? 1 : 0;
}

/**
 * 0 if a word does not match. The quality of the worst word decides (10 000 each), then recency (100 each, at most 5 000), then how
 * well the words match on average and the weight (below 100).
 */
function scoreOf({ words, moreWords, weight }: Candidate, typed: readonly Uint8Array[]): number {
  let quality = Infinity;
  let sum = 0;
  for (const matches of typed) {
    const inName = highest(words, matches);
    const inMore = inName >= BEGINNING ? NONE : highest(moreWords, matches);
    if (inName === NONE && inMore === NONE) return 0;
    quality = Math.min(quality, QUALITY[Math.max(inName, inMore)] ?? 0);
    sum += Math.max(IN_NAME[inName] ?? 0, IN_MORE[inMore] ?? 0);
  }
  return quality * 10_000 + (sum / typed.length) * 7 + weight;
}

function highest(words: readonly number[], matches: Uint8Array): number {
  let highestMatch = NONE;
  for (const word of words) highestMatch = Math.max(highestMatch, matches[word] ?? NONE);
  return highestMatch;
}

/** Whether a word begins with what is typed but for one letter, which is not the first. */
export function beginsAlmost(word: string, typed: string): boolean {
  if (typed.length < MIN_INEXACT || !word.startsWith(typed.charAt(0))) return false;
  let same = 1;
  while (same < typed.length && word.charAt(same) === typed.charAt(same)) same += 1;
  return (
    word.startsWith(typed.slice(same + 1), same + 1) || // another letter
    word.startsWith(typed.slice(same + 1), same) || // a letter too many
    word.startsWith(typed.slice(same), same + 1) || // a letter too few
    (word.charAt(same) === typed.charAt(same + 1) && word.charAt(same + 1) === typed.charAt(same) && word.startsWith(typed.slice(same + 2), same + 2))
  );
}

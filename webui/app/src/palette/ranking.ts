/**
 * Ranks candidates by what is typed. A candidate matches if each typed word matches one of its words: as the whole word, as its
 * beginning, or within it. Only where this finds little, words with one wrong, missing, added or exchanged letter count too.
 *
 * What was used lately comes before what matches as well. The order depends on nothing else than the candidates and the query.
 */
import { typedWords, wordsOf } from "./words";

export interface Candidate {
  readonly id: string;
  readonly name: string;
  /** Words of the name. */
  readonly words: readonly string[];
  /** Words of what is not shown first: ids, keys, the name in which it is. */
  readonly moreWords: readonly string[];
  /** Among equal matches the higher comes first; 0 to 9. */
  readonly weight: number;
}

export function candidateWords(name: string, more: string): Pick<Candidate, "words" | "moreWords"> {
  return { words: wordsOf(name), moreWords: wordsOf(more) };
}

/** From this number of results on, words with a wrong letter are not searched. */
const ENOUGH = 8;
const MIN_INSIDE = 2;
const MIN_INEXACT = 4;

const QUALITY = { whole: 3, beginning: 3, within: 2, inexact: 1 } as const;
const OF_NAME = { whole: 12, beginning: 9, within: 5, inexact: 3 } as const;
const OF_MORE = { whole: 7, beginning: 5, within: 3, inexact: 1 } as const;
type Match = keyof typeof QUALITY;

interface Ranked<C> {
  candidate: C;
  score: number;
}

/** The candidates that match, the best first. `recent` has ids, the last used first. */
export function ranked<C extends Candidate>(candidates: readonly C[], query: string, recent: readonly string[] = [], limit = Infinity): C[] {
  const typed = typedWords(query);
  if (typed.length === 0) return [];
  const recency = new Map(recent.map((id, place) => [id, recent.length - place]));
  const search = (isInexact: boolean): Ranked<C>[] => {
    const matches: Ranked<C>[] = [];
    for (const candidate of candidates) {
      const score = scoreOf(candidate, typed, isInexact);
      if (score > 0) matches.push({ candidate, score: score + Math.min(recency.get(candidate.id) ?? 0, 50) * 100 });
    }
    return matches;
  };
  const exact = search(false);
  const matches = exact.length < ENOUGH ? search(true) : exact;
  return matches.sort(compare).slice(0, limit).map(({ candidate }) => candidate);
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
function scoreOf({ words, moreWords, weight }: Candidate, typed: readonly string[], isInexact: boolean): number {
  let quality: number = QUALITY.whole;
  let sum = 0;
  for (const word of typed) {
    const inName = bestMatch(words, word, isInexact);
    const inMore = inName === "whole" || inName === "beginning" ? null : bestMatch(moreWords, word, isInexact);
    if (inName === null && inMore === null) return 0;
    const best = Math.max(inName === null ? 0 : QUALITY[inName], inMore === null ? 0 : QUALITY[inMore]);
    quality = Math.min(quality, best);
    sum += Math.max(inName === null ? 0 : OF_NAME[inName], inMore === null ? 0 : OF_MORE[inMore]);
  }
  return quality * 10_000 + (sum / typed.length) * 7 + weight;
}

function bestMatch(words: readonly string[], typed: string, isInexact: boolean): Match | null {
  let best: Match | null = null;
  for (const word of words) {
    if (word.startsWith(typed)) {
      if (word.length === typed.length) return "whole";
      best = "beginning";
    } else if (best === null || best === "inexact") {
      if (typed.length >= MIN_INSIDE && word.includes(typed)) best = "within";
      else if (isInexact && best === null && beginsAlmost(word, typed)) best = "inexact";
    }
  }
  return best;
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

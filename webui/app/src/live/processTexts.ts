/**
 * The texts of processes in the language of the page. A BPMN file is written in one language and has
 * translations of its texts; what the page receives of the file is translated as it arrives, in one place. What a
 * process has as data (variables, inputs, results) is never changed, and neither are ids.
 */
import type { DefinitionView } from "~/api/generated/task-orchestrator";

type Texts = ReadonlyMap<string, string>;

interface Pattern {
  /** What stands before, between and after the placeholders. */
  parts: readonly string[];
  /** The placeholders, one fewer than `parts`. */
  names: readonly string[];
  translation: string;
}

/** Members that people read, in whatever object they stand. */
const READ = new Set(["title", "description", "label", "hint", "processTitle"]);
/** Members with data of a process. */
const DATA = new Set(["variables", "parameters", "inputs", "outputs", "workParameters", "outputParameters", "attributes", "before", "after", "values", "value", "initial", "translations"]);
/** `${part}` in a text: something else stands there in each Task. */
const PLACEHOLDER = /[$#]\{[^}]*\}/g;

/** Behind the title in the name of a process. */
const NUMBER_OR_KEY = /^(?:$| \d+$| · )/;

export class ProcessTexts {
  readonly #texts: Texts;
  readonly #others: ProcessTexts | null;
  readonly #patterns: readonly Pattern[];
  readonly #own = new Map<string, ProcessTexts>();
  readonly #localized = new WeakMap<object, unknown>();

  /** What has no translation in `texts` may have one in `others`. */
  constructor(texts: Texts, others: ProcessTexts | null = null) {
    this.#texts = texts;
    this.#others = others;
    this.#patterns = [...texts].filter(([source]) => source.search(PLACEHOLDER) >= 0).map(([source, translation]) => patternOf(source, translation)).filter(isDistinct);
  }

  get isEmpty(): boolean {
    return this.#texts.size === 0 && (this.#others?.isEmpty ?? true);
  }

  /** Return the texts as a definition translates them; what it does not translate is as in the others. */
  of(definition: string): ProcessTexts {
    return this.#own.get(definition) ?? this;
  }

  add(definition: string, texts: Texts): void {
    this.#own.set(definition, new ProcessTexts(texts, this));
  }

  /** Return a text of a BPMN file in the language of the page; as it is if there is no translation. */
  say(text: string): string {
    const plain = text.replace(/\s+/g, " ").trim();
    const known = this.#texts.get(text) ?? this.#texts.get(plain);
    if (known !== undefined) return known;
    for (const pattern of this.#patterns) {
      const found = matched(pattern, plain);
      if (found !== null) return filled(pattern, found);
    }
    return this.#others?.say(text) ?? text;
  }

  /** Return a document of the orchestrator, or a live value, with its texts in the language of the page. */
  localized<T>(value: T): T {
    if (this.isEmpty || typeof value !== "object" || value === null) return value;
    let known = this.#localized.get(value);
    if (known === undefined) {
      known = Array.isArray(value) ? this.#list(value) : this.#members(value as Record<string, unknown>);
      this.#localized.set(value, known);
    }
    return known as T;
  }

  #list(values: unknown[]): unknown[] {
    const found = values.map((each) => this.localized(each));
    return found.every((each, nth) => each === values[nth]) ? values : found;
  }

  #members(values: Record<string, unknown>): Record<string, unknown> {
    const texts = this.#textsFor(values);
    const changed: Record<string, unknown> = {};
    for (const [name, value] of Object.entries(values)) {
      const found = typeof value === "string" ? texts.#member(name, value, values) : DATA.has(name) ? value : name === "properties" ? texts.#properties(value) : texts.localized(value);
      if (found !== value) changed[name] = found;
    }
    return Object.keys(changed).length === 0 ? values : { ...values, ...changed };
  }

  /** Return the properties of a JSON Schema; their names are those of data, but what they have is read. */
  #properties(value: unknown): unknown {
    if (typeof value !== "object" || value === null || Array.isArray(value)) return this.localized(value);
    const found = Object.entries(value).map(([name, schema]) => [name, this.localized(schema as unknown), schema] as const);
    return found.every(([, localized, schema]) => localized === schema) ? value : Object.fromEntries(found);
  }

  /** Return the texts of the definition that a document is, or is of. */
  #textsFor(values: Record<string, unknown>): ProcessTexts {
    const { definition, name } = values;
    if (typeof definition === "string" && ("version" in values || "title" in values)) return (this.#others ?? this).of(definition);
    return typeof name === "string" && "translations" in values ? (this.#others ?? this).of(name) : this;
  }

  #member(name: string, value: string, of: Record<string, unknown>): string {
    if (READ.has(name)) return this.say(value);
    if (name === "processName") return this.#sayName(value, of["processTitle"]);
    if (name !== "name") return value;
    // The name of an element; that of a definition or parameter is an id.
    if ("element" in of || "lane" in of) return this.say(value);
    return "definition" in of && "title" in of ? this.#sayName(value, of["title"]) : value;
  }

  /** Return the name of a process: the title of its definition with a number or key, or what a title expression yields. */
  #sayName(name: string, title: unknown): string {
    const rest = typeof title === "string" && name.startsWith(title) ? name.slice(title.length) : null;
    return typeof title === "string" && rest !== null && NUMBER_OR_KEY.test(rest) ? this.say(title) + rest : this.say(name);
  }
}

/** Return the texts of all definitions in a language, which may have a region (de-AT). */
export function processTextsOf(definitions: readonly Pick<DefinitionView, "name" | "translations">[], language: string): ProcessTexts {
  const own = definitions.map(({ name, translations }) => [name, ownTexts(translations, language)] as const);
  const texts = new ProcessTexts(new Map(own.flatMap(([, translated]) => [...translated])));
  for (const [name, translated] of own) texts.add(name, translated);
  return texts;
}

/** Return the texts in a language: of its region first, then without one, then of another region. */
function ownTexts(translations: DefinitionView["translations"], language: string): Texts {
  const base = language.split("-")[0] ?? language;
  const rank = (of: string) => (of === language ? 2 : of === base ? 1 : 0);
  const found = Object.entries(translations).filter(([of]) => of === base || of.startsWith(`${base}-`));
  return new Map(found.sort(([one], [other]) => rank(one) - rank(other)).flatMap(([, translated]) => Object.entries(translated)));
}

function patternOf(source: string, translation: string): Pattern {
  return { parts: source.split(PLACEHOLDER), names: source.match(PLACEHOLDER) ?? [], translation };
}

/** Whether a pattern has words of its own; one without them would match every text. */
function isDistinct({ parts }: Pattern): boolean {
  return parts.some((part) => /\p{L}/u.test(part));
}

/** Return what stands for the placeholders, the shortest first; null if the text is another. Takes linear time. */
function matched({ parts }: Pattern, text: string): string[] | null {
  const [first = "", last = ""] = [parts[0], parts.at(-1)];
  const end = text.length - last.length;
  if (first.length > end || !text.startsWith(first) || !text.endsWith(last)) return null;
  const values: string[] = [];
  let at = first.length;
  for (const part of parts.slice(1, -1)) {
    const next = text.indexOf(part, at);
    if (next < 0 || next + part.length > end) return null;
    values.push(text.slice(at, next));
    at = next + part.length;
  }
  return [...values, text.slice(at, end)];
}

function filled({ names, translation }: Pattern, values: readonly string[]): string {
  return translation.replace(PLACEHOLDER, (name: string) => values[names.indexOf(name)] ?? name);
}

/**
 * The texts of processes in the language of the page. A BPMN file is written in one language and has
 * translations of its texts; what the page receives of the file is translated as it arrives, in one place. What a
 * process has as data (variables, inputs, results) is never changed, and neither are ids.
 */
import type { DefinitionView } from "~/api/generated/task-orchestrator";

type Texts = ReadonlyMap<string, string>;

interface Pattern {
  source: RegExp;
  /** The placeholders, in the order of the groups of `source`. */
  names: readonly string[];
  translation: string;
}

/** Members that people read, in whatever object they stand. */
const READ = new Set(["title", "description", "label", "hint", "processTitle"]);
/** Members with data of a process. */
const DATA = new Set(["variables", "parameters", "inputs", "outputs", "outputParameters", "values", "value", "initial", "translations"]);
/** `${part}` in a text: something else stands there in each Task. */
const PLACEHOLDER = /[$#]\{[^}]*\}/g;

export class ProcessTexts {
  readonly #texts: Texts;
  readonly #titles: Texts;
  readonly #patterns: readonly Pattern[];
  readonly #localized = new WeakMap<object, unknown>();

  constructor(texts: Texts, titles: Texts) {
    this.#texts = texts;
    this.#titles = titles;
    this.#patterns = [...texts].filter(([source]) => source.search(PLACEHOLDER) >= 0).map(([source, translation]) => patternOf(source, translation));
  }

  get isEmpty(): boolean {
    return this.#texts.size === 0;
  }

  /** Return a text of a BPMN file in the language of the page; as it is if there is no translation. */
  say(text: string): string {
    const known = this.#texts.get(text) ?? this.#texts.get(text.replace(/\s+/g, " ").trim());
    if (known !== undefined) return known;
    for (const pattern of this.#patterns) {
      const found = pattern.source.exec(text);
      if (found !== null) return filled(pattern, found.slice(1));
    }
    return text;
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
    const changed: Record<string, unknown> = {};
    for (const [name, value] of Object.entries(values)) {
      const found = typeof value === "string" ? this.#member(name, value, values) : DATA.has(name) ? value : this.localized(value);
      if (found !== value) changed[name] = found;
    }
    return Object.keys(changed).length === 0 ? values : { ...values, ...changed };
  }

  #member(name: string, value: string, of: Record<string, unknown>): string {
    if (READ.has(name)) return this.say(value);
    if (name === "processName") return this.#sayName(value);
    if (name !== "name") return value;
    if ("definition" in of && "title" in of) return this.#sayName(value);
    // The name of an element; that of a definition or parameter is an id.
    return "element" in of || "lane" in of ? this.say(value) : value;
  }

  /** Return the name of a process, which begins with the title of its definition unless it has its own. */
  #sayName(name: string): string {
    for (const [title, translation] of this.#titles) {
      if (name === title || name.startsWith(`${title} `)) return translation + name.slice(title.length);
    }
    return name;
  }
}

/** Return the texts of all definitions in a language, which may have a region (de-AT). */
export function processTextsOf(definitions: readonly Pick<DefinitionView, "title" | "translations">[], language: string): ProcessTexts {
  const texts = new Map<string, string>();
  const titles = new Map<string, string>();
  for (const { title, translations } of definitions) {
    const of = new Map(Object.entries(translations));
    const own = new Map(Object.entries(of.get(language) ?? of.get(language.split("-")[0] ?? "") ?? {}));
    for (const [source, translation] of own) texts.set(source, translation);
    const named = own.get(title);
    if (named !== undefined) titles.set(title, named);
  }
  return new ProcessTexts(texts, titles);
}

function patternOf(source: string, translation: string): Pattern {
  const parts = source.split(PLACEHOLDER).map((part) => part.replace(/[.*+?^${}()|[\]\\]/g, "\\$&"));
  return { source: new RegExp(`^${parts.join("(.*?)")}$`, "s"), names: source.match(PLACEHOLDER) ?? [], translation };
}

function filled({ names, translation }: Pattern, values: readonly string[]): string {
  return translation.replace(PLACEHOLDER, (name: string) => values[names.indexOf(name)] ?? name);
}

/**
 * What the page knows: the newest value of every topic, and the last events. React parts subscribe to the
 * topics they show; whoever shows a hand is not drawn anew because a robot moved.
 */
import type { Batch, LiveEvent, TopicValues } from "./messages";

export type Link = "connecting" | "open" | "lost";

const KEPT_EVENTS = 500;

type Listener = () => void;

export class LiveStore {
  readonly #topics = new Map<string, unknown>();
  readonly #watchers = new Map<string, Set<Listener>>();
  readonly #families = new Map<string, Set<Listener>>();
  readonly #wanted = new Map<string, number>();
  #lists = new Map<string, unknown[]>();
  #events: LiveEvent[] = [];
  #link: Link = "connecting";
  #told = false;
  /** Called when what the page wants beyond the usual topics has changed. */
  onWant: () => void = () => undefined;

  get link(): Link {
    return this.#link;
  }

  /** Whether anything has been heard since the page was opened. */
  get told(): boolean {
    return this.#told;
  }

  get events(): readonly LiveEvent[] {
    return this.#events;
  }

  get wanted(): string[] {
    return [...this.#wanted.keys()].sort();
  }

  value<T extends string>(topic: T): (T extends keyof TopicValues ? TopicValues[T] : unknown) | undefined {
    return this.#topics.get(topic) as never;
  }

  /** The values of all topics `family/…`, by topic; the same array until one of them changes. */
  list(family: string): readonly unknown[] {
    let list = this.#lists.get(family);
    if (list === undefined) {
      const prefix = `${family}/`;
      list = [...this.#topics]
        .filter(([topic]) => topic.startsWith(prefix) && !topic.includes("/", prefix.length))
        .sort(([a], [b]) => (a < b ? -1 : 1))
        .map(([, value]) => value);
      this.#lists.set(family, list);
    }
    return list;
  }

  setLink(link: Link): void {
    if (this.#link === link) return;
    this.#link = link;
    this.#tell(this.#watchers, ["link"]);
  }

  take(batch: Batch): void {
    const changed = new Set<string>();
    if (batch.type === "snapshot") {
      for (const topic of this.#topics.keys()) {
        if (!(topic in batch.topics)) this.#put(topic, null, changed);
      }
      this.#told = true;
    }
    for (const [topic, value] of Object.entries(batch.topics)) this.#put(topic, value, changed);
    if (batch.events.length > 0) {
      this.#events = merged(this.#events, batch.events);
      changed.add("events");
    }
    // `robot/ur10-1/joints` is no robot: thirty times a second it draws nothing anew but the arm.
    const families = new Set([...changed].filter((topic) => topic.split("/").length === 2).map(familyOf));
    for (const family of families) this.#lists.delete(family);
    this.#tell(this.#watchers, changed);
    this.#tell(this.#families, families);
  }

  /** Take in events that were fetched, because the link had left some out or the page looks further back. */
  takeEvents(events: LiveEvent[]): void {
    this.take({ type: "batch", at: "", topics: {}, events });
  }

  watch(topic: string, listener: Listener): () => void {
    return enlist(this.#watchers, topic, listener);
  }

  watchFamily(family: string, listener: Listener): () => void {
    return enlist(this.#families, family, listener);
  }

  /** Ask for a topic that is only sent to pages that show it, until what is returned is called. */
  want(topic: string): () => void {
    const count = this.#wanted.get(topic) ?? 0;
    this.#wanted.set(topic, count + 1);
    if (count === 0) this.onWant();
    return () => {
      const left = (this.#wanted.get(topic) ?? 1) - 1;
      if (left > 0) {
        this.#wanted.set(topic, left);
      } else {
        this.#wanted.delete(topic);
        this.#topics.delete(topic);
        this.onWant();
      }
    };
  }

  #put(topic: string, value: unknown, changed: Set<string>): void {
    if (value === null) {
      if (!this.#topics.delete(topic)) return;
    } else {
      this.#topics.set(topic, value);
    }
    changed.add(topic);
  }

  #tell(listeners: Map<string, Set<Listener>>, names: Iterable<string>): void {
    for (const name of names) {
      for (const listener of [...(listeners.get(name) ?? [])]) listener();
    }
  }
}

function familyOf(topic: string): string {
  return topic.slice(0, topic.indexOf("/"));
}

function enlist(listeners: Map<string, Set<Listener>>, name: string, listener: Listener): () => void {
  const those = listeners.get(name) ?? new Set();
  listeners.set(name, those.add(listener));
  return () => {
    those.delete(listener);
    if (those.size === 0 && listeners.get(name) === those) listeners.delete(name);
  };
}

/** Two runs of events as one: by `seq`, each once, the newest `KEPT_EVENTS`. */
function merged(known: readonly LiveEvent[], news: readonly LiveEvent[]): LiveEvent[] {
  const last = known.at(-1)?.seq ?? -1;
  const first = news[0]?.seq ?? 0;
  const all = [...known, ...news];
  if (first <= last) {
    const bySeq = new Map(all.map((event) => [event.seq, event]));
    all.splice(0, all.length, ...[...bySeq.values()].sort((a, b) => a.seq - b.seq));
  }
  return all.slice(-KEPT_EVENTS);
}

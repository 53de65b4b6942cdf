/**
* The live state of the page: the newest value of every topic, and the last events. Components subscribe to the
 * topics they show, so a moving robot does not render the view of a hand.
 */
import type { Batch, LiveEvent, TopicValues } from "./messages";

export type ConnectionState = "connecting" | "open" | "lost";

const MAX_EVENTS = 500;
/** Who subscribes to this topic receives all topics of the family as well. */
const REGISTERED_DEVICES = "registeredDevices";
const REGISTERED_DEVICE = "registeredDevice";

type Listener = () => void;

export class LiveStore {
  readonly #topics = new Map<string, unknown>();
  readonly #watchers = new Map<string, Set<Listener>>();
  readonly #families = new Map<string, Set<Listener>>();
  readonly #subscribers = new Map<string, number>();
  #lists = new Map<string, unknown[]>();
  #events: LiveEvent[] = [];
  #link: ConnectionState = "connecting";
  #hasSnapshot = false;
  #receivedAtMs = 0;
  /** Called when the set of requested topics has changed. */
  onSubscriptionsChange: () => void = () => undefined;

  get link(): ConnectionState {
    return this.#link;
  }

  /** Whether a snapshot was received since the page was opened. */
  get hasSnapshot(): boolean {
    return this.#hasSnapshot;
  }

  /** When the last batch was received, on the clock of `performance.now()`. */
  get receivedAtMs(): number {
    return this.#receivedAtMs;
  }

  get events(): readonly LiveEvent[] {
    return this.#events;
  }

  get subscriptions(): string[] {
    return [...this.#subscribers.keys()].sort();
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

  setLink(link: ConnectionState): void {
    if (this.#link === link) return;
    this.#link = link;
    this.#notify(this.#watchers, ["link"]);
  }

  apply(batch: Batch): void {
    this.#receivedAtMs = performance.now();
    const changed = new Set<string>();
    if (batch.type === "snapshot") {
      for (const topic of this.#topics.keys()) {
        if (!(topic in batch.topics)) this.#put(topic, null, changed);
      }
      this.#hasSnapshot = true;
    }
    for (const [topic, value] of Object.entries(batch.topics)) this.#put(topic, value, changed);
    if (batch.events.length > 0) {
      this.#events = merged(this.#events, batch.events);
      changed.add("events");
    }
    // `robot/ur10-1/joints` is not a robot: its changes do not render lists of robots.
    const families = new Set([...changed].filter((topic) => topic.split("/").length === 2).map(familyOf));
    for (const family of families) this.#lists.delete(family);
    this.#notify(this.#watchers, changed);
    this.#notify(this.#families, families);
  }

  /** Add events that were fetched: after a gap, or older ones. */
  addEvents(events: LiveEvent[]): void {
    this.apply({ type: "batch", at: "", topics: {}, events });
  }

  watch(topic: string, listener: Listener): () => void {
    return addListener(this.#watchers, topic, listener);
  }

  watchFamily(family: string, listener: Listener): () => void {
    return addListener(this.#families, family, listener);
  }

  /** Request a topic that is only sent to pages that show it; call the returned function to release it. */
  subscribe(topic: string): () => void {
    const count = this.#subscribers.get(topic) ?? 0;
    this.#subscribers.set(topic, count + 1);
    if (count === 0) this.onSubscriptionsChange();
    return () => {
      const left = (this.#subscribers.get(topic) ?? 1) - 1;
      if (left > 0) {
        this.#subscribers.set(topic, left);
      } else {
        this.#subscribers.delete(topic);
        this.#forget(topic);
        this.onSubscriptionsChange();
      }
    };
  }

  #forget(topic: string): void {
    this.#topics.delete(topic);
    if (topic !== REGISTERED_DEVICES) return;
    for (const member of this.#topics.keys()) if (familyOf(member) === REGISTERED_DEVICE) this.#topics.delete(member);
    this.#lists.delete(REGISTERED_DEVICE);
  }

  #put(topic: string, value: unknown, changed: Set<string>): void {
    if (value === null) {
      if (!this.#topics.delete(topic)) return;
    } else {
      this.#topics.set(topic, value);
    }
    changed.add(topic);
  }

  #notify(listeners: Map<string, Set<Listener>>, names: Iterable<string>): void {
    for (const name of names) {
      for (const listener of [...(listeners.get(name) ?? [])]) listener();
    }
  }
}

function familyOf(topic: string): string {
  return topic.slice(0, topic.indexOf("/"));
}

function addListener(listeners: Map<string, Set<Listener>>, name: string, listener: Listener): () => void {
  const those = listeners.get(name) ?? new Set();
  listeners.set(name, those.add(listener));
  return () => {
    those.delete(listener);
    if (those.size === 0 && listeners.get(name) === those) listeners.delete(name);
  };
}

/** Merge two lists of events by `seq`, each once, up to the newest `MAX_EVENTS`. */
function merged(current: readonly LiveEvent[], news: readonly LiveEvent[]): LiveEvent[] {
  const last = current.at(-1)?.seq ?? -1;
  const first = news[0]?.seq ?? 0;
  const all = [...current, ...news];
  if (first <= last) {
    const bySeq = new Map(all.map((event) => [event.seq, event]));
    all.splice(0, all.length, ...[...bySeq.values()].sort((a, b) => a.seq - b.seq));
  }
  return all.slice(-MAX_EVENTS);
}

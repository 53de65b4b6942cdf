/** Objects that are not in the live store: the services are asked when the user has stopped typing for a moment. */
import { useQueries } from "@tanstack/react-query";
import i18next from "i18next";
import { useEffect, useMemo, useState } from "react";
import type { MachineView } from "~/api/generated/assistive-devices";
import type { PersonView as PersonOfGestures } from "~/api/generated/gesture-controller";
import type { PersonView as Patient } from "~/api/generated/human-state";
import { requestService } from "~/api/http";
import { queryClient } from "~/api/useServiceQuery";
import { allUsers } from "~/accounts/accounts";
import type { ProcessTexts } from "~/live/processTexts";
import { addresses } from "~/places/addresses";
import { processesBefore } from "~/processes/records";
import { currentSession, mayDo } from "~/session/session";
import { entryOf, type Entry, type EntryText } from "./entries";

const DELAY_MS = 250;
const STALE_MS = 15_000;
const MAX_PROCESSES = 20;
const ALL_PROCESSES = { status: "", definition: "", involves: "" };

interface Source {
  service: string;
  /** Whether the service itself searches for the words; else it returns all it has. */
  isSearch?: true;
  isOffered?: () => boolean;
  load: (words: string, signal: AbortSignal, texts: ProcessTexts) => Promise<EntryText[]>;
}

const SOURCES: readonly Source[] = [
  {
    service: "task-orchestrator",
    isSearch: true,
    load: async (words, _signal, texts) => texts.localized(await processesBefore(null, MAX_PROCESSES, ALL_PROCESSES, words)).map(({ id, name, definition, key, status }) => ({ id: `process/${id}`, kind: "process", name, detail: i18next.t(`common:processStatus.${status}`), address: addresses.process(id), more: [id, definition, key ?? ""] })),
  },
  {
    service: "gesture-controller",
    load: async (_words, signal) => (await requestService<PersonOfGestures[]>("gesture-controller", "people", { signal })).map(({ name, title }) => ({ id: `person/${name}`, kind: "person", name: title ?? name, detail: i18next.t("palette:gestures"), address: addresses.people({ person: name }), more: [name] })),
  },
  {
    service: "accounts",
    isOffered: () => currentSession().hasAccounts && mayDo("managePeople"),
    load: async (_words, signal) => (await allUsers(signal)).map(({ subject, name }) => ({ id: `user/${subject}`, kind: "user", name, detail: i18next.t("palette:account"), address: addresses.people({ view: "users", user: subject }), more: [] })),
  },
  {
    service: "human-state",
    isOffered: () => mayDo("readHealthData") || currentSession().user?.person != null,
    load: async (_words, signal) => (await requestService<Patient[]>("human-state", "people", { signal })).map(({ person, pseudonym }) => ({ id: `patient/${person}`, kind: "patient", name: person, detail: i18next.t("common:pages.health"), address: addresses.health({ person }), more: [pseudonym] })),
  },
  {
    service: "assistive-devices",
    isOffered: () => mayDo("readHealthData"),
    load: async (_words, signal) => (await requestService<MachineView[]>("assistive-devices", "machines", { signal })).map(({ case: name, robot }) => ({ id: `machine/${name}`, kind: "machine", name: i18next.t(`cases:name.${name}`, { defaultValue: name }), detail: i18next.t("common:pages.cases"), address: addresses.cases({ case: name }), more: [name, robot] })),
  },
];

export interface Remote {
  /** Entries to be compared with the query. */
  entries: readonly Entry[];
  /** Entries that a service has found for it. */
  found: readonly Entry[];
  isLoading: boolean;
  isIncomplete: boolean;
}

/** Ask those of `services` that have more than the live store. */
export function useRemote(query: string, services: readonly string[], texts: ProcessTexts): Remote {
  const words = useDelayed(query.trim());
  const sources = useMemo(() => SOURCES.filter(({ service, isOffered }) => services.includes(service) && (isOffered?.() ?? true)), [services]);
  const answers = useQueries(
    {
      queries: sources.map(({ service, isSearch, load }) => ({
        queryKey: ["palette", service, isSearch === true ? words : "", i18next.language],
        queryFn: async ({ signal }: { signal: AbortSignal }) => (await load(words, signal, texts)).map((text) => entryOf(text)),
        enabled: words !== "",
        staleTime: STALE_MS,
        gcTime: STALE_MS,
        retry: false,
      })),
    },
    queryClient,
  );
  const of = (isSearch: boolean) => answers.flatMap(({ data }, nth) => ((sources[nth]?.isSearch === true) === isSearch ? (data ?? []) : []));
  return {
    entries: of(false),
    found: words === query.trim() ? of(true) : [],
    isLoading: query.trim() !== "" && (words !== query.trim() || answers.some(({ isFetching }) => isFetching)),
    isIncomplete: answers.some(({ isError }) => isError),
  };
}

function useDelayed(value: string): string {
  const [delayed, setDelayed] = useState(value);
  useEffect(() => {
    const timer = setTimeout(() => setDelayed(value), DELAY_MS);
    return () => clearTimeout(timer);
  }, [value]);
  return delayed;
}

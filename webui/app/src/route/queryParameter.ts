/** State of a page in the URL, so that a link shows the same to a colleague. */
import { useCallback } from "react";
import { useSearchParams } from "wouter";

/** A query parameter of the URL as state. The default value removes the parameter; the history has no entry. */
export function useQueryParameter(name: string, standard = ""): [string, (value: string) => void] {
  const [query, setQuery] = useSearchParams();
  const set = useCallback(
    (value: string) =>
      setQuery(
        (before) => {
          const after = new URLSearchParams(before);
          if (value === standard) after.delete(name);
          else after.set(name, value);
          return after;
        },
        { replace: true },
      ),
    [name, standard, setQuery],
  );
  return [query.get(name) ?? standard, set];
}

/**
 * A function that changes several query parameters at once; "" removes one. Two setters of `useQueryParameter` in the same
 * event would each begin with the parameters before it.
 */
export function useQueryChange(): (changes: Readonly<Record<string, string>>) => void {
  const [, setQuery] = useSearchParams();
  return useCallback(
    (changes) =>
      setQuery(
        (before) => {
          const after = new URLSearchParams(before);
          for (const [name, value] of Object.entries(changes)) {
            if (value === "") after.delete(name);
            else after.set(name, value);
          }
          return after;
        },
        { replace: true },
      ),
    [setQuery],
  );
}

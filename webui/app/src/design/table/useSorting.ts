/** The sorting of a table, stored in the URL: "-raised" is descending by the column `raised`. */
import { useCallback, useMemo } from "react";
import { useQueryParameter } from "~/route/queryParameter";
import type { Sorting } from "./DataTable";

export function useSorting(initial: string, parameter = "sort"): [Sorting, (sorting: Sorting) => void] {
  const [sort, setSort] = useQueryParameter(parameter, initial);
  const sorting = useMemo(() => ({ by: sort.replace(/^-/, ""), isDescending: sort.startsWith("-") }), [sort]);
  const setSorting = useCallback(({ by, isDescending }: Sorting) => setSort(`${isDescending ? "-" : ""}${by}`), [setSort]);
  return [sorting, setSorting];
}

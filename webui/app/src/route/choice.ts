/** A parameter of the URL with a fixed set of values. */
import { useQueryParameter } from "./queryParameter";

/** The address asks for a value that the page does not have; the page says so (`ErrorBoundary`) instead of showing another one. */
export class UnknownAddress extends Error {
  readonly parameter: string;
  readonly value: string;

  constructor(parameter: string, value: string) {
    super(`${parameter}=${value}`);
    this.parameter = parameter;
    this.value = value;
  }
}

/** A query parameter of the URL as state, which is one of `choices`; throws `UnknownAddress` for another value. */
export function useChoice<T extends string>(name: string, choices: readonly T[], standard: T): [T, (value: T) => void] {
  const [asked, set] = useQueryParameter(name, standard);
  const choice = choices.find((one) => one === asked);
  if (choice === undefined) throw new UnknownAddress(name, asked);
  return [choice, set];
}

/** A topic, an identifier or a path that may wrap after its separators. */
import { Fragment } from "react";

export function BreakableText({ of }: { of: string }) {
  return of.split(/(?<=[:/._#])(?=[^:/])/).map((part, place) => (
    <Fragment key={place}>
      {place > 0 && <wbr />}
      {part}
    </Fragment>
  ));
}

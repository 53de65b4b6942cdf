/** A topic, an identifier or a path, which may go on in a new line behind what separates its parts. */
import { Fragment } from "react";

export function BreakableText({ of }: { of: string }) {
  return of.split(/(?<=[:/._#])(?=[^:/])/).map((part, place) => (
    <Fragment key={place}>
      {place > 0 && <wbr />}
      {part}
    </Fragment>
  ));
}

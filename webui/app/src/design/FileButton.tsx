/** A button that opens a file. */
import type { ReactNode } from "react";
import { FileTrigger } from "react-aria-components";
import { Button } from "./Button";

export function FileButton({ types, icon, children, onFile }: { types: readonly string[]; icon: ReactNode; children: string; onFile: (file: File) => void }) {
  return (
    <FileTrigger
      acceptedFileTypes={types}
      onSelect={(files) => {
        const file = files?.[0];
        if (file !== undefined) onFile(file);
      }}
    >
      <Button icon={icon}>{children}</Button>
    </FileTrigger>
  );
}

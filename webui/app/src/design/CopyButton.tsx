/** A button that copies a text, and says that it is copied. */
import { Check, Copy } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "./Button";

export function CopyButton({ text, children }: { text: string; children: string }) {
  const { t } = useTranslation("common");
  const [copied, setCopied] = useState(false);
  return (
    <Button
      icon={copied ? <Check aria-hidden size={18} /> : <Copy aria-hidden size={18} />}
      onPress={() => void copyText(text).then(setCopied)}
    >
      {copied ? t("copied") : children}
    </Button>
  );
}

/** Copy a text; false if the browser does not allow it. The clipboard interface exists on secure pages only. */
async function copyText(text: string): Promise<boolean> {
  // eslint-disable-next-line @typescript-eslint/no-unnecessary-condition -- missing without TLS
  if (navigator.clipboard !== undefined) {
    try {
      await navigator.clipboard.writeText(text);
      return true;
    } catch {
      // not allowed: the other way may be
    }
  }
  const box = document.createElement("textarea");
  box.value = text;
  box.setAttribute("readonly", "");
  const host = document.activeElement?.closest("[role=dialog]") ?? document.body;
  host.append(box);
  box.select();
  // eslint-disable-next-line @typescript-eslint/no-deprecated -- the only way without TLS
  const isCopied = document.execCommand("copy");
  box.remove();
  return isCopied;
}

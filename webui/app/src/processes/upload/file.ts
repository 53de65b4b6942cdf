/** The text of a BPMN file, in the encoding that its XML declaration names. */
export async function textOf(file: Blob): Promise<string> {
  const bytes = await file.arrayBuffer();
  const head = new TextDecoder("latin1").decode(bytes.slice(0, 200));
  const named = /^\s*<\?xml[^>]*\sencoding\s*=\s*["']([\w.-]+)["']/.exec(head.replace(/^ï»¿/, ""))?.[1] ?? "utf-8";
  return decoder(marked(new Uint8Array(bytes)) ?? named).decode(bytes);
}

/** UTF-16 is detected by its byte order mark. */
function marked(bytes: Uint8Array): string | null {
  if (bytes[0] === 0xff && bytes[1] === 0xfe) return "utf-16le";
  if (bytes[0] === 0xfe && bytes[1] === 0xff) return "utf-16be";
  return null;
}

function decoder(encoding: string): TextDecoder {
  try {
    return new TextDecoder(encoding);
  } catch {
    return new TextDecoder();
  }
}

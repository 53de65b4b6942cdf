/** The name of a key from its `KeyboardEvent.code`. */
export function keyName(code: string): string {
  return code.replace(/^(Key|Digit)/, "").replace(/^Arrow/, "");
}

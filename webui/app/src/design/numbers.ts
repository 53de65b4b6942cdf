/** Numbers in the format of the language. All pages use these functions. */

const formatters = new Map<string, Intl.NumberFormat>();

/** "1.000,5" in German: at most two decimals unless `options` differ. */
export function number(value: number, language: string, options: Intl.NumberFormatOptions = { maximumFractionDigits: 2 }): string {
  const key = `${language} ${JSON.stringify(options)}`;
  let formatter = formatters.get(key);
  if (formatter === undefined) {
    formatter = new Intl.NumberFormat(language, options);
    formatters.set(key, formatter);
  }
  return formatter.format(value);
}

/** "45 %" in German: of a share from 0 to 1. */
export function percent(share: number, language: string, digits = 0): string {
  return number(share, language, { style: "percent", maximumFractionDigits: digits });
}

/** Parse the output of `number`; group separators are optional. Null if it is no number. */
export function typedNumber(text: string, language: string): number | null {
  const [decimal, group] = [separator("decimal", language), separator("group", language)];
  const typed = text.trim().replace(/\s/g, " ").replace("−", "-");
  const between = group.trim() === "" ? " " : `\\${group}`;
  const grouped = new RegExp(`^-?\\d{1,3}(${between}\\d{3})+(\\${decimal}\\d*)?$`).test(typed);
  const plain = grouped ? typed.replace(new RegExp(between, "g"), "") : typed;
  const value = Number(plain.replace(decimal, "."));
  return plain === "" || !Number.isFinite(value) ? null : value;
}

function separator(type: "decimal" | "group", language: string): string {
  return new Intl.NumberFormat(language).formatToParts(12345.6).find((part) => part.type === type)?.value ?? "";
}

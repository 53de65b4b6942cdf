/** All languages have the same texts with the same parameters. */
import { describe, expect, it } from "vitest";

interface Words {
  [key: string]: string | Words;
}

const files = import.meta.glob<{ default: Words }>("./*/*.json", { eager: true });

function flat(words: Words, prefix = ""): Map<string, string> {
  const all = new Map<string, string>();
  for (const [key, value] of Object.entries(words)) {
    if (typeof value === "string") all.set(`${prefix}${key}`, value);
    else for (const [path, text] of flat(value, `${prefix}${key}.`)) all.set(path, text);
  }
  return all;
}

/** Plural forms differ between languages (English "one" and "other"); their base keys must not. */
function meanings(words: Map<string, string>): string[] {
  return [...new Set([...words.keys()].map((key) => key.replace(/_(zero|one|two|few|many|other)$/, "")))].sort();
}

function values(text: string): string[] {
  return [...new Set([...text.matchAll(/{{\s*([\w.]+)/g)].map((match) => match[1] ?? ""))].sort();
}

const pages = Object.keys(files)
  .filter((path) => path.startsWith("./en/"))
  .map((path) => path.slice("./en/".length));

describe.each(pages)("%s", (page) => {
  const english = flat(files[`./en/${page}`]?.default ?? {});

  it.each(["de", "fi"])("is complete in %s", (language) => {
    const file = files[`./${language}/${page}`];
    expect(file, `i18n/${language}/${page} is missing`).toBeDefined();
    const translated = flat(file?.default ?? {});
    expect(meanings(translated)).toEqual(meanings(english));
    for (const [key, text] of translated) {
      expect(text.trim(), `${language}/${page} ${key} is empty`).not.toBe("");
      const original = english.get(key);
      // "One Task" may leave the number out, so plural forms are not compared.
      if (original !== undefined && !/_(zero|one|other)$/.test(key)) {
        expect(values(text), `${language}/${page} ${key} has other values`).toEqual(values(original));
      }
    }
  });
});

it("has no words in a language that English lacks", () => {
  for (const path of Object.keys(files)) {
    expect(pages).toContain(path.split("/")[2]);
  }
});

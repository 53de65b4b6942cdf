/**
* English, German and Finnish. One JSON file per page and language; the texts of a page load with it, those of
 * the frame (`common`) with the first load.
 */
import i18next from "i18next";
import { initReactI18next } from "react-i18next";
import de from "./de/common.json";
import en from "./en/common.json";
import fi from "./fi/common.json";

export const languages = { en: "English", de: "Deutsch", fi: "Suomi" } as const;
export type Language = keyof typeof languages;

const STORAGE_KEY = "handover.language";

const files = import.meta.glob<{ default: Record<string, unknown> }>(["./*/*.json", "!./*/common.json"]);

export function preferredLanguage(): Language {
  const wished = [localStorage.getItem(STORAGE_KEY) ?? "", ...navigator.languages].map((tag) => tag.slice(0, 2));
  return wished.find((tag): tag is Language => tag in languages) ?? "en";
}

export async function initI18n(): Promise<void> {
  await i18next
    .use(initReactI18next)
    .use({
      type: "backend",
      read: (language: string, page: string, done: (error: unknown, words: unknown) => void) => {
        const load = files[`./${language}/${page}.json`];
        if (load === undefined) {
          done(new Error(`there are no words for ${page} in ${language}`), false);
        } else {
          load().then(
            (file) => done(null, file.default),
            (error: unknown) => done(error, false),
          );
        }
      },
    })
    .init({
      lng: preferredLanguage(),
      fallbackLng: "en",
      supportedLngs: Object.keys(languages),
      ns: ["common"],
      defaultNS: "common",
      resources: { en: { common: en }, de: { common: de }, fi: { common: fi } },
      partialBundledLanguages: true,
      interpolation: { escapeValue: false },
      returnNull: false,
    });
  void i18next.loadNamespaces("server"); // in the background, after the first page
  document.documentElement.lang = i18next.language;
  i18next.on("languageChanged", (language) => {
    document.documentElement.lang = language;
  });
}

export async function setLanguage(language: Language): Promise<void> {
  localStorage.setItem(STORAGE_KEY, language);
  await i18next.changeLanguage(language);
}

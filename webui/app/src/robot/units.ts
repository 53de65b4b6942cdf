/** Angles and lengths as people read them. */
import { number } from "~/design/numbers";

/** "−90.0" for an angle in rad; a value that rounds to zero has no sign. */
export function degrees(rad: number, language: string): string {
  const rounded = Math.round((rad * 1800) / Math.PI) / 10 + 0;
  return signed(number(rounded, language, { minimumFractionDigits: 1, maximumFractionDigits: 1 }));
}

/** "−90" for an angle in rad. */
export function wholeDegrees(rad: number, language: string): string {
  return signed(number(Math.round((rad * 180) / Math.PI) + 0, language, { maximumFractionDigits: 0 }));
}

/** "1.6" for a length in m, to the millimetre, without trailing zeros. */
export function shortMetres(metres: number, language: string): string {
  return signed(number(Math.round(metres * 1000) / 1000 + 0, language, { maximumFractionDigits: 3 }));
}

/** "0.497" for a length in m, to the millimetre. */
export function metres(metres: number, language: string): string {
  const rounded = Math.round(metres * 1000) / 1000 + 0;
  return signed(number(rounded, language, { minimumFractionDigits: 3, maximumFractionDigits: 3 }));
}

/** A minus sign is as wide as a digit, so that columns stay aligned; a hyphen is narrower. */
function signed(text: string): string {
  return text.replace("-", "\u2212");
}

/** What a scanner or a person types: the QR codes that accounts makes have this prefix; other texts are badge numbers. */
const QR_PREFIX = "hnd_badge_";

export function methodOf(typed: string): "qr" | "badge" {
  return typed.trim().startsWith(QR_PREFIX) ? "qr" : "badge";
}

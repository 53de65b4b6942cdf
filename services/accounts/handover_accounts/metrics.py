"""The metrics of accounts."""

from prometheus_client import Counter

SIGN_INS = Counter(
    "handover_accounts_sign_ins_total", "Attempts to sign in with a password, by result", ["result"]
)
for _result in ("accepted", "refused", "limited"):
    SIGN_INS.labels(_result)

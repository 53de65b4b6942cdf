"""The page in Chromium, and its pictures."""

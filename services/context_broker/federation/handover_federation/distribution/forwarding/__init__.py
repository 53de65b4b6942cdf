"""One request to one context source: in its dialect, with its headers, and never in a loop."""

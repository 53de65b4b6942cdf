"""Rules: what a mapping says, checked against the message definitions and made ready to run."""

"""Speed limits from the state of a person: pure rules, and the stream to robots."""

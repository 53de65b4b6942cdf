"""The study: people try personal and predefined gestures, say how it was, and the answers are analysed."""

"""People: who wears which glove, how it fits their hand, and the gestures that are their own."""

"""Testing: how surely and how quickly a glove tells the gestures of the person who wears it."""

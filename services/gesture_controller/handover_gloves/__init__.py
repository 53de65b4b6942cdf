"""The gesture controller: glove frames become gestures, and gestures held long enough complete Tasks."""

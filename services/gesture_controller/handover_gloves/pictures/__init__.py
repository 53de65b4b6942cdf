"""Pictures: drawings of gestures from their five states, for screens, papers and other systems."""

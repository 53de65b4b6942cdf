"""Pictures: every gesture drawn from its five states, for screens, papers and other systems."""

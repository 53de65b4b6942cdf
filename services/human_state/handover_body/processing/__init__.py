"""Signal to feature: streaming, bounded in memory, each value with its quality."""

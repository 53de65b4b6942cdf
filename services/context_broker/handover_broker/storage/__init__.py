"""The entities in memory and the journal behind them: write-ahead log with SQLite, or PostgreSQL."""

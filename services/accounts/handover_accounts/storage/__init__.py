"""What the database of accounts has: its tables, and the changes of each kind of row."""

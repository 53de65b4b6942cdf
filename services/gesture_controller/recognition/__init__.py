"""Recognition: what the hand shows, told from what its sensors say; `README.md` holds the contract."""

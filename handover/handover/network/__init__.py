"""Connections to others: where they may go, whom they trust, and the HTTP client."""

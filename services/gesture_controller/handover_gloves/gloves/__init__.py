"""A glove in use: its hand, its prompt, and what screens show of both."""

"""The error of all formats."""


class ExchangeError(ValueError):
    """Data of another format cannot be read; the text names the field, the rule and the way out."""

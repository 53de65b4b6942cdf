"""The web UI: the pages for operators in gloves and engineers at a laptop, and the server behind them."""

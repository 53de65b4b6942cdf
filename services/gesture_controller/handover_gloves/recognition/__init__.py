"""Recognition: from sensor values to gestures; `README.md` has the contract of recognizers."""

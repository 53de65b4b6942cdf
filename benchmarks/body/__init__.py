"""Body signals and the limits that follow from them."""

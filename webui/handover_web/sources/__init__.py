"""Sources: each follows one part of the cell and publishes it to the live state, one module per source."""

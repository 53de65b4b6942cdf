"""Routes of the REST interface; each module adds those of one subject to the application."""

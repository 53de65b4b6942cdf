"""Parts of an HTTP server below its routes: protocol, limits, origin check, description."""

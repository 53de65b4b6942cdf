"""What the server answers over HTTP: the files of the page, the proxy to the services, security headers."""

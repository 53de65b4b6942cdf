"""The interfaces of exchangeable components: what a robot measures, and what it is commanded."""

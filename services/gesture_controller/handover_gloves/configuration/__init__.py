"""The gestures file of a site, and YAML files whose errors name the line."""

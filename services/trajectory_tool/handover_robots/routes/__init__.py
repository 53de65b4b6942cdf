"""REST and WebSocket interfaces of the trajectory tool, one module for each subject; `app` mounts them."""

"""The live state of the cell, the event log, and the WebSocket that sends both to open pages."""

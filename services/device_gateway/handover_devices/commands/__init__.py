"""Commands to devices: when one is sent, sent again, or ends without an answer."""

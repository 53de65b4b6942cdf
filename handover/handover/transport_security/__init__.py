"""Transport security of servers: certificates, bounded TLS handshakes, and the local certificate authority.

`tls_trust` is the side of the clients.
"""

"""What commands share: output, credentials, requests to services, secrets."""

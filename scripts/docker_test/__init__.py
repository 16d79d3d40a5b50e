"""`make test-docker`: docker-compose.yml for real. See `__main__`."""

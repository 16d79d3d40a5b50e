"""`make test-docker`: tests docker-compose.yml with a real engine. See `__main__`."""
